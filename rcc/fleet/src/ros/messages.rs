//! The messages that are spoken, as far as they matter here: what is read, and what is written. Messages that are
//! published have the bytes of rosbags in the tests; requests of actions are only read back. Whether a goal makes sense is decided in [`goal`](super::goal).

use super::cdr::{Cdr, DecodeError, Reader};

/// Most points of a trajectory.
pub const POINTS_MAX: usize = 10_000;
/// Most joints of a message.
pub const JOINTS_MAX: usize = 64;
/// Most goals in one answer.
pub const GOALS_MAX: usize = 64;

/// Identifier of a goal.
pub type GoalId = [u8; 16];

/// A time or a span, ns; a time since 1970.
pub type Nanos = i64;

const SECOND: i64 = 1_000_000_000;

fn time(reader: &mut Reader<'_>) -> Result<Nanos, DecodeError> {
    let seconds = i64::from(reader.i32("a time")?);
    let nanos = i64::from(reader.u32("a time")?);
    if nanos >= SECOND {
        return Err(DecodeError::Range("nanosec of a time"));
    }
    Ok(seconds * SECOND + nanos)
}

/// Writes a time or a span.
pub fn write_time(cdr: &mut Cdr, time: Nanos) -> &mut Cdr {
    let clamped = i32::try_from(time.div_euclid(SECOND)).unwrap_or(if time < 0 {
        i32::MIN
    } else {
        i32::MAX
    });
    let nanos = u32::try_from(time.rem_euclid(SECOND)).unwrap_or(0);
    cdr.i32(clamped).u32(nanos)
}

/// Writes the header of a message.
pub fn write_header<'c>(cdr: &'c mut Cdr, stamp: Nanos, frame: &str) -> &'c mut Cdr {
    write_time(cdr, stamp).text(frame)
}

/// A point of a trajectory. A list without elements is absent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point {
    /// rad, in the order of the names.
    pub positions: Vec<f64>,
    /// rad/s.
    pub velocities: Vec<f64>,
    /// rad/s².
    pub accelerations: Vec<f64>,
    /// Nm.
    pub effort: Vec<f64>,
    /// From the start of the trajectory.
    pub time: Nanos,
}

/// `trajectory_msgs/JointTrajectory`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// When it is to begin; 0 for now.
    pub stamp: Nanos,
    /// Names of joints.
    pub joints: Vec<String>,
    /// Its points.
    pub points: Vec<Point>,
}

impl Trajectory {
    fn read(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let stamp = time(reader)?;
        reader.text("frame_id")?;
        let joints = reader.texts("joint_names", JOINTS_MAX)?;
        let count = reader.count("points", 24, POINTS_MAX)?;
        let points = (0..count).map(|_| Point::read(reader));
        Ok(Self {
            stamp,
            joints,
            points: points.collect::<Result<_, _>>()?,
        })
    }

    /// Reads a message of the topic.
    ///
    /// # Errors
    /// If it is malformed or exceeds a bound.
    pub fn decode(message: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(message)?;
        let trajectory = Self::read(&mut reader)?;
        reader.end().map(|()| trajectory)
    }

    /// Writes it after what is in `cdr`.
    pub fn write(&self, cdr: &mut Cdr) {
        write_header(cdr, self.stamp, "")
            .texts(&self.joints)
            .count(self.points.len());
        for point in &self.points {
            point.write(cdr);
        }
    }
}

impl Point {
    fn read(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            positions: reader.numbers("positions", JOINTS_MAX)?,
            velocities: reader.numbers("velocities", JOINTS_MAX)?,
            accelerations: reader.numbers("accelerations", JOINTS_MAX)?,
            effort: reader.numbers("effort", JOINTS_MAX)?,
            time: time(reader)?,
        })
    }

    fn write(&self, cdr: &mut Cdr) {
        for list in [
            &self.positions,
            &self.velocities,
            &self.accelerations,
            &self.effort,
        ] {
            cdr.numbers(list.iter().copied());
        }
        write_time(cdr, self.time);
    }
}

/// `control_msgs/JointTolerance`: 0 is the default, below 0 is none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tolerance {
    /// Name of the joint.
    pub joint: String,
    /// rad.
    pub position: f64,
    /// rad/s.
    pub velocity: f64,
    /// rad/s².
    pub acceleration: f64,
}

