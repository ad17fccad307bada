//! `takt can sdo`: the objects of one node, read, written, dumped and compared, with their names. Transfers are
//! those of `takt-can`; nothing here runs beside a cycle.

mod stored;
mod whole;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use serde_json::json;
use takt_can::canopen::NodeId;
use takt_can::canopen::store::Group;
use takt_can::linux::Interface;
use takt_cia402::dictionary::{Address, DataType};

use super::ask::{Asker, Refusal};
use super::confirm;
use super::sheet::Sheet;
use super::wire::{Live, Wire};
use crate::Verdict;
use crate::output::{complain, save, say, span};

/// Read, write, dump and compare the objects of a node.
///
/// Objects of CiA 301 and CiA 402 are known by name; a data sheet (--eds) makes those of the device known. Exit
/// status: 0 done, and what was compared is equal; 1 the node refuses, does not answer, or differs; 2 it could not
/// be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt can sdo can0 5 upload 6041
  takt can sdo can0 5 upload 'serial number'
  takt can sdo can0 5 download 1017 100
  takt can sdo can0 5 dump --eds drive.eds --dcf before.dcf
  takt can sdo can0 5 compare before.dcf
  takt can sdo can0 5 eds drive.eds
  takt can sdo can0 5 store")]
pub(crate) struct Sdo {
    /// The CAN interface.
    interface: String,
    /// The node, 1 to 127.
    #[arg(value_parser = super::node)]
    node: NodeId,
    #[command(subcommand)]
    what: What,
}

/// How a transfer is made.
#[derive(Clone, Debug, Args)]
pub(super) struct Transfer {
    /// The data sheet of the device, or a configuration (DCF).
    #[arg(long, value_name = "FILE")]
    eds: Option<PathBuf>,
    /// Transfer in blocks, with a checksum: for long values.
    #[arg(long)]
    block: bool,
    /// How long the node may take for an answer.
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
    timeout: Duration,
}

#[derive(Debug, Subcommand)]
pub(super) enum What {
    /// Read an entry.
    Upload {
        /// Index and sub-index, hexadecimal (6041, 1018:01), or the name.
        object: String,
        /// Its data type (u8, i32, f32, string, bytes, ..), if no sheet knows it.
        #[arg(long = "type", value_name = "TYPE", value_parser = data_type)]
        data_type: Option<DataType>,
        /// Write its bytes into a file.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        transfer: Transfer,
    },
    /// Write an entry.
    Download {
        /// Index and sub-index, hexadecimal (6041, 1018:01), or the name.
        object: String,
        /// The value, as its type is written: 5, -5, 0x1F, 1.5, text, `0A 1B`.
        #[arg(
            allow_hyphen_values = true,
            required_unless_present = "file",
            conflicts_with = "file"
        )]
        value: Option<String>,
        /// The bytes of this file instead.
        #[arg(long, value_name = "FILE")]
        file: Option<PathBuf>,
        /// Its data type (u8, i32, f32, string, bytes, ..), if no sheet knows it.
        #[arg(long = "type", value_name = "TYPE", value_parser = data_type)]
        data_type: Option<DataType>,
        /// It is safe that a machine moves.
        #[arg(long)]
        confirm_motion: bool,
        #[command(flatten)]
        transfer: Transfer,
    },
    /// Read all entries that the data sheet knows.
    Dump {
        /// Write them as configuration (DCF, CiA 306).
        #[arg(long, value_name = "FILE")]
        dcf: Option<PathBuf>,
        /// Read domains too, which can be long.
        #[arg(long)]
        domains: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        transfer: Transfer,
    },
    /// Read the data sheet that the node holds itself (1021h), if it holds one.
    Eds {
        /// Where to; then it is one for --eds.
        #[arg(value_name = "FILE")]
        out: PathBuf,
        /// How long the node may take for an answer.
        #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
        timeout: Duration,
    },
    /// Have the node keep its settings (1010h).
    Store {
        /// all, communication, application or manufacturer.
        #[arg(default_value = "all")]
        group: Group,
        /// How long the node may take: its memory is slow.
        #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
        timeout: Duration,
    },
    /// Have the node take its defaults again, after its next reset (1011h).
    Restore {
        /// all, communication, application or manufacturer.
        #[arg(default_value = "all")]
        group: Group,
        /// How long the node may take: its memory is slow.
        #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
        timeout: Duration,
    },
    /// Compare the settings of the node with those of a file.
    Compare {
        /// A configuration (DCF), or a data sheet, whose defaults are compared with.
        #[arg(value_name = "FILE")]
        with: PathBuf,
        /// Compare what can only be read too: measured values, states.
        #[arg(long)]
        all: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        /// How long the node may take for an answer.
        #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
        timeout: Duration,
    },
}

