//! PDO parameters and the procedure of CiA 301, and every transmission type in both directions.

use std::time::Duration;

use takt_cia402::dictionary::{
    AbortCode, Access, Address, Dictionary, Entry, Hooks, Mapped, Object, PdoUse,
};

use super::*;
use crate::Frame;

const MS: Duration = Duration::from_millis(1);

struct Checked;

impl Hooks for Checked {
    fn before_download(
        &mut self,
        d: &Dictionary,
        at: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        check_download(d, at, data)
    }
}

const fn mapped(index: u16, bits: u8) -> Mapped {
    Mapped {
        address: Address::new(index, 0),
        bits,
    }
}

/// 2000h and 2001h can be received, 3000h and 3001h transmitted.
fn dictionary(parameters: &Parameters, direction: Direction) -> Dictionary {
    let entry = |pdo| Entry::number("value", Access::ReadWrite, 0_u16).mappable(pdo);
    let mut objects = vec![
        Object::var(0x2000, entry(PdoUse::Receive)),
        Object::var(0x2001, entry(PdoUse::Receive)),
        Object::var(0x3000, entry(PdoUse::Transmit)),
        Object::var(0x3001, entry(PdoUse::Transmit)),
        Object::var(0x4000, Entry::number("hidden", Access::ReadWrite, 0_u64)),
        Object::var(
            0x4001,
            Entry::number("long", Access::ReadWrite, 0_u64).mappable(PdoUse::Both),
        ),
    ];
    objects.extend(parameters.objects(direction, 0, 8));
    Dictionary::new(objects).unwrap()
}

fn cob() -> PdoCob {
    PdoCob::from_raw(0x185)
}

fn tpdo(transmission: u8, change: impl FnOnce(&mut Parameters)) -> (Tpdo, Dictionary) {
    let kind = Transmission::from_raw(transmission);
    let mut parameters = Parameters::new(cob(), kind, vec![mapped(0x3000, 16)]);
    change(&mut parameters);
    let d = dictionary(&parameters, Direction::Transmit);
    (Tpdo::new(&d, 0).unwrap().unwrap(), d)
}

fn set(d: &mut Dictionary, index: u16, value: u16) {
    d.store(Address::new(index, 0), &value.to_le_bytes())
        .unwrap();
}

fn text(frame: Option<Frame>) -> String {
    frame.map_or_else(String::new, |frame| frame.to_string())
}

#[test]
fn pdo_transmission_types_read_back_and_match_standard() {
    let receive = Parameters::new(PdoCob::from_raw(0x8000_0205), Transmission::Sync(1), vec![]);
    let mut received = dictionary(&receive, Direction::Receive);
    let mut transmitted = dictionary(&receive, Direction::Transmit);
    for raw in 0..=u8::MAX {
        assert_eq!(Transmission::from_raw(raw).raw(), raw);
        let to =
            |d: &mut Dictionary, index| d.download(Address::new(index, 2), &[raw], &mut Checked);
        let value = |allowed: bool| {
            if allowed {
                Ok(())
            } else {
                Err(AbortCode::Value)
            }
        };
        let reserved = (241..=251).contains(&raw);
        let remote = (252..=253).contains(&raw);
        assert_eq!(
            to(&mut received, 0x1400),
            value(!reserved && !remote),
            "{raw}"
        );
        assert_eq!(to(&mut transmitted, 0x1800), value(!reserved), "{raw}");
    }
}

