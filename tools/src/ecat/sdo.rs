//! `takt ecat sdo`: lists, reads and writes the objects of one slave, by CoE in PRE-OP. `pdos` prints process data.

use std::fmt::Write as _;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use serde_json::json;
use takt_cia402::dictionary::{Address, DataType};
use takt_ethercat::AlState;
use takt_ethercat::coe::Whole;
use takt_ethercat::master::{EntryDescription, JobError, JobKind, ObjectDescription};

use super::controller::Remote;
use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::output::{complain, say};
use crate::{Verdict, confirm, objects};

/// List, read and write objects of a slave (CoE).
///
/// The segment is brought to PRE-OP. Exit status: 0 done; 1 the slave refuses or does not answer; 2 it
/// could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat sdo enp2s0 3 list
  takt ecat sdo enp2s0 3 upload 1018:01
  takt ecat sdo enp2s0 3 upload 6064 --type i32 --controller localhost:8080
  takt ecat sdo enp2s0 EL3104 download 8000:06 true --type bool --yes")]
pub(crate) struct Sdo {
    #[command(flatten)]
    target: Target,
    #[command(flatten)]
    remote: Remote,
    /// The slave: its position from 0, or its name or order code if it is unique.
    slave: String,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
pub(super) enum Action {
    /// List all objects with their names (SDO information service).
    List {
        /// List their entries too.
        #[arg(long)]
        entries: bool,
    },
    /// Read an entry.
    Upload {
        /// Index and sub-index, hexadecimal: 6041, 1018:01.
        address: Address,
        /// Its data type (u8, i32, f32, string, bytes, ..); default: read from the slave.
        #[arg(long = "type", value_name = "TYPE", value_parser = DataType::named)]
        data_type: Option<DataType>,
        /// Read the whole object from the sub-index on (complete access).
        #[arg(long)]
        complete: bool,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write an entry.
    Download {
        /// Index and sub-index, hexadecimal: 6041, 1018:01.
        address: Address,
        /// The value in the notation of its type: 5, -5, 0x1F, 1.5, text, `0A 1B`.
        #[arg(allow_hyphen_values = true)]
        value: String,
        /// Its data type (u8, i32, f32, string, bytes, ..); default: read from the slave.
        #[arg(long = "type", value_name = "TYPE", value_parser = DataType::named)]
        data_type: Option<DataType>,
        /// Write the whole object from the sub-index on (complete access), as bytes.
        #[arg(long)]
        complete: bool,
        /// It is safe that a machine moves.
        #[arg(long = "yes", alias = "confirm-motion")]
        confirm_motion: bool,
    },
}

/// Buffer for a value, bytes: the largest domain.
const VALUE_MAX: usize = 1 << 20;
/// Buffer for a description, bytes: its name fits a mailbox.
const DESCRIPTION_MAX: usize = 1500;

impl Sdo {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.remote.is_given() {
            return self.uploaded();
        }
        if let Action::Download {
            address,
            confirm_motion,
            ..
        } = &self.action
            && can_move(*address)
        {
            confirm::motion(&format!("writing {address}"), *confirm_motion)?;
        }
        let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let slave = session.find(&self.slave)?;
        match perform(&mut session, slave, &self.action)? {
            Ok(text) => {
                say(text.trim_end())?;
                Ok(Verdict::Good)
            }
            Err(error) => {
                complain(&format!("takt: slave {slave}: {error}"));
                Ok(Verdict::Failed)
            }
        }
    }
}

impl Sdo {
    /// An entry through the master of a running controller.
    fn uploaded(self) -> anyhow::Result<Verdict> {
        let Action::Upload {
            address,
            data_type,
            complete: false,
            json,
        } = self.action
        else {
            anyhow::bail!(
                "through a running controller single entries are read\nhint: stop it first to list or write objects"
            );
        };
        let what = format!("sdo/{:04X}/{:X}", address.index, address.sub);
        let segment = &self.target.interface;
        let bytes = self.remote.read(segment, &self.slave, &what)?;
        let value = data_type.unwrap_or(DataType::OctetString).show(&bytes);
        if json {
            let slave = self.slave;
            let address = address.to_string();
            let value = objects::json(data_type, &bytes, value);
            say(&json!({ "version": 1, "slave": slave, "address": address, "bytes": bytes, "value": value }).to_string())?;
        } else {
            say(&value)?;
        }
        Ok(Verdict::Good)
    }
}

/// Communication parameters (1000h to 1FFFh) cannot start a motion; control words and outputs are other objects.
const fn can_move(address: Address) -> bool {
    !matches!(address.index, 0x1000..=0x1FFF)
}

/// Performs an action.
pub(super) fn perform<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    action: &Action,
) -> anyhow::Result<Result<String, JobError>> {
    match action {
        Action::List { entries } => list(session, slave, *entries),
        Action::Upload {
            address,
            data_type,
            complete,
            json,
        } => {
            let kind = JobKind::Upload {
                address: *address,
                whole: whole(*complete),
            };
            let bytes = match session.request(slave, kind, Vec::with_capacity(VALUE_MAX))? {
                Ok(bytes) => bytes,
                Err(error) => return Ok(Err(error)),
            };
            let data_type = match (complete, data_type) {
                (true, _) => None,
                (false, Some(data_type)) => Some(*data_type),
                // The value is read; without its type it is shown as bytes.
                (false, None) => type_of(session, slave, *address)?.unwrap_or_default(),
            };
            let shown = data_type.unwrap_or(DataType::OctetString).show(&bytes);
            if !json {
                return Ok(Ok(shown));
            }
            let object = json!({
                "version": 1,
                "slave": slave,
                "address": address.to_string(),
                "type": data_type.map(|kind| kind.to_string()),
                "bytes": bytes,
                "value": objects::json(data_type, &bytes, shown),
            });
            Ok(Ok(object.to_string()))
        }
        Action::Download {
            address,
            value,
            data_type,
            complete,
            confirm_motion: _,
        } => download(session, slave, *address, value, *data_type, *complete),
    }
}

