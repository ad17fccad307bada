//! The slaves of a KUKA youBot: power boards, four wheel drives, five joint drives and the gripper behind the last,
//! with the process data of both firmwares and the raw TMCL mailbox. Masses and friction are plausible rather than
//! measured; joints are coupled by weight, but not dynamically.

mod gripper;
mod joint;
mod parameters;
mod tmcl;
mod weight;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::sii::Identity;
use crate::{AlState, AlStatusCode};

use super::application::{Application, Cycle, Plain, Setup};
use super::image::{PdoImage, SiiImage};
use super::segment::Segment;
use super::slave::{Slave, SlaveConfig};

pub use crate::youbot::Firmware;
pub use gripper::Bar;
pub use joint::{Axis, Joint};
use weight::Posture;

/// Vendor number of Trinamic.
const TRINAMIC: u32 = 0x0000_0286;
/// Length of each mailbox, bytes; TMCL uses eight of it.
const MAILBOX: u16 = 16;

/// Firmware versions of the drives.
const fn text(firmware: Firmware) -> &'static str {
    match firmware {
        Firmware::V148 => "V148",
        Firmware::V200 => "V200",
    }
}

/// The electronics: drivers identify it by the names in the SII.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Boards {
    /// TMCM-174 at the wheels, TMCM-KR-841 at the joints.
    Old,
    /// TMCM-1632 at the wheels, TMCM-1610 at the joints.
    #[default]
    New,
}

impl Boards {
    const fn names(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Old => ("TMCM-174", "TMCM-KR-841", "KR-843"),
            Self::New => ("TMCM-1632", "TMCM-1610", "KR-845"),
        }
    }
}

/// Configuration of a youBot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YouBotConfig {
    /// Firmware of all drives.
    pub firmware: Firmware,
    /// Electronics of all drives.
    pub boards: Boards,
    /// Whether there is a base with four wheels.
    pub base: bool,
    /// Arms with a gripper each, 0 to 2.
    pub arms: usize,
    /// Product numbers of board, wheel drive and joint drive; the real ones are not published.
    pub products: (u32, u32, u32),
    /// Distance of each joint of an arm from its home stop at power-on, rad.
    pub folded: [f64; 5],
}

impl Default for YouBotConfig {
    /// A base and one arm, folded: eleven slaves.
    fn default() -> Self {
        Self {
            firmware: Firmware::default(),
            boards: Boards::default(),
            base: true,
            arms: 1,
            products: (0x0845, 0x1632, 0x1610),
            folded: [0.1, 0.08, 0.1, 0.08, 0.1],
        }
    }
}

/// An emulated youBot: handles to its drives, which their slaves share.
#[derive(Clone, Debug)]
pub struct YouBot {
    /// Wheels: left front, right front, left back, right back.
    pub wheels: Vec<DriveHandle>,
    /// The joints of each arm, from the base on.
    pub arms: Vec<Vec<DriveHandle>>,
}

impl YouBot {
    /// Its slaves in order, and the handles.
    pub fn slaves(config: &YouBotConfig) -> (Vec<Slave>, Self) {
        let (wheel, joint, arm_board) = config.boards.names();
        let mut slaves = Vec::new();
        let mut bot = Self {
            wheels: Vec::new(),
            arms: Vec::new(),
        };
        let add = |slaves: &mut Vec<Slave>, name, product, axis, arm| {
            let (slave, handle) = drive(config.firmware, name, product, axis, arm);
            slaves.push(slave);
            handle
        };
        let (_, wheel_product, joint_product) = config.products;
        if config.base {
            slaves.push(board("KR-845", config.products.0));
            for _ in 0..4 {
                let handle = add(&mut slaves, wheel, wheel_product, Axis::wheel(), None);
                bot.wheels.push(handle);
            }
        }
        for _ in 0..config.arms.min(2) {
            slaves.push(board(arm_board, config.products.0));
            let posture = Posture::new(config.folded);
            let axes = config.folded.iter().enumerate();
            let arm = axes.map(|(n, folded)| {
                let axis = Axis::joint(n, *folded);
                let arm = Some((posture.clone(), n));
                add(&mut slaves, joint, joint_product, axis, arm)
            });
            let arm = arm.collect();
            bot.arms.push(arm);
        }
        (slaves, bot)
    }

