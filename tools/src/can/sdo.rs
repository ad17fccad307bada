//! `takt can sdo`: reads, writes, dumps and compares the objects of one node, with their names. `takt-can` makes the
//! transfers; nothing here is real-time.

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

use super::confirm;
use super::sdo_client::{SdoClient, SdoError};
use super::sheet::Sheet;
use super::wire::{Live, Wire};
use crate::output::{complain, save, say, span};
use crate::{Verdict, objects};

/// Read, write, dump and compare the objects of a node.
///
/// Objects of CiA 301 and CiA 402 can be named; a data sheet (--eds) adds those of the device. Exit status: 0 done, and
/// compared values are equal; 1 the node refuses, does not answer, or differs; 2 it could not be tried.
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
    action: Action,
}

/// Options of a transfer.
#[derive(Clone, Debug, Args)]
pub(super) struct Transfer {
    /// The data sheet of the device, or a configuration (DCF).
    #[arg(long, value_name = "FILE")]
    eds: Option<PathBuf>,
    /// Transfer in blocks, with a checksum: for long values.
    #[arg(long)]
    block: bool,
    /// Timeout of an answer.
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
    timeout: Duration,
}

#[derive(Debug, Subcommand)]
pub(super) enum Action {
    /// Read an entry.
    Upload {
        /// Index and sub-index, hexadecimal (6041, 1018:01), or the name.
        object: String,
        /// Its data type (u8, i32, f32, string, bytes, ..), if no data sheet has it.
        #[arg(long = "type", value_name = "TYPE", value_parser = data_type)]
        data_type: Option<DataType>,
        /// Write its bytes to a file.
        #[arg(long, alias = "out", value_name = "FILE")]
        output: Option<PathBuf>,
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
        /// The value in the notation of its type: 5, -5, 0x1F, 1.5, text, `0A 1B`.
        #[arg(
            allow_hyphen_values = true,
            required_unless_present = "file",
            conflicts_with = "file"
        )]
        value: Option<String>,
        /// Write the bytes of this file.
        #[arg(long, value_name = "FILE")]
        file: Option<PathBuf>,
        /// Its data type (u8, i32, f32, string, bytes, ..), if no data sheet has it.
        #[arg(long = "type", value_name = "TYPE", value_parser = data_type)]
        data_type: Option<DataType>,
        /// It is safe that a machine moves.
        #[arg(long = "yes", alias = "confirm-motion")]
        confirm_motion: bool,
        #[command(flatten)]
        transfer: Transfer,
    },
    /// Read all entries of the data sheet.
    Dump {
        /// Write them to a configuration file (DCF, CiA 306).
        #[arg(long, value_name = "FILE")]
        dcf: Option<PathBuf>,
        /// Also read domains, which can be long.
        #[arg(long)]
        domains: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        #[command(flatten)]
        transfer: Transfer,
    },
    /// Read the data sheet stored in the node (1021h), if there is one.
    Eds {
        /// The file to write, for --eds.
        #[arg(value_name = "FILE")]
        out: PathBuf,
        /// Timeout of an answer.
        #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
        timeout: Duration,
    },
    /// Store the settings in the node (1010h).
    Store {
        /// all, communication, application or manufacturer.
        #[arg(default_value = "all")]
        group: Group,
        /// Timeout: the memory of the node is slow.
        #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
        timeout: Duration,
    },
    /// Restore the defaults of the node at its next reset (1011h).
    Restore {
        /// all, communication, application or manufacturer.
        #[arg(default_value = "all")]
        group: Group,
        /// Timeout: the memory of the node is slow.
        #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
        timeout: Duration,
    },
    /// Compare the settings of the node with those of a file.
    Compare {
        /// A configuration (DCF), or a data sheet, whose defaults are compared.
        #[arg(value_name = "FILE")]
        with: PathBuf,
        /// Also compare read-only entries: measured values, states.
        #[arg(long)]
        all: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
        /// Timeout of an answer.
        #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = span)]
        timeout: Duration,
    },
}

fn data_type(text: &str) -> Result<DataType, String> {
    DataType::named(text).map_err(|error| error.to_string())
}

