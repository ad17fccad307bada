//! Mass and centre of the load of an arm from torques during slow motions of its joints, for arms of any kinematics. Friction of
//! joints is found along with it; acceleration is not: give samples of steady motion. Inertia is not found here, see
//! [`identify`](super::identify).

use nalgebra::{DMatrix, DVector, Vector3};
use takt_net::device::Kinematics;

use super::load::weight;
use super::{Body, Dynamics, Sample};
use crate::kinematics::JOINTS_MAX;

/// Mass and its three moments.
const LOAD: usize = 4;
/// A joint slower than this may stick: its torque says nothing of the load, rad/s.
const MOVES: f64 = 0.005;
/// Greatest ratio of the singular values, with columns of length 1, of a motion that separates all parameters.
const CONDITION_MAX: f64 = 300.0;
/// Uncertainty of the mass, kg and as a share of it, beyond which it is refused: three standard deviations.
const MASS_UNSURE: f64 = 0.15;
const SHARE_UNSURE: f64 = 0.1;
/// Residual, Nm and as a share of the torques to be explained, beyond which the model does not fit.
const RESIDUAL_LEAST: f64 = 0.5;
const RESIDUAL_SHARE: f64 = 0.25;

/// A load as it was weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighing {
    /// Mass, kg; not below 0 by more than its uncertainty.
    pub mass: f64,
    /// Centre of mass in the flange, m; 0 for a mass that is none within its uncertainty.
    pub centre: Vector3<f64>,
    /// Three standard deviations of the mass, kg.
    pub uncertainty: f64,
    /// Root mean square of what load and friction do not explain, Nm.
    pub residual: f64,
    /// Root mean square of the torques to be explained, Nm.
    pub torques: f64,
    /// How many torques were used.
    pub readings: usize,
}

/// Why a load was not weighed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum WeighError {
    /// A sample of another arm.
    #[error(
        "sample {0} has not as many motions and torques as the arm has joints, or one that is not finite"
    )]
    Sample(usize),
    /// Too few samples of joints that move.
    #[error(
        "{0} torques of joints that move are too few\nhint: torques must arrive during the motion; move for longer"
    )]
    Few(usize),
    /// Mass, centre and friction look alike in this motion.
    #[error(
        "the motion does not separate mass and centre of mass (condition {0:.0}, at most {CONDITION_MAX:.0})\nhint: begin in a bent pose, away from limits, and swing wider, so that the flange points sideways, up and down"
    )]
    Motion(f64),
    /// The mass is too uncertain.
    #[error(
        "the mass is {mass:.2} kg within {uncertainty:.2} kg, which is too uncertain\nhint: swing wider and slower, or begin in a pose in which the load has a longer lever"
    )]
    Uncertain {
        /// Mass, kg.
        mass: f64,
        /// Three standard deviations, kg.
        uncertainty: f64,
    },
    /// Something else than a load acts.
    #[error(
        "a load explains these torques badly: {residual:.2} Nm of {torques:.2} Nm are left\nhint: nothing may touch the arm; check the masses of its URDF, `rated_torque`, its sign and that of `increments_per_turn`"
    )]
    Residual {
        /// Root mean square of what is left, Nm.
        residual: f64,
        /// Root mean square of the torques, Nm.
        torques: f64,
    },
    /// A load that lifts.
    #[error(
        "the mass would be {0:.2} kg\nhint: check the direction of gravity (`down`), the sign of `rated_torque`, and that the stated load is not larger than the real one"
    )]
    Negative(f64),
}

/// Rows of the torques of joints that move, and what is to be explained.
struct Rows {
    columns: Vec<[f64; LOAD + 2]>,
    joints: Vec<usize>,
    rest: Vec<f64>,
}

/// Weighs the load of an arm from samples of slow, steady motions. `own` is the arm without that load, where its torques are those
/// of the whole arm; `None` where they are without the arm's own, as external torques are. `gravity` is its acceleration in the
/// base of the arm, m/s².
///
/// # Errors
/// If a sample does not fit the arm, or the samples do not show the load well enough.
pub fn weigh(
    arm: &dyn Kinematics,
    own: Option<&Dynamics>,
    samples: &[Sample],
    gravity: &Vector3<f64>,
) -> Result<Weighing, WeighError> {
    let rows = rows(arm, own, samples, gravity)?;
    let count = rows.rest.len();
    let moving: Vec<_> = (0..arm.joints())
        .filter(|joint| rows.joints.contains(joint))
        .collect();
    let parameters = LOAD + 2 * moving.len();
    if count < 10 * parameters {
        return Err(WeighError::Few(count));
    }
    let mut matrix = DMatrix::zeros(count, parameters);
    for (row, (values, joint)) in rows.columns.iter().zip(&rows.joints).enumerate() {
        let place = moving.iter().position(|it| it == joint).unwrap_or(0);
        for (column, value) in values.iter().enumerate() {
            let at = if column < LOAD {
                column
            } else {
                2 * place + column
            };
            matrix[(row, at)] = *value;
        }
    }
    let rest = DVector::from_vec(rows.rest);
    judge(matrix, &rest)
}