/// The goal of `FollowJointTrajectory`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FollowGoal {
    /// Its identifier.
    pub id: GoalId,
    /// What is to be followed.
    pub trajectory: Trajectory,
    /// Number of joints of several axes, tolerances of such included: they are not followed.
    pub multi_dof: usize,
    /// Largest deviations on the way.
    pub path: Vec<Tolerance>,
    /// Largest deviations at the end.
    pub goal: Vec<Tolerance>,
    /// How much later than planned the end may be reached; 0 is the default, below 0 is none.
    pub goal_time: Nanos,
}

fn tolerances(reader: &mut Reader<'_>, what: &'static str) -> Result<Vec<Tolerance>, DecodeError> {
    let count = reader.count(what, 32, JOINTS_MAX)?;
    let tolerance = |_| {
        Ok(Tolerance {
            joint: reader.text(what)?.to_owned(),
            position: reader.f64(what)?,
            velocity: reader.f64(what)?,
            acceleration: reader.f64(what)?,
        })
    };
    (0..count).map(tolerance).collect()
}

fn components(reader: &mut Reader<'_>, what: &'static str) -> Result<usize, DecodeError> {
    let count = reader.count(what, 32, JOINTS_MAX)?;
    for _ in 0..count {
        reader.text(what)?;
        // An u16, and three doubles that are aligned after it.
        reader.u8(what)?;
        reader.u8(what)?;
        for _ in 0..3 {
            reader.f64(what)?;
        }
    }
    Ok(count)
}

/// Passes over the points of joints with several axes; returns the number of joints.
fn multi_dof(reader: &mut Reader<'_>) -> Result<usize, DecodeError> {
    time(reader)?;
    reader.text("frame_id")?;
    let joints = reader.texts("joint_names", JOINTS_MAX)?.len();
    let points = reader.count("multi_dof points", 20, POINTS_MAX)?;
    for _ in 0..points {
        for (what, numbers) in [("transforms", 7), ("velocities", 6), ("accelerations", 6)] {
            let count = reader.count(what, numbers * 8, JOINTS_MAX)?;
            for _ in 0..count * numbers {
                reader.f64(what)?;
            }
        }
        time(reader)?;
    }
    Ok(joints.max(points))
}

impl FollowGoal {
    /// Reads the request of `send_goal`.
    ///
    /// # Errors
    /// If it is malformed or exceeds a bound.
    pub fn decode(message: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(message)?;
        let id = reader.octets("goal_id")?;
        let trajectory = Trajectory::read(&mut reader)?;
        let mut several = multi_dof(&mut reader)?;
        let path = tolerances(&mut reader, "path_tolerance")?;
        several += components(&mut reader, "component_path_tolerance")?;
        let goal = tolerances(&mut reader, "goal_tolerance")?;
        several += components(&mut reader, "component_goal_tolerance")?;
        let goal_time = time(&mut reader)?;
        reader.end()?;
        Ok(Self {
            id,
            trajectory,
            multi_dof: several,
            path,
            goal,
            goal_time,
        })
    }

    /// The request as bytes.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let mut cdr = Cdr::default();
        cdr.begin().octets(&self.id);
        self.trajectory.write(&mut cdr);
        write_header(&mut cdr, 0, "").count(0).count(0);
        for list in [&self.path, &self.goal] {
            cdr.count(list.len());
            for tolerance in list {
                cdr.text(&tolerance.joint)
                    .f64(tolerance.position)
                    .f64(tolerance.velocity)
                    .f64(tolerance.acceleration);
            }
            cdr.count(0);
        }
        write_time(&mut cdr, self.goal_time);
        cdr.bytes().to_vec()
    }
}

/// The goal of a gripper, of either type.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GripperGoal {
    /// Its identifier.
    pub id: GoalId,
    /// m.
    pub position: f64,
    /// N; 0 or below for the default.
    pub effort: f64,
}

impl GripperGoal {
    /// Reads the request of `GripperCommand`.
    ///
    /// # Errors
    /// If it is malformed.
    pub fn decode(message: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(message)?;
        let goal = Self {
            id: reader.octets("goal_id")?,
            position: reader.f64("position")?,
            effort: reader.f64("max_effort")?,
        };
        reader.end().map(|()| goal)
    }

