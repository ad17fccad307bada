//! ethercrab as the master of the segment: scan, SDOs, clocks, OP, two drives that follow positions.

#[path = "../../../ethercat/tests/peers/crab.rs"]
pub(super) mod client;

use std::time::Duration;

use ethercrab::error::Error;
use ethercrab::std::ethercat_now;
use ethercrab::subdevice_group::{DcConfiguration, HasDc, Op};
use ethercrab::{DcSync, DefaultLock, MainDevice, MainDeviceConfig, SubDeviceGroup};

pub(super) const SLAVES: usize = 8;
pub(super) const IMAGE: usize = 128;
const CYCLE: Duration = Duration::from_millis(4);

/// Writes the command of one drive: controlword and position.
pub(crate) fn command(outputs: &mut [u8], word: u16, target: i32) {
    outputs.fill(0);
    outputs[..2].copy_from_slice(&word.to_le_bytes());
    outputs[2] = 8;
    outputs[4..8].copy_from_slice(&target.to_le_bytes());
}

pub(crate) fn feedback(inputs: &[u8]) -> (u16, i32) {
    let word = u16::from_le_bytes([inputs[0], inputs[1]]);
    (word, i32::from_le_bytes(inputs[4..8].try_into().unwrap()))
}

pub(crate) const fn follow(word: u16) -> u16 {
    match word & 0x6F {
        0x21 => 0x07,
        0x23 | 0x27 => 0x0F,
        state if state & 0x4F == 0x08 => 0x80,
        _ => 0x06,
    }
}

/// One drive: its feedback, and where it started.
#[derive(Clone, Copy)]
struct Axis {
    start: i32,
    word: u16,
    position: i32,
}

impl Axis {
    /// Enables the drive by its statusword; `steps` is its target, relative to the start.
    fn cycle(&mut self, inputs: &[u8], outputs: &mut [u8], steps: Option<i32>) {
        (self.word, self.position) = feedback(inputs);
        match steps {
            None => {
                self.start = self.position;
                command(outputs, follow(self.word), self.position);
            }
            Some(steps) => command(outputs, 0x0F, self.start + steps),
        }
    }
}

/// A main device that aligns clocks statically before it starts.
pub(super) fn start(interface: &str) -> &'static MainDevice<'static> {
    let config = MainDeviceConfig {
        dc_static_sync_iterations: 500,
        ..MainDeviceConfig::default()
    };
    client::start(interface, config).unwrap()
}

pub(crate) fn drive(interface: &str) {
    client::block_on(run(start(interface))).unwrap();
}

/// Brings a configured group to OP with SYNC0 in half of the cycle.
pub(super) async fn into_op(
    main: &MainDevice<'_>,
    group: SubDeviceGroup<SLAVES, IMAGE>,
) -> Result<SubDeviceGroup<SLAVES, IMAGE, DefaultLock, Op, HasDc>, Error> {
    let group = group.into_pre_op_pdi(main).await?;
    for _ in 0..300 {
        group.tx_rx_sync_system_time(main).await?;
        std::thread::sleep(Duration::from_millis(1));
    }
    let configuration = DcConfiguration {
        start_delay: Duration::from_millis(100),
        sync0_period: CYCLE,
        sync0_shift: CYCLE / 2,
    };
    let group = group.configure_dc_sync(main, configuration).await?;
    let group = group.into_safe_op(main).await?;
    let group = group.request_into_op(main).await?;
    for n in 0.. {
        let response = group.tx_rx_dc(main).await?;
        if response.all_op() {
            break;
        }
        assert!(n < 1000, "{:?}", response.group_state());
        std::thread::sleep(response.extra.next_cycle_wait);
    }
    Ok(group)
}

async fn run(main: &MainDevice<'_>) -> Result<(), Error> {
    let mut group = main
        .init_single_group::<SLAVES, IMAGE>(ethercat_now)
        .await?;
    let names: Vec<_> = group.iter(main).map(|s| s.name().to_owned()).collect();
    assert_eq!(names, ["TK1100", "TK0808", "TK0101", "TK4021", "TK4021"]);
    for mut slave in group.iter_mut(main) {
        if slave.name() != "TK4021" {
            continue;
        }
        assert_eq!(slave.sdo_read::<u32>(0x1000, 0).await?, 0x0002_0192);
        slave.sdo_write(0x6083, 0, 54_321_u32).await?;
        assert_eq!(slave.sdo_read::<u32>(0x6083, 0).await?, 54_321);
        let refused = slave.sdo_read::<u32>(0x3000, 0).await;
        assert!(matches!(refused, Err(Error::Mailbox(_))), "{refused:?}");
        slave.sdo_write(0x10F1, 2, 1000_u16).await?;
        slave.sdo_write_array(0x1C12, &[0x1600_u16]).await?;
        slave.sdo_write_array(0x1C13, &[0x1A00_u16]).await?;
        slave.set_dc_sync(DcSync::Sync0);
    }
    let group = into_op(main, group).await?;
    let mut axes = [Axis {
        start: 0,
        word: 0,
        position: 0,
    }; 2];
    let (mut step, mut missed) = (0, 0);
    for _ in 0..1000 {
        let response = group.tx_rx_dc(main).await?;
        let enabled = axes.iter().all(|axis| axis.word & 0x6F == 0x27);
        if enabled || step > 0 {
            step += 1;
            missed += u32::from(response.working_counter != 12);
        }
        let far = (step > 0).then_some(20 * step.min(250));
        for (slave, axis) in group.iter(main).skip(3).zip(&mut axes) {
            // One lock covers both sides.
            let inputs = slave.inputs_raw().to_vec();
            axis.cycle(&inputs, &mut slave.outputs_raw_mut(), far);
        }
        let digital = group.subdevice(main, 1)?;
        digital.outputs_raw_mut()[0] = 0xA5;
        if step == 270 {
            break;
        }
        std::thread::sleep(response.extra.next_cycle_wait);
    }
    assert_eq!((step, missed), (270, 0));
    for axis in axes {
        let distance = axis.position - axis.start;
        assert!((4900..=5010).contains(&distance), "{distance} increments");
    }
    let digital = group.subdevice(main, 1)?;
    assert_eq!(digital.inputs_raw()[0], 0xA5);
    Ok(())
}
