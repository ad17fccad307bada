//! Configuration of a drive before it can be enabled, and its diagnosis when it is not. Nothing is commanded here.

use takt_cia402::dictionary::Address;
use takt_ethercat::axis::{self, Axis, AxisState};
use takt_ethercat::coe::Whole;
use takt_ethercat::config::{Location, MasterConfig, SlaveSpec, SyncSpec};
use takt_ethercat::master::JobKind;

use super::{Order, error_text};
use crate::ecat::session::{Session, Wire};
use crate::jog::Limits;

/// Reads an entry; `None` if the drive does not have it or does not answer.
fn upload<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    address: Address,
) -> anyhow::Result<Option<Vec<u8>>> {
    let kind = JobKind::Upload {
        address,
        whole: Whole::Entry,
    };
    let answer = session.request(slave, kind, Vec::with_capacity(64))?;
    Ok(answer.ok())
}

/// Number of axes of a drive, by its statuswords.
fn axes<W: Wire>(session: &mut Session<W>, slave: usize) -> anyhow::Result<u8> {
    let plain = Address::new(0x6041, 0);
    for number in 0..8 {
        let Some(address) = plain.on_axis(number) else {
            return Ok(number);
        };
        if upload(session, slave, address)?.is_none() {
            return Ok(number);
        }
    }
    Ok(8)
}

/// A number of up to four bytes.
fn number(bytes: &[u8]) -> u32 {
    let mut four = [0; 4];
    for (to, from) in four.iter_mut().zip(bytes) {
        *to = *from;
    }
    u32::from_le_bytes(four)
}

/// The limits that the axis shows.
pub(super) fn limits<W: Wire>(session: &mut Session<W>, order: &Order) -> anyhow::Result<Limits> {
    Limits::read(order.axis, |address| {
        let bytes = upload(session, order.slave, address)?;
        Ok(bytes.as_deref().map(number))
    })
}

/// The configuration of the segment for an axis, by its slave in PRE-OP; or why there is none.
pub(super) fn config<W: Wire>(
    session: &mut Session<W>,
    order: &Order,
) -> anyhow::Result<Result<MasterConfig, String>> {
    let number = order.slave;
    let Some(slave) = session.master().slave(number) else {
        return Ok(Err(format!("there is no slave {number}")));
    };
    if let Some(fault) = slave.fault() {
        return Ok(Err(format!("slave {number}: {fault}")));
    }
    let mapped = Axis::new(number, slave.process(), order.axis, order.profile).is_ok();
    let count = axes(session, number)?;
    if order.axis >= count {
        return Ok(Err(match count {
            0 => format!(
                "slave {number} has no statusword (6041h): it is no CiA 402 drive, or has no CoE"
            ),
            count => format!(
                "slave {number} has {count} axes, counted from 0; there is no axis {}",
                order.axis
            ),
        }));
    }
    let specs = (0..session.master().len()).map(|other| {
        let place = Location::Position(u16::try_from(other).unwrap_or(u16::MAX));
        let mut spec = SlaveSpec::new(format!("slave {other}"), place);
        if other == number {
            spec.startup = axis::interpolation(order.axis, order.cycle);
            spec.sync = order.sync0.then(|| SyncSpec::sync0(order.cycle));
            if !mapped {
                let (outputs, inputs) = axis::pdos(count);
                (spec.outputs, spec.inputs) = (Some(outputs), Some(inputs));
            }
        }
        spec
    });
    Ok(Ok(MasterConfig {
        cycle: order.cycle,
        slaves: specs.collect(),
        ..MasterConfig::default()
    }))
}

/// Why the slave did not get to OP, if it did not.
pub(super) fn missing<W: Wire>(session: &Session<W>, order: &Order) -> Option<String> {
    let number = order.slave;
    let slave = session.master().slave(number)?;
    if slave.is_running() {
        return None;
    }
    let (al, code) = slave.al();
    let why = slave
        .fault()
        .map_or_else(|| format!("{al} shown: {code}"), |fault| fault.to_string());
    // Codes 002Dh to 0036h are of clocks and SYNC signals.
    let hint = if !order.sync0 && matches!(code.0, 0x002C..=0x0036) {
        "\n      hint: it may need SYNC0: --sync0"
    } else {
        ""
    };
    Some(format!("slave {number}: {why}{hint}"))
}

/// What else the drive shows: error code, supported modes, error register.
pub(super) fn reasons<W: Wire>(
    session: &mut Session<W>,
    order: &Order,
    state: &AxisState,
) -> anyhow::Result<Vec<String>> {
    let mut lines = Vec::new();
    let mut number = |index: u16| -> anyhow::Result<Option<u32>> {
        let Some(address) = Address::new(index, 0).on_axis(order.axis) else {
            return Ok(None);
        };
        let bytes = upload(session, order.slave, address)?;
        Ok(bytes.as_deref().map(number))
    };
    let code = match state.error_code {
        Some(code) => Some(code),
        None => number(0x603F)?.and_then(|code| u16::try_from(code).ok()),
    };
    if let Some(code) = code.filter(|code| *code != 0) {
        lines.push(error_text(code));
    }
    if let Some(modes) = number(0x6502)?.filter(|modes| modes & 0x80 == 0) {
        lines.push(format!(
            "6502h is {modes:08X}h: it has no cyclic synchronous position"
        ));
    }
    Ok(lines)
}