    /// Reads the request of `ParallelGripperCommand`: a state of one joint.
    ///
    /// # Errors
    /// If it is malformed, or not of one joint.
    pub fn decode_parallel(message: &[u8]) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(message)?;
        let id = reader.octets("goal_id")?;
        time(&mut reader)?;
        reader.text("frame_id")?;
        reader.texts("name", JOINTS_MAX)?;
        let positions = reader.numbers("position", JOINTS_MAX)?;
        reader.numbers("velocity", JOINTS_MAX)?;
        let efforts = reader.numbers("effort", JOINTS_MAX)?;
        reader.end()?;
        let [position] = positions[..] else {
            return Err(DecodeError::Range(
                "the number of positions, which is not 1,",
            ));
        };
        Ok(Self {
            id,
            position,
            effort: efforts.first().copied().unwrap_or(0.0),
        })
    }
}

/// Reads the request of `get_result`: the goal.
///
/// # Errors
/// If it is malformed.
pub fn decode_get_result(message: &[u8]) -> Result<GoalId, DecodeError> {
    let mut reader = Reader::new(message)?;
    let id = reader.octets("goal_id")?;
    reader.end().map(|()| id)
}

/// Reads the request of `cancel_goal`: the goal, zero for any, and the time up to which goals are cancelled, 0 for any.
///
/// # Errors
/// If it is malformed.
pub fn decode_cancel(message: &[u8]) -> Result<(GoalId, Nanos), DecodeError> {
    let mut reader = Reader::new(message)?;
    let goal = (reader.octets("goal_id")?, time(&mut reader)?);
    reader.end().map(|()| goal)
}

/// Reads the request of `SetBool`.
///
/// # Errors
/// If it is malformed.
pub fn decode_set_bool(message: &[u8]) -> Result<bool, DecodeError> {
    let mut reader = Reader::new(message)?;
    let value = reader.bool("data")?;
    reader.end().map(|()| value)
}

/// A frame in its parent: names, position (m), quaternion x, y, z, w.
#[derive(Clone, Debug, PartialEq)]
pub struct Transform {
    /// The parent.
    pub parent: String,
    /// The frame.
    pub child: String,
    /// m.
    pub position: [f64; 3],
    /// Unit quaternion: x, y, z, w.
    pub rotation: [f64; 4],
}

/// Level of a diagnostic status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// As it should be.
    Ok = 0,
    /// Usable.
    Warn = 1,
    /// Not usable.
    Error = 2,
    /// Nothing is known.
    Stale = 3,
}

/// A diagnostic status.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// How bad it is.
    pub level: Level,
    /// Of what.
    pub name: String,
    /// In words.
    pub message: String,
    /// The hardware.
    pub hardware: String,
    /// Further values.
    pub values: Vec<(String, String)>,
}

/// `std_msgs/String`.
#[must_use]
pub fn string(text: &str) -> Vec<u8> {
    Cdr::default().begin().text(text).bytes().to_vec()
}

/// `sensor_msgs/JointState`; lists without elements are absent.
#[must_use]
pub fn joint_state(stamp: Nanos, names: &[String], [q, v, effort]: [&[f64]; 3]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    write_header(cdr.begin(), stamp, "").texts(names);
    for list in [q, v, effort] {
        cdr.numbers(list.iter().copied());
    }
    cdr.bytes().to_vec()
}

/// `geometry_msgs/WrenchStamped`: force (N), torque (Nm).
#[must_use]
pub fn wrench(stamp: Nanos, frame: &str, values: [f64; 6]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    write_header(cdr.begin(), stamp, frame);
    for value in values {
        cdr.f64(value);
    }
    cdr.bytes().to_vec()
}

/// `tf2_msgs/TFMessage`.
#[must_use]
pub fn transforms(stamp: Nanos, all: &[Transform]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.begin().count(all.len());
    for transform in all {
        write_header(&mut cdr, stamp, &transform.parent).text(&transform.child);
        for number in transform.position.iter().chain(&transform.rotation) {
            cdr.f64(*number);
        }
    }
    cdr.bytes().to_vec()
}

