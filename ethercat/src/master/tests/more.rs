//! Groups, slaves without LRW, goals below OP, watchdogs, trees.

use super::*;
use crate::emulator::{PdoImage, Plain, SiiImage, Slave, SlaveConfig};
use crate::{Command, Frame, register};

/// A terminal whose SII excludes LRW.
fn without_lrw() -> Slave {
    let pdo = |index, sm| PdoImage {
        index,
        sync_manager: sm,
        name: "byte".to_owned(),
        entries: vec![(0x7000, 1, 8, 5)],
    };
    let sii = SiiImage {
        name: "old".to_owned(),
        flags: 0x02,
        rx_pdos: vec![pdo(0x1600, 0)],
        tx_pdos: vec![pdo(0x1A00, 1)],
        ..SiiImage::default()
    };
    Slave::new(SlaveConfig::new(sii), Box::new(Plain))
}

fn commands(rig: &mut Rig) -> Vec<Command> {
    let mut frame = [0; 1500];
    let len = rig.master.poll_transmit(rig.now, &mut frame).unwrap();
    let frame = Frame::decode(&frame[..len]).unwrap();
    frame
        .datagrams()
        .map(|datagram| datagram.unwrap().header.command)
        .collect()
}

#[test]
fn group_with_slave_without_lrw_uses_two_datagrams() {
    let (terminal, _) = Io::digital(8, 8);
    let mut other = SlaveSpec::new("old", Location::Position(1));
    other.group = 3;
    let slaves = vec![SlaveSpec::new("new", Location::Position(0)), other];
    let config = MasterConfig {
        slaves,
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([terminal, without_lrw()]));
    rig.until(3000, Master::is_operational);
    rig.cycles(3);
    let counters: Vec<_> = rig
        .master
        .groups()
        .iter()
        .map(|group| (group.counter, group.expected))
        .collect();
    assert_eq!((counters[0], counters[3]), ((3, (3, 3)), (2, (2, 2))));
    let sent = commands(&mut rig);
    let logical: Vec<_> = sent
        .into_iter()
        .filter(|command| command.is_logical())
        .collect();
    assert_eq!(logical, [Command::Lrw, Command::Lwr, Command::Lrd]);
}

#[test]
fn group_cut_off_does_not_disturb_the_other() {
    let slaves: Vec<_> = (0..4).map(|_| Io::digital(8, 8).0).collect();
    let spec = |position: u16| SlaveSpec {
        group: u8::from(position >= 2),
        ..SlaveSpec::new(format!("io {position}"), Location::Position(position))
    };
    let config = MasterConfig {
        slaves: (0..4).map(spec).collect(),
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line(slaves));
    rig.until(3000, Master::is_operational);
    rig.cycles(3);
    let misses = rig.master.groups()[0].misses;
    rig.segment.set_link(2, false);
    for _ in 0..20 {
        rig.cycle();
        assert_eq!(rig.master.inputs(0).1, 0, "not one cycle is missed");
    }
    assert_eq!(rig.master.groups()[0].misses, misses);
    assert!(rig.master.groups()[1].misses > 0);
}

#[test]
fn goals_below_op_are_reached_and_held() {
    for (goal, state) in [
        (AlState::PreOp, AlState::PreOp),
        (AlState::SafeOp, AlState::SafeOp),
    ] {
        let (terminal, _) = Io::digital(8, 8);
        let mut rig = Rig::new(
            MasterConfig {
                goal,
                ..MasterConfig::default()
            },
            Segment::line([terminal]),
        );
        rig.until(3000, Master::is_operational);
        rig.cycles(300);
        assert_eq!(rig.segment.slave(0).unwrap().state(), state);
        assert_eq!(rig.master.is_exchanging(), goal == AlState::SafeOp);
    }
}

#[test]
fn watchdog_is_set_as_configured() {
    let terminal = Io::digital(8, 8).0.with_firmware();
    let watchdog = Some(Duration::from_micros(24_950));
    let slaves = vec![SlaveSpec {
        watchdog,
        ..SlaveSpec::new("io", Location::Position(0))
    }];
    let mut rig = Rig::new(
        MasterConfig {
            slaves,
            ..MasterConfig::default()
        },
        Segment::line([terminal]),
    );
    rig.until(3000, Master::is_operational);
    let at = register::WATCHDOG_PROCESS_DATA;
    let kind = JobKind::ReadRegister { at, len: 2 };
    rig.master
        .submit(Job {
            slave: 0,
            kind,
            data: Vec::with_capacity(2),
            token: 0,
        })
        .unwrap();
    rig.cycles(10);
    assert_eq!(
        rig.master.poll_reply().unwrap().job.data,
        250_u16.to_le_bytes()
    );
    // Nothing is sent for longer than that.
    rig.now += Duration::from_millis(30);
    rig.cycles(4);
    let text = rig.events.last().unwrap().to_string();
    assert!(text.contains("SyncManager watchdog (001Bh)"), "{text}");
    rig.until(2000, Master::is_operational);
}

#[test]
fn tree_is_scanned_and_cut_branch_named() {
    let mut segment = Segment::default();
    let root = segment.add(Coupler::slave(), None);
    // Ring order: 0, the branch at port 3, the branch at port 1.
    let branch = segment.add(Io::digital(8, 8).0, Some((root, 3)));
    segment.add(Io::digital(8, 8).0, Some((branch, 1)));
    segment.add(Io::digital(8, 8).0, Some((root, 1)));
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.until(3000, Master::is_operational);
    let parents: Vec<_> = (0..4).map(|n| rig.master.topology().parent(n)).collect();
    assert_eq!(parents, [None, Some((0, 3)), Some((1, 1)), Some((0, 1))]);
    rig.events.clear();
    rig.segment.set_link(branch, false);
    rig.cycles(4);
    let cut = rig.events.iter().find_map(|event| {
        let Event::CableCut { cable } = event else {
            return None;
        };
        Some(*cable)
    });
    assert_eq!(
        cut,
        Some(Cable {
            from: Some((0, 3)),
            to: Some(1)
        })
    );
    rig.cycles(20);
    assert!(rig.master.slave(3).unwrap().is_running());
    assert_eq!(rig.master.inputs(3).1, 0);
    rig.segment.set_link(branch, true);
    rig.until(3000, Master::is_operational);
}

#[test]
fn image_too_large_is_refused_with_its_size() {
    let slaves: Vec<_> = (0..10).map(|_| Io::analogue(40, 40).0).collect();
    let mut rig = Rig::new(MasterConfig::default(), Segment::line(slaves));
    rig.until(6000, |master| master.phase() == Phase::Refused);
    assert_eq!(rig.master.image_too_large(), Some(1600));
}

#[test]
fn restart_scans_the_segment_again() {
    let (terminal, _) = Io::digital(8, 8);
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([terminal]));
    rig.until(3000, Master::is_operational);
    let sent = rig.master.frames().sent;
    rig.master.restart();
    assert_eq!(rig.master.phase(), Phase::Count);
    rig.until(3000, Master::is_operational);
    assert!(rig.master.frames().sent > sent, "counters go on");
}
