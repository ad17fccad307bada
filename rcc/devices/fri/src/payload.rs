//! Gravity compensation of an FRI arm: the torques that hold a payload which the robot's controller does not know of, for an overlay
//! in joint impedance. Only added torques carry it: in position control the controller holds the arm, and in Cartesian impedance the
//! payload is the controller's business.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector3;
use takt_motion::Model;
use takt_motion::dynamics::{Body, Down, Payload, weight};
use takt_net::device::Kinematics;

use crate::fri::{AXES, Joints};

/// The torques rise within this time once the arm follows: the springs hold the weight until then.
const FADE: Duration = Duration::from_millis(500);

/// The weight of a payload.
#[derive(Debug)]
pub(crate) struct Weight {
    kinematics: Arc<dyn Kinematics>,
    load: Body,
    gravity: Vector3<f64>,
    /// Since when the arm follows.
    since: Option<Duration>,
}

impl Weight {
    /// Of an arm with that model; `None` without a payload.
    pub(crate) fn new(model: &Model, payload: &Payload, down: &Down) -> Option<Self> {
        let kinematics = model.unlimited().filter(|it| it.joints() == AXES)?;
        (payload.mass > 0.0).then(|| Self {
            kinematics,
            load: payload.body(),
            gravity: down.gravity(),
            since: None,
        })
    }

    /// The torques at these measured positions at session time `now`, within the largest ones, Nm; 0 while the arm does not follow
    /// or its position is unknown.
    pub(crate) fn torques(
        &mut self,
        measured: Option<Joints>,
        follows: bool,
        now: Duration,
        most: &Joints,
    ) -> Joints {
        let Some(joints) = measured.filter(|_| follows) else {
            self.since = None;
            return [0.0; AXES];
        };
        let since = *self.since.get_or_insert(now);
        let share = now.saturating_sub(since).as_secs_f64() / FADE.as_secs_f64();
        let mut torques = [0.0; AXES];
        weight(
            &*self.kinematics,
            &joints,
            &self.load,
            &self.gravity,
            &mut torques,
        );
        for (torque, most) in torques.iter_mut().zip(most) {
            let wanted = *torque * share.min(1.0);
            *torque = if wanted.is_finite() {
                wanted.max(-most).min(*most)
            } else {
                0.0
            };
        }
        torques
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fri_payload_weight_rises_and_ends_with_following() {
        let payload = Payload {
            mass: 3.0,
            centre_of_mass: [0.0, 0.0, 0.1],
        };
        let model = "kuka_lwr4".into();
        assert!(Weight::new(&model, &Payload::default(), &Down::default()).is_none());
        let mut arm = Weight::new(&model, &payload, &Down::default()).unwrap();
        // Bent forward: joint 2 holds the payload with its lever.
        let bent = [0.0, std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0, 0.0, 0.0];
        let most = [100.0; AXES];
        let at = Duration::from_millis;
        let is_none = |torques: Joints| torques.iter().all(|torque| torque.abs() < 1e-12);
        assert!(is_none(arm.torques(Some(bent), false, at(0), &most)));
        assert!(arm.torques(Some(bent), true, at(10), &most)[1].abs() < 1e-9);
        let half = arm.torques(Some(bent), true, at(260), &most)[1];
        let whole = arm.torques(Some(bent), true, at(600), &most)[1];
        assert!((half - whole / 2.0).abs() < 1e-9, "{half} {whole}");
        let lever = 0.4 + 0.39 + 0.078 + 0.1;
        assert!((whole.abs() - 3.0 * 9.80665 * lever).abs() < 0.5, "{whole}");
        let capped = arm.torques(Some(bent), true, at(700), &[5.0; AXES])[1];
        assert!((capped.abs() - 5.0).abs() < 1e-12, "{capped}");
        assert!(is_none(arm.torques(None, true, at(800), &most)));
        assert!(
            arm.torques(Some(bent), true, at(900), &most)[1].abs() < 1e-9,
            "it rises again"
        );
    }
}