/// The text to print, and the verdict.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Report {
    pub(super) text: String,
    pub(super) good: bool,
}

impl Sdo {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if let Action::Download {
            object,
            transfer,
            confirm_motion,
            ..
        } = &self.action
        {
            let address = Sheet::open(transfer.eds.as_deref())?.find(object)?;
            if can_move(address) {
                let action = format!("writing {address} of node {}", self.node);
                confirm::action(&self.interface, &action, *confirm_motion)?;
            }
        }
        let mut wire = Live::open(&self.interface)?;
        let kbit = Interface::open(&self.interface)
            .and_then(|interface| interface.details())
            .ok()
            .and_then(|details| details.bitrate)
            .map(|rate| rate / 1000);
        let report = match perform(&mut wire, self.node, &self.action, kbit)? {
            Ok(report) => report,
            Err(error) => {
                complain(&format!("takt: {error}"));
                return Ok(Verdict::Failed);
            }
        };
        if !report.text.is_empty() {
            say(report.text.trim_end())?;
        }
        Ok(match report.good {
            true => Verdict::Good,
            false => Verdict::Failed,
        })
    }
}

/// Communication parameters (1000h to 1FFFh) cannot start a motion; control words and outputs are other objects.
const fn can_move(address: Address) -> bool {
    !matches!(address.index, 0x1000..=0x1FFF)
}