/// Solves the equations and refuses a poor answer.
fn judge(mut matrix: DMatrix<f64>, rest: &DVector<f64>) -> Result<Weighing, WeighError> {
    let original = matrix.clone();
    // Columns of length 1, so that units do not matter.
    let lengths: Vec<_> = matrix
        .column_iter()
        .map(|it| it.norm().max(f64::MIN_POSITIVE))
        .collect();
    for (mut column, length) in matrix.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let parts = matrix.svd(true, true);
    let condition = parts.singular_values.max() / parts.singular_values.min();
    let scaled = parts.solve(rest, 0.0).ok();
    let (Some(scaled), true) = (scaled, condition <= CONDITION_MAX) else {
        return Err(WeighError::Motion(condition));
    };
    let mut found = scaled;
    for (value, length) in found.iter_mut().zip(&lengths) {
        *value /= length;
    }
    let left = rest - &original * &found;
    #[expect(clippy::cast_precision_loss, reason = "a number of samples")]
    let [rows, free] = [rest.len(), rest.len() - found.len()].map(|it| it as f64);
    let residual = (left.norm_squared() / rows).sqrt();
    let torques = (rest.norm_squared() / rows).sqrt();
    // The variance of the mass by that of the torques.
    let spread = parts.v_t.as_ref().map_or(f64::INFINITY, |turned| {
        let shares = turned.column(0).into_iter().zip(&parts.singular_values);
        shares.map(|(share, value)| (share / value).powi(2)).sum()
    });
    let deviation = (left.norm_squared() / free * spread).sqrt() / lengths[0];
    let (mass, uncertainty) = (found[0], 3.0 * deviation);
    if residual > RESIDUAL_LEAST.max(RESIDUAL_SHARE * torques) {
        return Err(WeighError::Residual { residual, torques });
    }
    if uncertainty > MASS_UNSURE.max(SHARE_UNSURE * mass) {
        return Err(WeighError::Uncertain { mass, uncertainty });
    }
    if mass < -MASS_UNSURE.max(uncertainty) {
        return Err(WeighError::Negative(mass));
    }
    let has_mass = mass > uncertainty.max(1e-3);
    Ok(Weighing {
        mass,
        centre: if has_mass {
            Vector3::new(found[1], found[2], found[3]) / mass
        } else {
            Vector3::zeros()
        },
        uncertainty,
        residual,
        torques,
        readings: rest.len(),
    })
}

fn rows(
    arm: &dyn Kinematics,
    own: Option<&Dynamics>,
    samples: &[Sample],
    gravity: &Vector3<f64>,
) -> Result<Rows, WeighError> {
    let joints = arm.joints();
    let mut rows = Rows {
        columns: Vec::new(),
        joints: Vec::new(),
        rest: Vec::new(),
    };
    let units: [Body; LOAD] = std::array::from_fn(|number| Body {
        mass: if number == 0 { 1.0 } else { 0.0 },
        moment: Vector3::from_fn(|i, _| if i + 1 == number { 1.0 } else { 0.0 }),
        ..Body::default()
    });
    for (number, Sample { motions, torques }) in samples.iter().enumerate() {
        let values = motions.iter().flatten().chain(torques);
        let fits = [motions.len(), torques.len()] == [joints; 2] && joints <= JOINTS_MAX;
        if !fits || values.into_iter().any(|value| !value.is_finite()) {
            return Err(WeighError::Sample(number));
        }
        let positions: Vec<_> = motions.iter().map(|it| it[0]).collect();
        let mut of_load = [[0.0; JOINTS_MAX]; LOAD];
        for (unit, torques) in units.iter().zip(&mut of_load) {
            weight(arm, &positions, unit, gravity, &mut torques[..joints]);
        }
        let mut of_arm = [0.0; JOINTS_MAX];
        if let Some(own) = own {
            let steady: Vec<_> = motions.iter().map(|[at, by, _]| [*at, *by, 0.0]).collect();
            own.torques(&steady, gravity, &mut of_arm[..joints]);
        }
        for (joint, (torque, [_, speed, _])) in torques.iter().zip(motions).enumerate() {
            if speed.abs() < MOVES {
                continue;
            }
            let [mass, x, y, z] = of_load.map(|it| it[joint]);
            rows.columns.push([mass, x, y, z, speed.signum(), *speed]);
            rows.joints.push(joint);
            rows.rest.push(torque - of_arm[joint]);
        }
    }
    Ok(rows)
}
