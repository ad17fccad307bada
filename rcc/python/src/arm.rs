//! Robot arms.

use pyo3::prelude::*;
use pyo3::types::{IntoPyDict as _, PyDict};
use takt_api as api;
use takt_api::motion::{CartesianLimits, ForceLimits};

use crate::activity::Activity;
use crate::arrays::array;
use crate::control::Control;
use crate::error;
use crate::expression::{Condition, Number};
use crate::frame::{Frame, direction, goal, goals};
use crate::keywords::Keywords;
use crate::live::{Described, Live};
use crate::moving::MovingFrame;
use crate::owned::Owned;
use crate::pose;
use crate::wait::{seconds, wait};

/// Names of limits, as keywords.
const LIMITS: [&str; 6] = [
    "velocity",
    "acceleration",
    "jerk",
    "rot_velocity",
    "rot_acceleration",
    "rot_jerk",
];

/// Names of limits of motions under force, as keywords.
const FORCE_LIMITS: [&str; 7] = [
    "approach",
    "velocity",
    "travel",
    "touch",
    "tolerance",
    "force_max",
    "damping",
];

/// The fields of these limits, in the order of [`FORCE_LIMITS`].
const fn force_fields(limits: &mut ForceLimits) -> [&mut f64; 7] {
    [
        &mut limits.approach,
        &mut limits.velocity,
        &mut limits.travel,
        &mut limits.touch,
        &mut limits.tolerance,
        &mut limits.force_max,
        &mut limits.damping,
    ]
}

/// An arm of a cell.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Arm(Owned<api::Arm>);

impl Arm {
    pub(crate) fn new(arm: api::Arm) -> Self {
        Self(Owned::new(arm))
    }

    /// A copy of the arm.
    pub(crate) fn arm(&self, py: Python<'_>) -> PyResult<api::Arm> {
        Ok(self.0.get(py)?.clone())
    }
}

/// Limits of velocity, acceleration and jerk of the position and the orientation. Those left out are the default.
pub(crate) fn limits(
    py: Python<'_>,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<CartesianLimits> {
    let keywords = Keywords::of(keywords, &LIMITS)?;
    let mut limits = CartesianLimits::default();
    let fields = [
        &mut limits.velocity,
        &mut limits.acceleration,
        &mut limits.jerk,
        &mut limits.rot_velocity,
        &mut limits.rot_acceleration,
        &mut limits.rot_jerk,
    ];
    for (name, field) in LIMITS.into_iter().zip(fields) {
        let Some(limit) = keywords.get::<f64>(name)? else {
            continue;
        };
        if !(limit > 0.0 && limit.is_finite()) {
            let text = format!("{name} is {limit}; a limit is above 0 and finite");
            return Err(error::invalid(py, text));
        }
        *field = limit;
    }
    Ok(limits)
}