    /// Its segment and the handles.
    pub fn segment(config: &YouBotConfig) -> (Segment, Self) {
        let (slaves, bot) = Self::slaves(config);
        (Segment::line(slaves), bot)
    }
}

/// A power board: a slave without mailbox and process data.
fn board(name: &str, product: u32) -> Slave {
    let sii = SiiImage {
        identity: identity(product),
        order: name.to_owned(),
        name: name.to_owned(),
        ..SiiImage::default()
    };
    Slave::new(SlaveConfig::new(sii), Box::new(Plain))
}

const fn identity(product: u32) -> Identity {
    Identity {
        vendor: TRINAMIC,
        product,
        revision: 1,
        serial: 0,
    }
}

fn drive(
    firmware: Firmware,
    name: &str,
    product: u32,
    axis: Axis,
    arm: Option<(Posture, usize)>,
) -> (Slave, DriveHandle) {
    // Type codes of CiA 301: 4 is INTEGER32, 7 UNSIGNED32, 5 UNSIGNED8.
    let pdo = |index, sync_manager, name: &str, types: &[(u8, u8)]| PdoImage {
        index,
        sync_manager,
        name: name.to_owned(),
        entries: (1..)
            .zip(types)
            .map(|(sub, (bits, data_type))| (0x7000 + index % 0x1600, sub, *bits, *data_type))
            .collect(),
    };
    let inputs: &[(u8, u8)] = match firmware {
        Firmware::V148 => &[(32, 4), (32, 4), (32, 4), (32, 7), (32, 4)],
        Firmware::V200 => &[
            (32, 4),
            (32, 4),
            (32, 4),
            (32, 7),
            (32, 4),
            (32, 4),
            (32, 4),
            (32, 4),
        ],
    };
    let sii = SiiImage {
        identity: identity(product),
        order: name.to_owned(),
        name: name.to_owned(),
        mailbox_len: MAILBOX,
        unwatched: true,
        rx_pdos: vec![pdo(0x1600, 2, "command", &[(32, 4), (8, 5)])],
        tx_pdos: vec![pdo(0x1A00, 3, "feedback", inputs)],
        ..SiiImage::default()
    };
    // The four digits of the board, as reported by the firmware.
    let digits: String = name.chars().filter(char::is_ascii_digit).collect();
    let version = format!("{digits:0>4}{}", text(firmware));
    let handle = DriveHandle(Arc::new(Mutex::new(Joint::new(
        axis, arm, firmware, version,
    ))));
    let slave = Slave::new(SlaveConfig::new(sii), Box::new(handle.clone()));
    (slave, handle)
}

/// A handle to a drive of a youBot.
#[derive(Clone, Debug)]
pub struct DriveHandle(Arc<Mutex<Joint>>);

impl DriveHandle {
    /// Access to the drive, to push it or inject faults.
    pub fn lock(&self) -> MutexGuard<'_, Joint> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Application for DriveHandle {
    fn enter(&mut self, state: AlState, setup: &Setup) -> Result<(), AlStatusCode> {
        if state != AlState::SafeOp {
            return Ok(());
        }
        if setup.outputs != 5 {
            return Err(AlStatusCode(0x001D));
        }
        if setup.inputs != self.lock().firmware().inputs_len() {
            return Err(AlStatusCode(0x001E));
        }
        Ok(())
    }

    fn has_raw_mailbox(&self) -> bool {
        true
    }

    fn mailbox(&mut self, request: &[u8], reply: &mut Vec<u8>) -> bool {
        self.lock().tmcl(request, reply)
    }

    fn cycle(&mut self, cycle: &Cycle<'_>, inputs: &mut [u8]) {
        let mut joint = self.lock();
        if cycle.fresh
            && let Some(outputs) = cycle.outputs
        {
            joint.command(outputs);
        }
        joint.step(cycle.dt, cycle.state == AlState::Op, cycle.fresh);
        joint.feedback(inputs);
    }

    fn reset(&mut self) {
        self.lock().reset();
    }
}