/// The mapping procedure, with each step rejected where the standard requires it.
#[test]
#[expect(
    clippy::too_many_lines,
    clippy::type_complexity,
    reason = "a table of steps"
)]
fn pdo_parameters_change_only_by_mapping_procedure() {
    let parameters = Parameters::new(cob(), Transmission::Sync(1), vec![mapped(0x3000, 16)]);
    let mut d = dictionary(&parameters, Direction::Transmit);
    let entry = |index: u32, sub: u32, bits: u32| index << 16 | sub << 8 | bits;
    let (off, restricted) = (
        0x8000_0185,
        [0x000, 0x080, 0x181 - 1, 0x581, 0x605, 0x6E0, 0x701, 0x7FF],
    );
    let steps: Vec<(u16, u8, u32, usize, Result<(), AbortCode>)> = vec![
        // While it exists.
        (0x1800, 1, 0x0000_0186, 4, Err(AbortCode::Value)),
        (0x1800, 1, 0x4000_0185, 4, Err(AbortCode::Value)),
        (0x1800, 3, 10, 2, Err(AbortCode::DeviceState)),
        (0x1800, 6, 1, 1, Err(AbortCode::DeviceState)),
        (0x1800, 2, 255, 1, Ok(())),
        (0x1800, 5, 100, 2, Ok(())),
        (0x1800, 4, 1, 1, Err(AbortCode::NoSubIndex)),
        (0x1A00, 0, 0, 1, Err(AbortCode::UnsupportedAccess)),
        (
            0x1A00,
            1,
            entry(0x3001, 0, 16),
            4,
            Err(AbortCode::UnsupportedAccess),
        ),
        // Disabled.
        (0x1800, 1, off, 4, Ok(())),
        (0x1800, 3, 10, 2, Ok(())),
        (0x1800, 6, 241, 1, Err(AbortCode::TooHigh)),
        (
            0x1A00,
            1,
            entry(0x3001, 0, 16),
            4,
            Err(AbortCode::UnsupportedAccess),
        ),
        (0x1A00, 0, 0, 1, Ok(())),
        (0x1A00, 1, entry(0x5000, 0, 16), 4, Err(AbortCode::NoObject)),
        (
            0x1A00,
            1,
            entry(0x3001, 1, 16),
            4,
            Err(AbortCode::NoSubIndex),
        ),
        (
            0x1A00,
            1,
            entry(0x2000, 0, 16),
            4,
            Err(AbortCode::NotMappable),
        ),
        (
            0x1A00,
            1,
            entry(0x4000, 0, 64),
            4,
            Err(AbortCode::NotMappable),
        ),
        (
            0x1A00,
            1,
            entry(0x3001, 0, 8),
            4,
            Err(AbortCode::NotMappable),
        ),
        (0x1A00, 1, entry(0x3001, 0, 16), 4, Ok(())),
        (0x1A00, 2, entry(0x3000, 0, 16), 4, Ok(())),
        (0x1A00, 3, entry(0x4001, 0, 64), 4, Ok(())),
        (0x1A00, 0, 3, 1, Err(AbortCode::PdoTooLong)),
        (0x1A00, 0, 9, 1, Err(AbortCode::PdoTooLong)),
        (0x1A00, 0, 2, 1, Ok(())),
        (0x1800, 1, 0x2000_0185, 4, Err(AbortCode::Value)),
        (0x1800, 1, 0x0000_0285, 4, Ok(())),
    ];
    for (index, sub, value, len, expected) in steps {
        let data = &value.to_le_bytes()[..len];
        let answer = d.download(Address::new(index, sub), data, &mut Checked);
        assert_eq!(answer, expected, "{index:04X}:{sub} = {value:X}h");
    }
    let now = Parameters::read(&d, Direction::Transmit, 0).unwrap();
    assert_eq!(now.mapping, [mapped(0x3001, 16), mapped(0x3000, 16)]);
    assert_eq!(now.cob.to_string(), "285h");
    d.download(Address::new(0x1800, 1), &off.to_le_bytes(), &mut Checked)
        .unwrap();
    for id in restricted {
        let answer = d.download(Address::new(0x1800, 1), &u32::to_le_bytes(id), &mut Checked);
        assert_eq!(answer, Err(AbortCode::Value), "{id:03X}h");
    }
}

#[test]
fn tpdo_synchronous_types_are_sent_every_nth_sync() {
    for every in 1..=240 {
        let (mut pdo, d) = tpdo(every, |_| ());
        let sent: Vec<_> = (1..=500_usize)
            .filter(|_| pdo.handle_sync(None, &d, MS).is_some())
            .collect();
        assert_eq!(sent.len(), 500 / usize::from(every), "{every}");
        assert_eq!(pdo.poll(&d, 999 * MS), None, "never without SYNC");
    }
}

#[test]
fn tpdo_sync_start_value_aligns_transmission() {
    let (mut pdo, d) = tpdo(3, |p| p.sync_start = 2);
    let sent: Vec<_> = (0..10_u8)
        .map(|n| n % 4 + 1)
        .filter(|counter| pdo.handle_sync(Some(*counter), &d, MS).is_some())
        .collect();
    assert_eq!(sent, [2, 1, 4], "counters 2, then every third");
    pdo.start();
    assert!(pdo.handle_sync(Some(1), &d, MS).is_none(), "restarted");
}

#[test]
fn tpdo_type_0_waits_for_change_then_sync() {
    let (mut pdo, mut d) = tpdo(0, |_| ());
    assert_eq!(
        text(pdo.handle_sync(None, &d, MS)),
        "185#0000",
        "the start is an event"
    );
    assert_eq!(pdo.handle_sync(None, &d, MS), None);
    set(&mut d, 0x3000, 0x1234);
    assert_eq!(pdo.poll(&d, MS), None);
    assert_eq!(text(pdo.handle_sync(None, &d, MS)), "185#3412");
    pdo.trigger();
    assert_eq!(text(pdo.handle_sync(None, &d, MS)), "185#3412");
}