#[pymethods]
impl Arm {
    /// Its name in the cell.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.description().name.clone())
    }

    /// Its type.
    #[getter]
    fn kind(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.description().kind.clone())
    }

    /// Period of the nets that command it, s.
    #[getter]
    fn period(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.0.get(py)?.description().period.as_secs_f64())
    }

    /// Model of its kinematics; empty if it is not described.
    #[getter]
    fn model(&self, py: Python<'_>) -> PyResult<String> {
        Ok(self.0.get(py)?.description().model.name().to_owned())
    }

    /// Its base in the world.
    #[getter]
    fn base(&self, py: Python<'_>) -> PyResult<pose::Pose> {
        Ok(pose::Pose(self.0.get(py)?.base()))
    }

    /// Its base as a frame.
    #[getter]
    fn base_frame(&self, py: Python<'_>) -> PyResult<Frame> {
        Ok(Frame(self.0.get(py)?.base_frame().clone()))
    }

    /// Limits of its joints, from the base.
    #[getter]
    fn joints(&self, py: Python<'_>) -> PyResult<Vec<JointLimits>> {
        let joints = &self.0.get(py)?.description().joints;
        Ok(joints.iter().map(JointLimits::of).collect())
    }

    /// Its limits on lines, arcs, curves and jogs, by the keywords of `with_limits`.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let limits = self.0.get(py)?.limits();
        let values = [
            limits.velocity,
            limits.acceleration,
            limits.jerk,
            limits.rot_velocity,
            limits.rot_acceleration,
            limits.rot_jerk,
        ];
        LIMITS.into_iter().zip(values).into_py_dict(py)
    }

    /// Its limits on motions under force, by the keywords of `with_force_limits`.
    #[getter]
    fn force_limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut limits = self.0.get(py)?.force_limits();
        let values = force_fields(&mut limits).map(|limit| *limit);
        FORCE_LIMITS.into_iter().zip(values).into_py_dict(py)
    }

    /// The same arm with these limits on motions under force.
    #[pyo3(signature = (**limits))]
    fn with_force_limits(
        &self,
        py: Python<'_>,
        limits: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let keywords = Keywords::of(limits, &FORCE_LIMITS)?;
        let arm = self.0.get(py)?.clone();
        let mut limits = ForceLimits::default();
        for (name, field) in FORCE_LIMITS.into_iter().zip(force_fields(&mut limits)) {
            let Some(limit) = keywords.get::<f64>(name)? else {
                continue;
            };
            if !(limit > 0.0 && limit.is_finite()) {
                let text = format!("{name} is {limit}; a limit is above 0 and finite");
                return Err(error::invalid(py, text));
            }
            *field = limit;
        }
        Ok(Self::new(arm.with_force_limits(limits)))
    }

    /// Force and torque at the tool.
    #[getter]
    fn force(&self, py: Python<'_>) -> PyResult<Force> {
        Ok(Force(self.0.get(py)?.force()))
    }

    /// The same arm, slower.
    fn with_speed(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        Ok(Self::new(self.0.get(py)?.clone().with_speed(factor)))
    }

    /// The same arm with these limits on lines and arcs.
    #[pyo3(signature = (**limits))]
    fn with_limits(&self, py: Python<'_>, limits: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let limits = self::limits(py, limits)?;
        Ok(Self::new(self.0.get(py)?.clone().with_limits(limits)))
    }

    /// The same arm with another motion centre, given in the flange.
    fn with_tool(&self, tool: &Bound<'_, PyAny>) -> PyResult<Self> {
        let arm = self.0.get(tool.py())?.clone();
        Ok(Self::new(arm.with_tool(pose::read(tool)?)))
    }

    /// The same arm with its base at this pose in the world, which coupled arms share.
    fn with_base(&self, base: &Bound<'_, PyAny>) -> PyResult<Self> {
        let arm = self.0.get(base.py())?.clone();
        Ok(Self::new(arm.with_base(pose::read(base)?)))
    }

    /// A motion to joint positions, rad.
    #[pyo3(signature = (to, **options))]
    fn ptp(
        &self,
        py: Python<'_>,
        to: Vec<f64>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        Activity::motion(py, self.0.get(py)?.ptp(to), options)
    }

    /// A motion to the home position of the arm.
    #[pyo3(signature = (**options))]
    fn home(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Activity> {
        Activity::motion(py, self.0.get(py)?.home(), options)
    }

    /// A motion of all joints together to a pose of the motion centre.
    #[pyo3(signature = (to, **options))]
    fn ptp_to(
        &self,
        to: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        Activity::motion(py, self.0.get(py)?.ptp_to(goal(to)?), options)
    }

    /// The same to the joint positions next to a hint, rad.
    #[pyo3(signature = (to, hint, **options))]
    fn ptp_near(
        &self,
        to: &Bound<'_, PyAny>,
        hint: Vec<f64>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        Activity::motion(py, self.0.get(py)?.ptp_near(goal(to)?, hint), options)
    }

    /// A motion of the motion centre along a straight line.
    #[pyo3(signature = (to, **options))]
    fn lin(
        &self,
        to: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        Activity::motion(py, self.0.get(py)?.lin(goal(to)?), options)
    }

    /// A motion of the motion centre along the arc through `via` to `to`.
    #[pyo3(signature = (via, to, **options))]
    fn circ(
        &self,
        via: &Bound<'_, PyAny>,
        to: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        let arc = self.0.get(py)?.circ(goal(via)?, goal(to)?);
        Activity::motion(py, arc, options)
    }

    /// A motion of the motion centre along a smooth curve through 1 to 63 poses.
    #[pyo3(signature = (through, **options))]
    fn spline(
        &self,
        through: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = through.py();
        Activity::motion(py, self.0.get(py)?.spline(goals(through)?), options)
    }

    /// A motion of the joints through positions at given times.
    #[pyo3(signature = (times, positions, velocities=None, accelerations=None, *, path_tolerance=None, goal_tolerance=None,
                        goal_time=1.0, **options))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn trajectory(
        &self,
        py: Python<'_>,
        times: Vec<f64>,
        positions: Vec<Vec<f64>>,
        velocities: Option<Vec<Vec<f64>>>,
        accelerations: Option<Vec<Vec<f64>>>,
        path_tolerance: Option<Vec<f64>>,
        goal_tolerance: Option<Vec<f64>>,
        goal_time: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let count = times.len();
        let rows = |name: &str, rows: Option<Vec<Vec<f64>>>| match rows {
            Some(rows) if rows.len() != count => {
                let text = format!("{count} times, but {} rows of {name}", rows.len());
                Err(error::invalid(py, text))
            }
            Some(rows) => Ok(rows),
            None => Ok(vec![Vec::new(); count]),
        };
        let positions = rows("positions", Some(positions))?;
        let velocities = rows("velocities", velocities)?;
        let accelerations = rows("accelerations", accelerations)?;
        let rows = positions.into_iter().zip(velocities).zip(accelerations);
        let points = times.into_iter().zip(rows);
        let point = |(time, ((positions, velocities), accelerations))| api::Waypoint {
            time,
            positions,
            velocities,
            accelerations,
        };
        let trajectory = api::JointTrajectory {
            points: points.map(point).collect(),
            path_tolerance: path_tolerance.unwrap_or_default(),
            goal_tolerance: goal_tolerance.unwrap_or_default(),
            goal_time,
        };
        Activity::motion(py, self.0.get(py)?.trajectory(trajectory), options)
    }

    /// Brakes the arm and keeps it under command where it comes to rest.
    #[pyo3(signature = (**options))]
    fn hold(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Activity> {
        Activity::without_blend(py, self.0.get(py)?.hold(), options)
    }

    /// Presses with a force, N, in a direction.
    #[pyo3(signature = (direction, force, **options))]
    fn press(
        &self,
        direction: &Bound<'_, PyAny>,
        force: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = direction.py();
        let press = self.0.get(py)?.press(self::direction(direction)?, force);
        Activity::without_blend(py, press, options)
    }

    /// The same on the way to a pose.
    #[pyo3(signature = (to, direction, force, **options))]
    fn press_to(
        &self,
        to: &Bound<'_, PyAny>,
        direction: &Bound<'_, PyAny>,
        force: f64,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = to.py();
        let direction = self::direction(direction)?;
        let press = self.0.get(py)?.press_to(goal(to)?, direction, force);
        Activity::without_blend(py, press, options)
    }

    /// Follows a frame that moves.
    #[pyo3(signature = (frame, **options))]
    fn follow(
        &self,
        frame: &Bound<'_, MovingFrame>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = frame.py();
        let follow = self.0.get(py)?.follow(&frame.get().0);
        Activity::without_blend(py, follow, options)
    }

    /// Its motion centre as a frame that moves.
    fn centre(&self, py: Python<'_>) -> PyResult<MovingFrame> {
        Ok(MovingFrame(self.0.get(py)?.centre()))
    }

    /// Switches how the arm is controlled.
    #[pyo3(signature = (control, **options))]
    fn switch_to(
        &self,
        control: &Bound<'_, Control>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Activity> {
        let py = control.py();
        let switch = self.0.get(py)?.switch_to(control.get().0.clone());
        Activity::without_blend(py, switch, options)
    }

    /// Jogging of the motion centre by velocities that the program sends.
    #[pyo3(signature = (**options))]
    fn jog(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Live> {
        Live::new(py, Described::Twist(self.0.get(py)?.jog()), options)
    }

    /// Jogging of the joints by velocities that the program sends, rad/s.
    #[pyo3(signature = (**options))]
    fn jog_joints(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Live> {
        let jog = self.0.get(py)?.jog_joints();
        Live::new(py, Described::JointVelocities(jog), options)
    }

    /// A motion to joint positions that the program sends, rad.
    #[pyo3(signature = (**options))]
    fn stream(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Live> {
        Live::new(py, Described::JointGoal(self.0.get(py)?.stream()), options)
    }

    /// A motion to poses of the motion centre that the program sends.
    #[pyo3(signature = (**options))]
    fn stream_poses(&self, py: Python<'_>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Live> {
        Live::new(py, Described::Pose(self.0.get(py)?.stream_poses()), options)
    }

    /// Measured positions of the joints, rad.
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let arm = self.0.get(py)?;
        let joints = py.detach(|| arm.positions());
        array(py, joints.map_err(|error| error::raise_here(py, &error))?)
    }

    /// Commanded positions of the joints, rad.
    fn commanded<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let arm = self.0.get(py)?;
        let joints = py.detach(|| arm.commanded());
        array(py, joints.map_err(|error| error::raise_here(py, &error))?)
    }

    /// The measured pose of the flange in the base of the arm.
    fn pose(&self, py: Python<'_>) -> PyResult<pose::Pose> {
        let arm = self.0.get(py)?;
        let measured = py.detach(|| arm.pose());
        measured
            .map(pose::Pose)
            .map_err(|error| error::raise_here(py, &error))
    }

    /// The measured position of a joint, rad, as an expression.
    fn joint(&self, py: Python<'_>, axis: usize) -> PyResult<Number> {
        let arm = self.0.get(py)?;
        let count = arm.description().joints.len();
        if axis >= count {
            let text = format!(
                "joint {axis}; {} has joints 0 to {}",
                arm.description().name,
                count.saturating_sub(1)
            );
            return Err(error::invalid(py, text));
        }
        Ok(Number(arm.joint(axis)))
    }

    /// A digital input of the arm.
    fn input(&self, py: Python<'_>, port: u32) -> PyResult<Condition> {
        Ok(Condition(self.0.get(py)?.input(port)))
    }

    /// Requests that what the arm does end, and everything that waits for it.
    fn cancel(&self, py: Python<'_>) -> PyResult<()> {
        let arm = self.0.get(py)?;
        py.detach(|| arm.cancel());
        Ok(())
    }

    /// Waits until the arm has done everything that was requested of it.
    #[pyo3(signature = (timeout=None))]
    fn finish(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<()> {
        let arm = self.0.get(py)?;
        let limit = timeout
            .map(|timeout| seconds(py, "timeout", timeout))
            .transpose()?;
        let done = wait(py, limit, |slice| arm.finish_for(slice))?;
        let place = crate::place::Place::caller(py);
        let late = || error::timeout(py, timeout.unwrap_or_default(), place.as_ref());
        done.ok_or_else(late)?
            .map_err(|error| error::raise(py, &error, place.as_ref()))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let description = self.0.get(py)?.description();
        let (name, kind) = (&description.name, &description.kind);
        Ok(format!(
            "Arm('{name}', {kind}, {} joints)",
            description.joints.len()
        ))
    }
}

/// Limits of a joint.
#[pyclass(frozen, get_all, eq, module = "takt")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointLimits {
    /// Smallest position, rad.
    position_min: f64,
    /// Largest position, rad.
    position_max: f64,
    /// Largest speed, rad/s.
    velocity: f64,
    /// Largest acceleration, rad/s².
    acceleration: f64,
    /// Largest jerk of motions, rad/s³.
    jerk: f64,
}

impl JointLimits {
    const fn of(limits: &api::motion::JointLimits) -> Self {
        Self {
            position_min: limits.position_min,
            position_max: limits.position_max,
            velocity: limits.velocity,
            acceleration: limits.acceleration,
            jerk: limits.jerk,
        }
    }
}

#[pymethods]
impl JointLimits {
    fn __repr__(&self) -> String {
        let Self {
            position_min,
            position_max,
            velocity,
            acceleration,
            jerk,
        } = self;
        format!(
            "JointLimits({position_min:.3} to {position_max:.3} rad, {velocity:.3} rad/s, {acceleration:.3} rad/s², {jerk:.3} rad/s³)"
        )
    }
}

/// Force and torque at the tool of an arm.
#[pyclass(frozen, module = "takt")]
#[derive(Debug)]
pub(crate) struct Force(api::arm::Force);

#[pymethods]
impl Force {
    /// Force along x, N.
    #[getter]
    fn x(&self) -> Number {
        Number(self.0.x())
    }

    /// Force along y, N.
    #[getter]
    fn y(&self) -> Number {
        Number(self.0.y())
    }

    /// Force along z, N.
    #[getter]
    fn z(&self) -> Number {
        Number(self.0.z())
    }

    /// Torque about x, Nm.
    #[getter]
    fn torque_x(&self) -> Number {
        Number(self.0.torque_x())
    }

    /// Torque about y, Nm.
    #[getter]
    fn torque_y(&self) -> Number {
        Number(self.0.torque_y())
    }

    /// Torque about z, Nm.
    #[getter]
    fn torque_z(&self) -> Number {
        Number(self.0.torque_z())
    }
}
