//! Homing of the joints of a youBot by hand: the same machines as in nets, without a net. It ends when all joints are
//! at their stops, or one cannot get there; then all hold.

use std::time::Duration;

use anyhow::ensure;
use takt_ethercat::youbot::{
    Drive, DriveConfig, DriveFault, HOMING, Homing, HomingState, TRINAMIC,
};

use crate::ecat::session::{Session, Wire};

/// From one frame to the next; the drives take no faster ones.
pub(super) const CYCLE: Duration = Duration::from_millis(1);
/// Longest it may take: commutation 5 s, the longest way 15 s.
const PATIENCE: Duration = Duration::from_secs(30);
/// Inputs older than this many cycles are none.
const GONE: u32 = 20;
/// Largest current meanwhile, mA.
const CURRENT_MAX_MA: i32 = 4000;

/// One joint on its way.
struct Joint {
    number: usize,
    drive: Drive,
    homing: Homing,
    told: HomingState,
}

/// Whether these are joints.
pub(super) fn check<W: Wire>(session: &Session<W>, slaves: &[usize]) -> anyhow::Result<()> {
    for number in slaves {
        let found = session.master().slave(*number);
        let name = found.map_or("", |slave| slave.info().name.as_str());
        let vendor = found.map_or(0, |slave| slave.info().identity.vendor);
        let is_joint = name.contains("1610") || name.contains("841");
        ensure!(
            vendor == TRINAMIC && is_joint,
            "slave {number} \"{name}\" is no joint of a youBot (TMCM-1610, TMCM-KR-841); `takt ecat scan` lists them"
        );
    }
    Ok(())
}

/// Homes them; the first is the first joint of the arm, and so on. Whether all are homed.
pub(super) fn home<W: Wire>(
    session: &mut Session<W>,
    slaves: &[usize],
    mut say: impl FnMut(&str) -> anyhow::Result<()>,
) -> anyhow::Result<bool> {
    let joint = |(number, (slave, config)): (usize, (&usize, _))| Joint {
        number,
        drive: Drive::new(
            *slave,
            DriveConfig {
                current_max_ma: CURRENT_MAX_MA,
                direction: if number == 2 { 1 } else { -1 },
            },
        ),
        homing: Homing::new(config),
        told: HomingState::Idle,
    };
    let mut joints: Vec<_> = slaves.iter().zip(HOMING).enumerate().map(joint).collect();
    let begin = session.now()?;
    let mut good = true;
    while good && !joints.iter().all(|joint| joint.homing.is_done()) {
        let now = session.now()?;
        while let Some(reply) = session.master_mut().poll_reply() {
            let slave = reply.job.slave;
            if let Some(joint) = joints.iter_mut().find(|joint| joint.drive.slave() == slave) {
                joint.drive.mailbox().handle_reply(reply, now);
            }
        }
        for joint in &mut joints {
            joint.lead(session, now);
            good &= joint.report(&mut say)?;
        }
        if now.saturating_sub(begin) > PATIENCE {
            for joint in joints.iter().filter(|joint| !joint.homing.is_done()) {
                let why = joint.drive.drive_fault();
                let why = why.map_or_else(|| "not at its stop".to_owned(), |why| why.to_string());
                say(&format!("joint {}: {why}", joint.number))?;
            }
            good = false;
        }
        session.cycle()?;
    }
    for joint in &mut joints {
        joint.homing.cancel();
    }
    // Time to come to rest, whether at the stop or not.
    let end = session.now()? + Duration::from_millis(200);
    while session.now()? < end {
        let now = session.now()?;
        for joint in &mut joints {
            joint.lead(session, now);
        }
        session.cycle()?;
    }
    Ok(good)
}

impl Joint {
    fn lead<W: Wire>(&mut self, session: &mut Session<W>, now: Duration) {
        let Self { drive, homing, .. } = self;
        let told = drive.feedback().copied().filter(|_| drive.follows());
        if told.is_some() && homing.state() == HomingState::Idle {
            homing.start();
        }
        let wanted = told.and_then(|told| homing.cycle(&told, drive.mailbox(), true, now));
        let slave = drive.slave();
        let master = session.master_mut();
        let (bytes, age) = master.inputs(slave);
        let inputs = (age <= GONE && !bytes.is_empty()).then_some(bytes);
        let command = drive.cycle(inputs, wanted, true, now);
        if let Some(outputs) = master.outputs_mut(slave).first_chunk_mut() {
            *outputs = command.encode();
        }
        drive.mailbox().poll(master, now);
    }

    /// Tells what changed; false if this joint cannot be homed.
    fn report(&mut self, say: &mut impl FnMut(&str) -> anyhow::Result<()>) -> anyhow::Result<bool> {
        let number = self.number;
        let lost = self.homing.is_active() && !self.drive.follows();
        if let (true, Some(why)) = (lost, self.drive.drive_fault()) {
            say(&format!("joint {number}: {why}"))?;
            return Ok(false);
        }
        if let Some(why @ (DriveFault::Firmware { .. } | DriveFault::Commutation)) =
            self.drive.drive_fault()
        {
            say(&format!("joint {number}: {why}"))?;
            return Ok(false);
        }
        let state = self.homing.state();
        let word = |state| match state {
            HomingState::Idle | HomingState::Query | HomingState::Rest(_) => None,
            HomingState::Preset | HomingState::Mark => None,
            HomingState::Approach(..) => Some("towards its stop".to_owned()),
            HomingState::Done => Some("homed".to_owned()),
            HomingState::Cancelled => Some("cancelled".to_owned()),
            HomingState::Failed(error) => Some(error.to_string()),
        };
        let (before, after) = (word(self.told), word(state));
        self.told = state;
        if after != before
            && let Some(text) = after
        {
            say(&format!("joint {number}: {text}"))?;
        }
        Ok(!matches!(state, HomingState::Failed(_)))
    }
}