fn data_type(text: &str) -> Result<DataType, String> {
    DataType::named(text).map_err(|error| error.to_string())
}

/// What there is to say, and whether it is good.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Told {
    pub(super) text: String,
    pub(super) good: bool,
}

impl Sdo {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if let What::Download {
            object,
            transfer,
            confirm_motion,
            ..
        } = &self.what
        {
            let address = Sheet::open(transfer.eds.as_deref())?.find(object)?;
            if can_move(address) {
                let what = format!("writing {address} of node {}", self.node);
                confirm::deed(&self.interface, &what, *confirm_motion)?;
            }
        }
        let mut wire = Live::open(&self.interface)?;
        let kbit = Interface::open(&self.interface)
            .and_then(|interface| interface.details())
            .ok()
            .and_then(|details| details.bitrate)
            .map(|rate| rate / 1000);
        let told = match perform(&mut wire, self.node, &self.what, kbit)? {
            Ok(told) => told,
            Err(refusal) => {
                complain(&format!("takt: {refusal}"));
                return Ok(Verdict::Failed);
            }
        };
        if !told.text.is_empty() {
            say(told.text.trim_end())?;
        }
        Ok(match told.good {
            true => Verdict::Good,
            false => Verdict::Failed,
        })
    }
}

/// Communication parameters (1000h to 1FFFh) only store something; control words and outputs are beyond.
const fn can_move(address: Address) -> bool {
    !matches!(address.index, 0x1000..=0x1FFF)
}

/// Does it; what the node refuses is no failure of the asking. `kbit` is the bit rate, for a configuration.
pub(super) fn perform<W: Wire>(
    wire: &mut W,
    node: NodeId,
    what: &What,
    kbit: Option<u32>,
) -> anyhow::Result<Result<Told, Refusal>> {
    match what {
        What::Upload {
            object,
            data_type,
            out,
            json,
            transfer,
        } => upload(
            wire,
            node,
            object,
            *data_type,
            out.as_deref(),
            *json,
            transfer,
        ),
        What::Download {
            object,
            value,
            file,
            data_type,
            confirm_motion: _,
            transfer,
        } => {
            let value = match (value, file) {
                (_, Some(file)) => Source::File(file),
                (value, None) => Source::Text(value.as_deref().unwrap_or_default()),
            };
            download(wire, node, object, value, *data_type, transfer)
        }
        What::Dump {
            dcf,
            domains,
            json,
            transfer,
        } => dump(wire, node, dcf.as_deref(), *domains, *json, transfer, kbit),
        What::Eds { out, timeout } => stored::fetch(wire, &mut Asker::new(node, *timeout), out),
        What::Store { group, timeout } => {
            let text = format!("node {node}: stored");
            keep(wire, node, group.store(), text, *timeout)
        }
        What::Restore { group, timeout } => {
            let text = format!("node {node}: has its defaults after its next reset (takt can nmt)");
            keep(wire, node, group.restore(), text, *timeout)
        }
        What::Compare {
            with,
            all,
            json,
            timeout,
        } => {
            let sheet = Sheet::open(Some(with))?;
            let mut asker = Asker::new(node, *timeout);
            let compared = match whole::compare(wire, &mut asker, &sheet, *all)? {
                Ok(compared) => compared,
                Err(refusal) => return Ok(Err(refusal)),
            };
            let text = match json {
                true => compared.json(&sheet, node).to_string(),
                false => compared.text(&sheet, node),
            };
            let good = compared.is_equal();
            Ok(Ok(Told { text, good }))
        }
    }
}