#[test]
fn tpdo_event_types_respect_inhibit_time_and_timer() {
    for kind in [254, 255] {
        let (mut pdo, mut d) = tpdo(kind, |p| (p.inhibit, p.event) = (50, 20));
        assert_eq!(pdo.poll_timeout(&d), Some(Duration::ZERO));
        assert!(pdo.poll(&d, MS).is_some(), "the start is an event");
        assert_eq!(pdo.poll(&d, 2 * MS), None);
        set(&mut d, 0x3000, 7);
        assert_eq!(pdo.poll(&d, 5 * MS), None, "inhibited for 5 ms");
        assert_eq!(pdo.poll_timeout(&d), Some(6 * MS));
        assert_eq!(text(pdo.poll(&d, 6 * MS)), "185#0700");
        assert_eq!(pdo.poll_timeout(&d), Some(26 * MS), "the event timer");
        assert_eq!(pdo.poll(&d, 25 * MS), None);
        assert!(pdo.poll(&d, 26 * MS).is_some());
        assert_eq!(pdo.handle_sync(None, &d, 30 * MS), None, "never with SYNC");
    }
}

#[test]
fn tpdo_remote_types_answer_remote_frames() {
    let (mut pdo, mut d) = tpdo(253, |_| ());
    set(&mut d, 0x3000, 1);
    assert_eq!(text(pdo.handle_remote(&d, MS)), "185#0100");
    let (mut pdo, mut d) = tpdo(252, |_| ());
    assert_eq!(pdo.handle_sync(None, &d, MS), None);
    set(&mut d, 0x3000, 2);
    assert_eq!(
        text(pdo.handle_remote(&d, MS)),
        "185#0000",
        "as sampled with SYNC"
    );
    let (mut pdo, d) = tpdo(253, |p| p.cob = PdoCob::from_raw(0x4000_0185));
    assert_eq!(pdo.handle_remote(&d, MS), None, "bit 30 forbids it");
}

#[test]
fn tpdo_disabled_or_empty_is_not_sent() {
    let (mut pdo, d) = tpdo(1, |p| p.cob = p.cob.off());
    assert_eq!((pdo.id(), pdo.handle_sync(None, &d, MS)), (None, None));
    let (mut pdo, d) = tpdo(255, |p| p.mapping.clear());
    assert_eq!(pdo.poll(&d, MS), None);
}

fn rpdo(transmission: u8, deadline: u16) -> (Rpdo, Dictionary) {
    let kind = Transmission::from_raw(transmission);
    let mapping = vec![mapped(0x2000, 16), mapped(0x0005, 8), mapped(0x2001, 16)];
    let mut parameters = Parameters::new(PdoCob::from_raw(0x205), kind, mapping);
    parameters.event = deadline;
    let d = dictionary(&parameters, Direction::Receive);
    (Rpdo::new(&d, 0).unwrap().unwrap(), d)
}

#[test]
fn rpdo_values_apply_at_once_or_with_sync() {
    let data = [1, 0, 0xEE, 2, 0];
    for kind in (0..=240).chain(254..=255) {
        let (mut pdo, mut d) = rpdo(kind, 0);
        let synchronous = kind <= 240;
        let expected = if synchronous {
            Received::Waits
        } else {
            Received::Taken
        };
        assert_eq!(pdo.handle(&data, &mut d, true, MS), expected, "{kind}");
        let at = |d: &Dictionary| d.bytes(Address::new(0x2001, 0)).unwrap()[0];
        assert_eq!(at(&d) == 2, !synchronous, "{kind}");
        assert_eq!(pdo.handle_sync(&mut d), synchronous, "{kind}");
        assert_eq!(at(&d), 2, "{kind}: the gap is passed over");
        assert!(!pdo.handle_sync(&mut d), "once");
    }
}

#[test]
fn rpdo_short_long_and_late_are_reported() {
    let (mut pdo, mut d) = rpdo(1, 10);
    let short = Received::Short {
        len: 4,
        expected: 5,
    };
    assert_eq!(pdo.handle(&[9; 4], &mut d, true, MS), short);
    assert_eq!(pdo.poll_timeout(), None, "a short one does not count");
    assert!(pdo.is_long(6) && !pdo.is_long(5));
    assert_eq!(
        pdo.handle(&[9; 8], &mut d, false, MS),
        Received::OutsideWindow
    );
    assert!(!pdo.handle_sync(&mut d));
    assert_eq!(pdo.handle(&[9; 8], &mut d, true, 2 * MS), Received::Waits);
    assert!(
        !pdo.poll(11 * MS) && pdo.poll(12 * MS) && !pdo.poll(13 * MS),
        "reported once"
    );
    assert!(pdo.is_late());
    pdo.handle(&[9; 8], &mut d, true, 20 * MS);
    assert!(
        !pdo.is_late() && pdo.poll(30 * MS),
        "and again after it came"
    );
    pdo.stop();
    assert_eq!(pdo.poll_timeout(), None);
}
