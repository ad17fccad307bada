//! Homing of the joints of a youBot by a tool: the machines of the driver, without a controller, so that single joints can
//! be homed. It ends when all joints are at their stops, or one cannot get there; then all hold.

use std::time::Duration;

use anyhow::ensure;
use takt_ethercat::youbot::{
    CURRENT_MAX_MA, Drive, DriveConfig, DriveFault, HOMING, Homing, HomingState, TRINAMIC,
};

use crate::ecat::session::{Session, Wire};

/// Period of the frames; the drives support no shorter one.
pub(super) const CYCLE: Duration = Duration::from_millis(1);
/// Timeout of the homing: commutation 5 s, longest approach 15 s.
const HOMING_MAX: Duration = Duration::from_secs(30);
/// Time for joints to come to rest, whether at their stops or not.
const REST: Duration = Duration::from_millis(200);

/// A joint and its drive.
struct Joint {
    number: usize,
    slave: usize,
    drive: Drive,
    homing: Homing,
    reported: HomingState,
}

/// Checks that these slaves are joints.
pub(super) fn check<W: Wire>(session: &Session<W>, slaves: &[usize]) -> anyhow::Result<()> {
    for number in slaves {
        let found = session.master().slave(*number);
        let name = found.map_or("", |slave| slave.info().name.as_str());
        let vendor = found.map_or(0, |slave| slave.info().identity.vendor);
        let is_joint = name.contains("1610") || name.contains("841");
        ensure!(
            vendor == TRINAMIC && is_joint,
            "slave {number} \"{name}\" is no joint of a youBot (TMCM-1610, TMCM-KR-841)\n\
             hint: `takt ecat scan` lists them"
        );
    }
    Ok(())
}

/// Homes them; the first is the first joint of the arm, and so on. Whether all are homed and have moved to their stops.
pub(super) fn home<W: Wire>(
    session: &mut Session<W>,
    slaves: &[usize],
    is_stopped: &dyn Fn() -> bool,
    mut say: impl FnMut(&str) -> anyhow::Result<()>,
) -> anyhow::Result<bool> {
    let joints = slaves.iter().zip(HOMING).zip(CURRENT_MAX_MA).enumerate();
    let joint = |(number, ((slave, homing), current_max_ma)): (usize, ((&usize, _), _))| Joint {
        number,
        slave: *slave,
        drive: Drive::new(*slave, DriveConfig::joint(number, current_max_ma)),
        homing: Homing::new(homing),
        reported: HomingState::Idle,
    };
    let mut joints: Vec<_> = joints.map(joint).collect();
    let begin = session.now()?;
    let mut good = true;
    while good && !joints.iter().all(|joint| joint.homing.is_done()) {
        let now = cycle(session, &mut joints, false)?;
        for joint in &mut joints {
            good &= joint.report(&mut say)?;
        }
        if good && now.saturating_sub(begin) > HOMING_MAX {
            for joint in joints.iter().filter(|joint| !joint.homing.is_done()) {
                say(&joint.overdue())?;
            }
            good = false;
        }
        if good && is_stopped() {
            say("stopped: the joints hold")?;
            good = false;
        }
    }
    let end = session.now()? + REST;
    while cycle(session, &mut joints, true)? < end {}
    Ok(good && joints.iter().all(|joint| joint.moved() != Some(false)))
}

/// One cycle of all joints; returns its time.
fn cycle<W: Wire>(
    session: &mut Session<W>,
    joints: &mut [Joint],
    stopping: bool,
) -> anyhow::Result<Duration> {
    let now = session.now()?;
    while let Some(reply) = session.master_mut().poll_reply() {
        let slave = reply.job.slave;
        if let Some(joint) = joints.iter_mut().find(|joint| joint.slave == slave) {
            joint.drive.mailbox().handle_reply(reply, now);
        }
    }
    for Joint { drive, homing, .. } in joints {
        let follows = drive.follows();
        let command = homing.lead(drive, follows, true, stopping, now);
        drive.exchange(session.master_mut(), command, !stopping, now);
    }
    session.cycle()?;
    Ok(now)
}

impl Joint {
    /// Why it is not homed in time.
    fn overdue(&self) -> String {
        let fault = self.drive.drive_fault();
        let why = fault.map_or_else(|| "not at its stop".to_owned(), |fault| fault.to_string());
        format!("joint {}: {why}", self.number)
    }

    /// Reports what changed; false if this joint cannot be homed.
    fn report(&mut self, say: &mut impl FnMut(&str) -> anyhow::Result<()>) -> anyhow::Result<bool> {
        let number = self.number;
        let is_lost = self.homing.is_active() && !self.drive.follows();
        if let Some(fault) = self.drive.drive_fault()
            && (is_lost || matches!(fault, DriveFault::Firmware { .. } | DriveFault::Commutation))
        {
            say(&format!("joint {number}: {fault}"))?;
            return Ok(false);
        }
        let state = self.homing.state();
        let text = |state| match state {
            HomingState::Idle
            | HomingState::Query
            | HomingState::Rest(_)
            | HomingState::Preset
            | HomingState::Mark => None,
            HomingState::Approach(..) => Some("towards its stop".to_owned()),
            HomingState::Done => Some(self.done(self.slave)),
            HomingState::Cancelled => Some("cancelled".to_owned()),
            HomingState::Failed(error) => Some(error.to_string()),
        };
        let (before, after) = (text(self.reported), text(state));
        self.reported = state;
        if after != before
            && let Some(text) = after
        {
            say(&format!("joint {number}: {text}"))?;
        }
        Ok(!matches!(state, HomingState::Failed(_)))
    }

    /// Whether the motor turned; `None` if it was not commanded to. A drive that found its commutation has turned it, off
    /// the stop, to which its weight may bring the joint back before the approach.
    fn moved(&self) -> Option<bool> {
        let has_commutated = self.drive.counters().commutations > 0;
        let moved = self.homing.has_moved();
        moved.map(|moved| moved || has_commutated)
    }

    /// How it was homed. A motor that did not move presses against its stop, or against what blocks it elsewhere.
    fn done(&self, slave: usize) -> String {
        match self.moved() {
            Some(true) => "homed".to_owned(),
            None => "homed before, since its drive was switched on: it did not move".to_owned(),
            Some(false) => format!(
                "homed where it stood: it did not move\n\
                 hint: if it does not stand at its stop, its brake or its surroundings block it: free it, \
                 `set {slave} calibrated 0`, and home it again"
            ),
        }
    }
}