/// Performs an action. `kbit` is the bit rate for a configuration file.
pub(super) fn perform<W: Wire>(
    wire: &mut W,
    node: NodeId,
    action: &Action,
    kbit: Option<u32>,
) -> anyhow::Result<Result<Report, SdoError>> {
    match action {
        Action::Upload {
            object,
            data_type,
            output,
            json,
            transfer,
        } => upload(
            wire,
            node,
            object,
            *data_type,
            output.as_deref(),
            *json,
            transfer,
        ),
        Action::Download {
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
        Action::Dump {
            dcf,
            domains,
            json,
            transfer,
        } => dump(wire, node, dcf.as_deref(), *domains, *json, transfer, kbit),
        Action::Eds { out, timeout } => {
            stored::fetch(wire, &mut SdoClient::new(node, *timeout), out)
        }
        Action::Store { group, timeout } => {
            let text = format!("node {node}: stored");
            keep(wire, node, group.store(), text, *timeout)
        }
        Action::Restore { group, timeout } => {
            let text = format!("node {node}: defaults apply after its next reset (takt can nmt)");
            keep(wire, node, group.restore(), text, *timeout)
        }
        Action::Compare {
            with,
            all,
            json,
            timeout,
        } => {
            let mut client = SdoClient::new(node, *timeout);
            compare(wire, &mut client, with, *all, *json)
        }
    }
}

/// Compares the settings of a node with those of a file, which must be of its vendor and product.
fn compare<W: Wire>(
    wire: &mut W,
    client: &mut SdoClient,
    with: &Path,
    all: bool,
    json: bool,
) -> anyhow::Result<Result<Report, SdoError>> {
    let node = client.node();
    let sheet = Sheet::open(Some(with))?;
    let stranger = match sheet.stranger(wire, client)? {
        Ok(stranger) => stranger,
        Err(error) => return Ok(Err(error)),
    };
    let compared = match whole::compare(wire, client, &sheet, all)? {
        Ok(compared) => compared,
        Err(error) => return Ok(Err(error)),
    };
    let text = match (json, &stranger) {
        (true, _) => compared.json(&sheet, node, stranger.as_deref()).to_string(),
        (false, None) => compared.text(&sheet, node),
        (false, Some(stranger)) => format!("{stranger}\n{}", compared.text(&sheet, node)),
    };
    let good = compared.is_equal() && stranger.is_none();
    Ok(Ok(Report { text, good }))
}

/// Reports a data sheet of another device.
fn warn_of_stranger<W: Wire>(
    wire: &mut W,
    client: &mut SdoClient,
    sheet: &Sheet,
) -> anyhow::Result<Result<(), SdoError>> {
    Ok(sheet.stranger(wire, client)?.map(|stranger| {
        if let Some(text) = stranger {
            complain(&format!("takt: {text}"));
        }
    }))
}

/// Writes the signature to 1010h or 1011h.
fn keep<W: Wire>(
    wire: &mut W,
    node: NodeId,
    (address, signature): (Address, [u8; 4]),
    text: String,
    timeout: Duration,
) -> anyhow::Result<Result<Report, SdoError>> {
    let mut client = SdoClient::new(node, timeout);
    let answer = client.write(wire, address, &signature, false)?;
    Ok(answer.map(|()| Report { text, good: true }))
}

fn dump<W: Wire>(
    wire: &mut W,
    node: NodeId,
    dcf: Option<&Path>,
    domains: bool,
    json: bool,
    transfer: &Transfer,
    kbit: Option<u32>,
) -> anyhow::Result<Result<Report, SdoError>> {
    let mut sheet = Sheet::open(transfer.eds.as_deref())?;
    let mut client = SdoClient::new(node, transfer.timeout);
    if let Err(error) = warn_of_stranger(wire, &mut client, &sheet)? {
        return Ok(Err(error));
    }
    let dump = match whole::dump(wire, &mut client, &sheet, domains)? {
        Ok(dump) => dump,
        Err(error) => return Ok(Err(error)),
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
    Ok(Ok(Report { text, good: true }))
}

fn upload<W: Wire>(
    wire: &mut W,
    node: NodeId,
    object: &str,
    data_type: Option<DataType>,
    out: Option<&Path>,
    json: bool,
    transfer: &Transfer,
) -> anyhow::Result<Result<Report, SdoError>> {
    let sheet = Sheet::open(transfer.eds.as_deref())?;
    let address = sheet.find(object)?;
    let mut client = SdoClient::new(node, transfer.timeout);
    if let Err(error) = warn_of_stranger(wire, &mut client, &sheet)? {
        return Ok(Err(error));
    }
    let bytes = match client.read(wire, address, transfer.block)? {
        Ok(bytes) => bytes,
        Err(error) => return Ok(Err(error)),
    };
    if let Some(path) = out {
        save(path, &bytes)?;
    }
    let (shown, name) = (sheet.show(address, data_type, &bytes), sheet.name(address));
    let text = if json {
        let kind = data_type.or_else(|| sheet.data_type(address));
        json!({
            "version": 1, "node": node.raw(), "address": address.to_string(), "name": name,
            "type": kind.map(|kind| kind.to_string()), "bytes": bytes,
            "value": objects::json(kind, &bytes, shown),
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
    Ok(Ok(Report { text, good: true }))
}

/// `6041h:00 statusword = 592 (0250h)`
fn line(address: Address, name: &str, shown: &str) -> String {
    let gap = if name.is_empty() { "" } else { " " };
    format!("{address}{gap}{name} = {shown}")
}

/// Source of a value.
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
) -> anyhow::Result<Result<Report, SdoError>> {
    let sheet = Sheet::open(transfer.eds.as_deref())?;
    let address = sheet.find(object)?;
    let kind = data_type.or_else(|| sheet.data_type(address));
    let bytes = match value {
        Source::File(path) => takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
            .with_context(|| format!("cannot read {}", path.display()))?,
        Source::Text(text) => {
            let kind = kind.with_context(|| {
                format!("the data type of {address} is unknown\nhint: give --type, or the data sheet with --eds")
            })?;
            kind.read(text).with_context(|| address.to_string())?
        }
    };
    let mut client = SdoClient::new(node, transfer.timeout);
    match sheet.stranger(wire, &mut client)? {
        Ok(None) => {}
        Ok(Some(text)) => {
            let text = format!(
                "{text}: nothing was written\nhint: omit --eds and give --type, or use the device's own"
            );
            return Ok(Ok(Report { text, good: false }));
        }
        Err(error) => return Ok(Err(error)),
    }
    let answer = client.write(wire, address, &bytes, transfer.block)?;
    let shown = match value {
        Source::Text(_) => sheet.show(address, kind, &bytes),
        Source::File(path) => format!("{} bytes of {}", bytes.len(), path.display()),
    };
    Ok(answer.map(|()| Report {
        text: line(address, &sheet.name(address), &shown),
        good: true,
    }))
}

#[cfg(test)]
mod tests;