const fn whole(complete: bool) -> Whole {
    if complete {
        Whole::Object
    } else {
        Whole::Entry
    }
}

fn download<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    address: Address,
    value: &str,
    data_type: Option<DataType>,
    complete: bool,
) -> anyhow::Result<Result<String, JobError>> {
    let data_type = match (complete, data_type) {
        (true, _) => DataType::OctetString,
        (false, Some(data_type)) => data_type,
        (false, None) => match type_of(session, slave, address)? {
            Ok(reported) => reported.with_context(|| {
                format!("slave {slave} does not report the data type of {address}\nhint: give it with --type")
            })?,
            // A mailbox that fails is not a slave without types.
            Err(error) => return Ok(Err(error)),
        },
    };
    let bytes = data_type.read(value).with_context(|| address.to_string())?;
    let text = format!("{address} <- {}", data_type.show(&bytes));
    let kind = JobKind::Download {
        address,
        whole: whole(complete),
    };
    Ok(session.request(slave, kind, bytes)?.map(|_| text))
}

/// The type of an entry, if the slave reports it.
fn type_of<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    address: Address,
) -> anyhow::Result<Result<Option<DataType>, JobError>> {
    let bytes = described(session, slave, JobKind::DescribeEntry(address))?;
    Ok(bytes.map(|bytes| {
        let entry = EntryDescription::decode(&bytes?)?.data_type;
        Some(DataType::from_raw(entry))
    }))
}

/// A description; `None` if the slave answers that it has none. Any other error ends the dialogue: what follows a failed
/// mailbox says nothing about the slave's objects.
fn described<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    kind: JobKind,
) -> anyhow::Result<Result<Option<Vec<u8>>, JobError>> {
    let answer = session.request(slave, kind, Vec::with_capacity(DESCRIPTION_MAX))?;
    Ok(match answer {
        Ok(bytes) => Ok(Some(bytes)),
        Err(JobError::Abort(_) | JobError::Mailbox(_)) => Ok(None),
        Err(error) => Err(error),
    })
}

fn list<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    entries: bool,
) -> anyhow::Result<Result<String, JobError>> {
    let all = session.request(slave, JobKind::List(1), Vec::with_capacity(VALUE_MAX))?;
    let all = match all {
        Ok(all) => all,
        Err(error) => return Ok(Err(error)),
    };
    let mut text = String::new();
    for index in all.chunks_exact(2) {
        let index = index
            .first_chunk()
            .map_or(0, |two| u16::from_le_bytes(*two));
        let kind = JobKind::DescribeObject(index);
        let bytes = session.request(slave, kind, Vec::with_capacity(DESCRIPTION_MAX))?;
        let object = match &bytes {
            Ok(bytes) => ObjectDescription::decode(bytes),
            Err(error @ (JobError::Abort(_) | JobError::Mailbox(_))) => {
                let _ = writeln!(text, "{index:04X}h     {error}");
                continue;
            }
            Err(error) => return Ok(Err(*error)),
        };
        let Some(object) = object else {
            let _ = writeln!(text, "{index:04X}h     its description is truncated");
            continue;
        };
        let _ = writeln!(text, "{}", object_line(&object));
        let highest = if entries { Some(object.highest) } else { None };
        for sub in 0..=highest.unwrap_or(0) {
            if highest.is_some() {
                match entry_line(session, slave, Address::new(index, sub))? {
                    Ok(line) => text.push_str(&line),
                    Err(error) => return Ok(Err(error)),
                }
            }
        }
    }
    Ok(Ok(text))
}

fn object_line(object: &ObjectDescription<'_>) -> String {
    let code = match object.code {
        7 => "VAR",
        8 => "ARRAY",
        9 => "RECORD",
        _ => "?",
    };
    let data_type = DataType::from_raw(object.data_type).to_string();
    format!(
        "{:04X}h     {code:<6} {data_type:<16} {}",
        object.index, object.name
    )
}

/// One entry; empty for a gap in the sub-indices.
fn entry_line<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    address: Address,
) -> anyhow::Result<Result<String, JobError>> {
    let bytes = match described(session, slave, JobKind::DescribeEntry(address))? {
        Ok(bytes) => bytes.unwrap_or_default(),
        Err(error) => return Ok(Err(error)),
    };
    let Some(entry) = EntryDescription::decode(&bytes) else {
        return Ok(Ok(String::new()));
    };
    let data_type = DataType::from_raw(entry.data_type).to_string();
    let bits = entry.access;
    let flag = |bit: u16, text: &'static str| if bits >> bit & 1 == 1 { text } else { "-" };
    Ok(Ok(format!(
        "{address} {:>4} bit {data_type:<16} {}{}{}{}{}{}  {}{}  {}\n",
        entry.bits,
        flag(0, "r"),
        flag(1, "r"),
        flag(2, "r"),
        flag(3, "w"),
        flag(4, "w"),
        flag(5, "w"),
        flag(6, "R"),
        flag(7, "T"),
        entry.name
    )))
}
