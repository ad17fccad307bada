//! The payload of an arm from measured torques: least squares over a motion that moves enough joints.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::{Body, Dynamics, JointMotion};

/// Smallest singular value, in relation to the largest, of what a motion excites.
const RANK: f64 = 1e-6;
/// Mass, centre and inertia of a body as ten numbers.
const PARAMETERS: usize = 10;

/// What was measured at one instant.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Position, velocity and acceleration of each joint.
    pub motions: Vec<JointMotion>,
    /// The measured torque of each joint, Nm or N.
    pub torques: Vec<f64>,
}

/// A payload as it was measured.
#[derive(Clone, Copy, Debug)]
pub struct Identification {
    /// In the frame of the flange.
    pub body: Body,
    /// Whether the motion excited the inertia as well; where not, it is 0 and only mass and centre count.
    pub has_inertia: bool,
    /// Root mean square of what the payload does not explain, Nm.
    pub residual: f64,
}

/// Why a payload was not identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IdentifyError {
    /// Samples with another number of joints.
    #[error(
        "sample {0} has not as many motions and torques as the arm has joints, or one that is not finite"
    )]
    Sample(usize),
    /// The motion does not show the mass and its centre.
    #[error(
        "the motion does not show mass and centre of mass; hint: move the last joints so that the flange points sideways, up and down"
    )]
    Motion,
}

/// Identifies the payload of an arm that is modelled without it.
///
/// # Errors
/// If a sample does not fit the arm, or the samples do not show mass and centre of mass.
pub fn identify(
    arm: &Dynamics,
    samples: &[Sample],
    gravity: &Vector3<f64>,
) -> Result<Identification, IdentifyError> {
    let joints = arm.bodies.len();
    for (number, Sample { motions, torques }) in samples.iter().enumerate() {
        let values = motions.iter().flatten().chain(torques);
        let fits = [motions.len(), torques.len()] == [joints; 2];
        if !fits || values.into_iter().any(|value| !value.is_finite()) {
            return Err(IdentifyError::Sample(number));
        }
    }
    // An arm without mass but for one unit of a parameter gives the column of that.
    let empty = Dynamics {
        bodies: vec![Body::default(); joints],
        ..arm.clone()
    };
    let units: Vec<_> = (0..PARAMETERS)
        .map(|number| empty.carrying(&unit(number)))
        .collect();
    let rows = samples.len() * joints;
    let mut columns = DMatrix::zeros(rows, PARAMETERS);
    let mut rest = DVector::zeros(rows);
    let mut torques = vec![0.0; joints];
    for (number, sample) in samples.iter().enumerate() {
        let first = number * joints;
        for (column, unit) in units.iter().enumerate() {
            unit.torques(&sample.motions, gravity, &mut torques);
            columns
                .view_mut((first, column), (joints, 1))
                .copy_from_slice(&torques);
        }
        arm.torques(&sample.motions, gravity, &mut torques);
        for (joint, (measured, own)) in sample.torques.iter().zip(&torques).enumerate() {
            rest[first + joint] = measured - own;
        }
    }
    let whole = solve(&columns, &rest).map(|found| (found, true));
    let found = whole.or_else(|| {
        let found = solve(&columns.columns(0, 4).into_owned(), &rest)?;
        Some((found.resize_vertically(PARAMETERS, 0.0), false))
    });
    let (found, has_inertia) = found.ok_or(IdentifyError::Motion)?;
    let left = &rest - &columns * &found;
    #[expect(clippy::cast_precision_loss, reason = "a number of samples")]
    let residual = (left.norm_squared() / rows as f64).sqrt();
    Ok(Identification {
        body: body(&found),
        has_inertia,
        residual,
    })
}

/// The least squares solution, if all parameters show.
fn solve(columns: &DMatrix<f64>, rest: &DVector<f64>) -> Option<DVector<f64>> {
    if columns.nrows() < columns.ncols() {
        return None;
    }
    let parts = columns.clone().svd(true, true);
    let (most, least) = (parts.singular_values.max(), parts.singular_values.min());
    (least > RANK * most).then_some(())?;
    parts.solve(rest, 0.0).ok()
}

impl Dynamics {
    /// The same arm with a body at its flange that need not be possible.
    fn carrying(&self, body: &Body) -> Self {
        let mut arm = self.clone();
        let tip = arm.arm.links().last().copied();
        if let (Some(last), Some(tip)) = (arm.bodies.last_mut(), tip) {
            // Rotation and shift in the form that is linear in the parameters.
            let moment = tip.rotation * body.moment;
            let inertia = tip.rotation * body.inertia * tip.rotation.transpose();
            let at = tip.position;
            let mixed = Matrix3::identity() * (2.0 * at.dot(&moment))
                - at * moment.transpose()
                - moment * at.transpose();
            *last = Body {
                mass: body.mass,
                moment: moment + at * body.mass,
                inertia: inertia + super::square(&at) * body.mass + mixed,
            };
        }
        arm
    }
}

/// The body whose parameter with this number is 1, all others 0.
fn unit(number: usize) -> Body {
    let mut parameters = DVector::zeros(PARAMETERS);
    parameters[number] = 1.0;
    body(&parameters)
}

fn body(parameters: &DVector<f64>) -> Body {
    let at = |number: usize| parameters.get(number).copied().unwrap_or(0.0);
    Body {
        mass: at(0),
        moment: Vector3::new(at(1), at(2), at(3)),
        inertia: Matrix3::new(
            at(4),
            at(5),
            at(6), //
            at(5),
            at(7),
            at(8), //
            at(6),
            at(8),
            at(9),
        ),
    }
}