/// `diagnostic_msgs/DiagnosticArray`.
#[must_use]
pub fn diagnostics(stamp: Nanos, all: &[Status]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    write_header(cdr.begin(), stamp, "").count(all.len());
    for status in all {
        cdr.u8(status.level as u8)
            .text(&status.name)
            .text(&status.message)
            .text(&status.hardware)
            .count(status.values.len());
        for (key, value) in &status.values {
            cdr.text(key).text(value);
        }
    }
    cdr.bytes().to_vec()
}

/// The answer of `send_goal`.
#[must_use]
pub fn accepted(is_accepted: bool, stamp: Nanos) -> Vec<u8> {
    let mut cdr = Cdr::default();
    write_time(cdr.begin().bool(is_accepted), stamp);
    cdr.bytes().to_vec()
}

/// The answer of `cancel_goal`: its code, and the goals that are being cancelled with the times of their acceptance.
#[must_use]
pub fn cancelling(code: u8, goals: &[(GoalId, Nanos)]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.begin().u8(code).count(goals.len());
    for (id, stamp) in goals {
        write_time(cdr.octets(id), *stamp);
    }
    cdr.bytes().to_vec()
}

/// The answer of `SetBool`.
#[must_use]
pub fn set_bool(success: bool, message: &str) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.begin().bool(success).text(message);
    cdr.bytes().to_vec()
}

/// `action_msgs/GoalStatusArray`: goals, times of their acceptance, statuses.
#[must_use]
pub fn goal_statuses(goals: &[(GoalId, Nanos, u8)]) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.begin().count(goals.len());
    for (id, stamp, status) in goals {
        cdr.octets(id);
        write_time(&mut cdr, *stamp).u8(*status);
    }
    cdr.bytes().to_vec()
}

/// The answer of `get_result` of `FollowJointTrajectory`.
#[must_use]
pub fn follow_result(status: u8, code: i32, text: &str) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.begin().u8(status).i32(code).text(text);
    cdr.bytes().to_vec()
}

/// Progress along a trajectory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Feedback {
    /// The goal.
    pub id: GoalId,
    /// When it was measured.
    pub stamp: Nanos,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// What is desired, what is measured, and the difference.
    pub points: [Point; 3],
    /// The point that comes next.
    pub index: i32,
}

impl Feedback {
    /// The message; `with_index` as `control_msgs` 6.3 and later have it.
    #[must_use]
    pub fn encode(&self, with_index: bool) -> Vec<u8> {
        let mut cdr = Cdr::default();
        cdr.begin().octets(&self.id);
        write_header(&mut cdr, self.stamp, "").texts(&self.joints);
        for point in &self.points {
            point.write(&mut cdr);
        }
        if with_index {
            cdr.i32(self.index);
        }
        cdr.count(0);
        for _ in 0..3 {
            write_time(cdr.count(0).count(0).count(0), 0);
        }
        if with_index {
            cdr.i32(0);
        }
        cdr.bytes().to_vec()
    }
}

/// Where a gripper is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripperState {
    /// m.
    pub position: f64,
    /// N.
    pub effort: f64,
    /// Whether it stopped before its goal, at something.
    pub stalled: bool,
    /// Whether it is at its goal.
    pub reached: bool,
}

impl GripperState {
    /// The answer of `get_result` of `GripperCommand`.
    #[must_use]
    pub fn result(&self, status: u8) -> Vec<u8> {
        let mut cdr = Cdr::default();
        cdr.begin().u8(status).f64(self.position).f64(self.effort);
        cdr.bool(self.stalled).bool(self.reached);
        cdr.bytes().to_vec()
    }

    /// The same of `ParallelGripperCommand`.
    #[must_use]
    pub fn parallel_result(&self, status: u8, stamp: Nanos, joint: &str) -> Vec<u8> {
        let mut cdr = Cdr::default();
        write_header(cdr.begin().u8(status), stamp, "").texts(&[joint.to_owned()]);
        cdr.numbers([self.position].into_iter())
            .numbers([].into_iter())
            .numbers([self.effort].into_iter());
        cdr.bool(self.stalled).bool(self.reached);
        cdr.bytes().to_vec()
    }
}

#[cfg(test)]
mod tests;