/// Writes the signature that stores or restores.
fn keep<W: Wire>(
    wire: &mut W,
    node: NodeId,
    (address, signature): (Address, [u8; 4]),
    text: String,
    timeout: Duration,
) -> anyhow::Result<Result<Told, Refusal>> {
    let mut asker = Asker::new(node, timeout);
    let answer = asker.write(wire, address, &signature, false)?;
    Ok(answer.map(|()| Told { text, good: true }))
}

fn dump<W: Wire>(
    wire: &mut W,
    node: NodeId,
    dcf: Option<&Path>,
    domains: bool,
    json: bool,
    transfer: &Transfer,
    kbit: Option<u32>,
) -> anyhow::Result<Result<Told, Refusal>> {
    let mut sheet = Sheet::open(transfer.eds.as_deref())?;
    let mut asker = Asker::new(node, transfer.timeout);
    let dump = match whole::dump(wire, &mut asker, &sheet, domains)? {
        Ok(dump) => dump,
        Err(refusal) => return Ok(Err(refusal)),
    };
    if let Some(path) = dcf {
        let text = dump.configuration(&mut sheet.eds, node, kbit);
        save(path, text)?;
    }
    let text = match (json, dcf) {
        (true, _) => dump.json(&sheet, node).to_string(),
        (false, Some(_)) => dump.summary(node),
        (false, None) => dump.text(&sheet, node),
    };
    Ok(Ok(Told { text, good: true }))
}

fn upload<W: Wire>(
    wire: &mut W,
    node: NodeId,
    object: &str,
    data_type: Option<DataType>,
    out: Option<&Path>,
    json: bool,
    transfer: &Transfer,
) -> anyhow::Result<Result<Told, Refusal>> {
    let sheet = Sheet::open(transfer.eds.as_deref())?;
    let address = sheet.find(object)?;
    let mut asker = Asker::new(node, transfer.timeout);
    let bytes = match asker.read(wire, address, transfer.block)? {
        Ok(bytes) => bytes,
        Err(refusal) => return Ok(Err(refusal)),
    };
    if let Some(path) = out {
        save(path, &bytes)?;
    }
    let (shown, name) = (sheet.show(address, data_type, &bytes), sheet.name(address));
    let text = if json {
        let kind = data_type.or_else(|| sheet.data_type(address));
        json!({
            "version": 1, "node": node.raw(), "address": address.to_string(), "name": name,
            "type": kind.map(|kind| kind.to_string()), "bytes": bytes, "value": shown,
        })
        .to_string()
    } else if let Some(path) = out {
        format!(
            "{address} {name}: {} bytes in {}",
            bytes.len(),
            path.display()
        )
    } else {
        line(address, &name, &shown)
    };
    Ok(Ok(Told { text, good: true }))
}

/// `6041h:00 statusword = 592 (0250h)`
fn line(address: Address, name: &str, shown: &str) -> String {
    let gap = if name.is_empty() { "" } else { " " };
    format!("{address}{gap}{name} = {shown}")
}

/// Where a value is from.
#[derive(Clone, Copy, Debug)]
enum Source<'a> {
    Text(&'a str),
    File(&'a Path),
}

fn download<W: Wire>(
    wire: &mut W,
    node: NodeId,
    object: &str,
    value: Source<'_>,
    data_type: Option<DataType>,
    transfer: &Transfer,
) -> anyhow::Result<Result<Told, Refusal>> {
    let sheet = Sheet::open(transfer.eds.as_deref())?;
    let address = sheet.find(object)?;
    let kind = data_type.or_else(|| sheet.data_type(address));
    let bytes = match value {
        Source::File(path) => takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
            .with_context(|| format!("cannot read {}", path.display()))?,
        Source::Text(text) => {
            let kind = kind.with_context(|| {
                format!("the type of {address} is not known: give it by --type, or the data sheet by --eds")
            })?;
            kind.read(text).with_context(|| address.to_string())?
        }
    };
    let mut asker = Asker::new(node, transfer.timeout);
    let answer = asker.write(wire, address, &bytes, transfer.block)?;
    let shown = match value {
        Source::Text(_) => sheet.show(address, kind, &bytes),
        Source::File(path) => format!("{} bytes of {}", bytes.len(), path.display()),
    };
    Ok(answer.map(|()| Told {
        text: line(address, &sheet.name(address), &shown),
        good: true,
    }))
}

#[cfg(test)]
mod tests;
