//! Proof that neither a master nor its drives allocate in the cycle: 2,000 periods of six axes under a counting
//! allocator, with a block transfer and emergencies beside them. The duration of a cycle is not checked.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_can::canopen::NodeId;
use takt_can::canopen::emcy::Source;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::canopen::network::{
    AxisCommand, AxisPlan, Event, Network, NetworkConfig, NodePlan, Phase, Transfer,
};
use takt_can::canopen::sdo::Outcome;
use takt_cia402::Goal;
use takt_cia402::dictionary::Address;
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const PERIOD: Duration = Duration::from_millis(2);
const LEN: usize = 60_000;

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

/// One period on a bus without delay: every frame reaches every node.
fn period(network: &mut Network, drives: &mut [DriveNode], now: Duration) {
    network.cycle(now);
    for _ in 0..20 {
        while let Some(frame) = network.poll_transmit(now) {
            drives
                .iter_mut()
                .for_each(|drive| drive.handle_frame(&frame, now));
        }
        for drive in &mut *drives {
            while let Some(frame) = drive.poll_transmit(now) {
                network.handle_frame(&frame, now);
            }
        }
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "one run from power-on to the count")]
fn master_and_drives_do_not_allocate_in_cycle() {
    let numbers = 1..=6;
    let plans = numbers.clone().map(|raw| {
        let mut plan = NodePlan::drive(node(raw), AxisPlan::default());
        plan.sdo_len_max = LEN;
        plan
    });
    let config = NetworkConfig {
        sdo_per_cycle: 8,
        ..NetworkConfig::default()
    };
    let mut network = Network::new(config, plans.collect()).unwrap();
    let drives = numbers.clone().map(|raw| {
        let mut config = DriveNodeConfig::new(node(raw));
        config.domain_len = LEN;
        DriveNode::power_on(config, Duration::ZERO).unwrap()
    });
    let mut drives: Vec<_> = drives.collect();
    let mut now = Duration::ZERO;
    network.start(now);
    let mut run = |network: &mut Network, drives: &mut [DriveNode], periods: u32| {
        for _ in 0..periods {
            now += PERIOD;
            period(network, drives, now);
        }
    };
    run(&mut network, &mut drives, 500);
    for raw in numbers {
        assert_eq!(network.phase(node(raw)), Some(Phase::Running));
        let axis = network.axis_mut(node(raw), 0).unwrap();
        axis.set_goal(Goal::OperationEnabled, 8);
    }
    run(&mut network, &mut drives, 500);
    assert!(
        network
            .nodes()
            .all(|n| network.axis(n, 0).unwrap().state().follows)
    );
    while network.poll_event().is_some() {}
    let read = Transfer {
        address: Address::new(0x2000, 0),
        in_blocks: true,
        data: Vec::with_capacity(LEN),
        ..Transfer::default()
    };
    network.transfer(node(3), read).unwrap();

    let allocations = Allocations::count();
    let (mut read, mut emergencies) = (None, 0);
    for n in 0..2_000_i32 {
        for axis in 1..=6 {
            let position = n * 10;
            let command = AxisCommand {
                position,
                ..AxisCommand::default()
            };
            network.axis_mut(node(axis), 0).unwrap().command(command);
        }
        let errors = drives[1].errors_mut();
        errors.raise(Source::Device(7), 0xFF01, 0x80, [0; 5]);
        errors.clear(Source::Device(7), 0xFF01);
        run(&mut network, &mut drives, 1);
        while let Some(event) = network.poll_event() {
            match event {
                Event::Transferred(_, transfer, outcome) => read = Some((transfer, outcome)),
                Event::Emergency(_, _, count) => emergencies += count,
                Event::Phase(..) | Event::Fault(..) | Event::Homed(_) | Event::Axis(_) => {}
            }
        }
    }
    assert_eq!(allocations.end(), 0);
    let (transfer, outcome) = read.unwrap();
    assert_eq!((transfer.data.len(), outcome), (LEN, Outcome::Read));
    assert!(emergencies > 3_500, "{emergencies}");
    for axis in 1..=6 {
        let state = network.axis(node(axis), 0).unwrap().state();
        assert!(
            state.follows && (state.position - 19_990).abs() < 500,
            "{state:?}"
        );
    }
}
