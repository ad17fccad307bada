//! `takt ecat reg`: reads and writes registers of a slave controller. What a register means is in the data sheet of the
//! chip; `takt ecat dump` names those that masters use.

use anyhow::{Context as _, ensure};
use clap::{Args, Subcommand};
use serde_json::json;
use takt_cia402::dictionary::DataType;
use takt_ethercat::AlState;
use takt_ethercat::master::{JobError, JobKind};

use super::controller::Remote;
use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::output::{complain, say};
use crate::{Verdict, confirm};

/// Read and write registers of a slave controller.
///
/// The segment is brought to PRE-OP. Exit status: 0 done; 1 the register does not answer; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat reg enp2s0 3 read 0130 --type u16    AL status
  takt ecat reg enp2s0 3 read 0300 --len 20      error counters of the ports
  takt ecat reg enp2s0 3 write 0300 0 --type u8 --yes")]
pub(crate) struct Reg {
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
    /// Read a register.
    Read {
        /// Its address, hexadecimal: 0130.
        #[arg(value_parser = address)]
        address: u16,
        /// Number of bytes, 1 to 128; default: that of the type.
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=128))]
        len: Option<u16>,
        /// Its data type (u8, u16, u32, u64, i32, bytes, ..).
        #[arg(long = "type", value_name = "TYPE", value_parser = DataType::named, default_value = "bytes")]
        data_type: DataType,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write a register.
    Write {
        /// Its address, hexadecimal: 0300.
        #[arg(value_parser = address)]
        address: u16,
        /// The value in the notation of its type: 5, 0x1F, `0A 1B`.
        value: String,
        /// Its data type (u8, u16, u32, u64, i32, bytes, ..).
        #[arg(long = "type", value_name = "TYPE", value_parser = DataType::named)]
        data_type: DataType,
        /// Write without asking.
        #[arg(long)]
        yes: bool,
    },
}

/// The error without a length.
const NO_LEN: &str = "how many bytes?\nhint: give --len or a --type of fixed length";
/// Longest register access, bytes.
const LEN_MAX: usize = 128;

fn address(text: &str) -> Result<u16, String> {
    let digits = text.trim_start_matches("0x").trim_end_matches('h');
    u16::from_str_radix(digits, 16).map_err(|_| {
        format!("`{text}` is not a register\nhint: write up to four hexadecimal digits, as 0130")
    })
}

impl Reg {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if self.remote.is_given() {
            let Action::Read {
                address,
                len,
                data_type,
                json,
            } = self.action
            else {
                anyhow::bail!("a running controller writes no registers\nhint: stop it first");
            };
            let len = len.or_else(|| len_of(data_type)).context(NO_LEN)?;
            let (segment, what) = (
                &self.target.interface,
                format!("reg/{address:04X}?len={len}"),
            );
            let bytes = self.remote.read(segment, &self.slave, &what)?;
            say(&shown(&self.slave, address, &bytes, data_type, json))?;
            return Ok(Verdict::Good);
        }
        if let Action::Write { address, yes, .. } = &self.action {
            confirm::change(&format!("this writes register {address:04X}h"), *yes)?;
        }
        let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let slave = session.find(&self.slave)?;
        match perform(&mut session, slave, &self.action)? {
            Ok(text) => {
                say(&text)?;
                Ok(Verdict::Good)
            }
            Err(error) => {
                complain(&format!("takt: slave {slave}: {error}"));
                Ok(Verdict::Failed)
            }
        }
    }
}

/// Performs an action.
pub(super) fn perform<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    action: &Action,
) -> anyhow::Result<Result<String, JobError>> {
    match action {
        Action::Read {
            address,
            len,
            data_type,
            json,
        } => {
            let (at, len) = (*address, len.or_else(|| len_of(*data_type)));
            let len = len.context(NO_LEN)?;
            let kind = JobKind::ReadRegister { at, len };
            let read = session.request(slave, kind, Vec::with_capacity(LEN_MAX))?;
            Ok(read.map(|bytes| shown(&slave.to_string(), at, &bytes, *data_type, *json)))
        }
        Action::Write {
            address,
            value,
            data_type,
            yes: _,
        } => {
            let bytes = data_type
                .read(value)
                .with_context(|| format!("register {address:04X}h"))?;
            ensure!(
                (1..=LEN_MAX).contains(&bytes.len()),
                "{} bytes: a register access has 1 to {LEN_MAX}",
                bytes.len()
            );
            let text = format!("{address:04X}h <- {}", data_type.show(&bytes));
            let kind = JobKind::WriteRegister { at: *address };
            Ok(session.request(slave, kind, bytes)?.map(|_| text))
        }
    }
}

/// Length of a type, bytes; `None` if it has no fixed length.
fn len_of(data_type: DataType) -> Option<u16> {
    let bits = data_type.bits()?;
    u16::try_from(bits.div_ceil(8)).ok()
}

fn shown(slave: &str, at: u16, bytes: &[u8], data_type: DataType, json: bool) -> String {
    let value = data_type.show(bytes);
    if !json {
        return format!("{at:04X}h: {value}");
    }
    json!({ "version": 1, "slave": slave, "register": at, "bytes": bytes, "value": value })
        .to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ecat::tests::{tree, up};

    fn read(at: u16, data_type: &str, len: Option<u16>) -> Action {
        Action::Read {
            address: at,
            len,
            data_type: DataType::named(data_type).unwrap(),
            json: false,
        }
    }

    #[test]
    fn reg_read_and_write_reach_the_controller() {
        let mut session = up(tree(), AlState::PreOp);
        let mut performed = |action| perform(&mut session, 1, &action).unwrap();
        assert_eq!(
            performed(read(0x0130, "u16", None)).unwrap(),
            "0130h: 2 (0002h)"
        );
        let write = Action::Write {
            address: 0x0420,
            value: "500".to_owned(),
            data_type: DataType::named("u16").unwrap(),
            yes: true,
        };
        assert_eq!(performed(write).unwrap(), "0420h <- 500 (01F4h)");
        assert_eq!(
            performed(read(0x0420, "bytes", Some(2))).unwrap(),
            "0420h: F4 01"
        );
    }

    #[test]
    fn reg_address_that_is_no_number_is_rejected() {
        assert_eq!(address("0130"), Ok(0x0130));
        assert_eq!(address("0x130"), Ok(0x0130));
        assert!(
            address("AL")
                .unwrap_err()
                .contains("hint: write up to four")
        );
        let mut session = up(tree(), AlState::PreOp);
        let error = perform(&mut session, 1, &read(0x130, "bytes", None)).unwrap_err();
        assert!(error.to_string().contains("hint: give --len"), "{error}");
    }
}
