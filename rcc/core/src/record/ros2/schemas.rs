//! Definitions of the messages, in the form of ROS 2 (`ros2msg`): the message, then the messages that it consists of.

/// A message type.
#[derive(Clone, Copy, Debug)]
pub(in crate::record) struct Schema {
    /// Package and type.
    pub(in crate::record) name: &'static str,
    fields: &'static str,
    parts: &'static [(&'static str, &'static str)],
}

impl Schema {
    /// The text that a recording contains.
    pub(in crate::record) fn text(&self) -> String {
        let mut text = self.fields.to_owned();
        for (name, fields) in self.parts {
            text.push_str(&"=".repeat(80));
            text.push_str("\nMSG: ");
            text.push_str(name);
            text.push('\n');
            text.push_str(fields);
        }
        text
    }
}

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const HEADER: (&str, &str) = (
    "std_msgs/Header",
    "builtin_interfaces/Time stamp\nstring frame_id\n",
);
const VECTOR: (&str, &str) = ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n");
const QUATERNION: (&str, &str) = (
    "geometry_msgs/Quaternion",
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
);
const TRANSFORM: (&str, &str) = (
    "geometry_msgs/Transform",
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
);
const TRANSFORM_STAMPED: (&str, &str) = (
    "geometry_msgs/TransformStamped",
    "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
);
const WRENCH: (&str, &str) = (
    "geometry_msgs/Wrench",
    "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
);
const STATUS: (&str, &str) = (
    "diagnostic_msgs/DiagnosticStatus",
    "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n\
     string hardware_id\ndiagnostic_msgs/KeyValue[] values\n",
);
const KEY_VALUE: (&str, &str) = ("diagnostic_msgs/KeyValue", "string key\nstring value\n");

/// Joint positions (rad), velocities (rad/s) and torques (Nm).
pub(in crate::record) const JOINT_STATE: Schema = Schema {
    name: "sensor_msgs/msg/JointState",
    fields: "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    parts: &[HEADER, TIME],
};

/// Frames (m) in their parents.
pub(in crate::record) const TRANSFORMS: Schema = Schema {
    name: "tf2_msgs/msg/TFMessage",
    fields: "geometry_msgs/TransformStamped[] transforms\n",
    parts: &[
        TRANSFORM_STAMPED,
        TRANSFORM,
        VECTOR,
        QUATERNION,
        HEADER,
        TIME,
    ],
};

/// Force (N) and torque (Nm) at a flange.
pub(in crate::record) const WRENCH_STAMPED: Schema = Schema {
    name: "geometry_msgs/msg/WrenchStamped",
    fields: "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    parts: &[WRENCH, VECTOR, HEADER, TIME],
};

/// States of devices.
pub(in crate::record) const DIAGNOSTICS: Schema = Schema {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    fields: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    parts: &[STATUS, KEY_VALUE, HEADER, TIME],
};

/// A line of the log.
pub(in crate::record) const LOG: Schema = Schema {
    name: "rcl_interfaces/msg/Log",
    fields: "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
             builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
    parts: &[TIME],
};

/// A cycle of the net thread: how long after the one before it began, cycles missed between them, and nets that run.
pub(in crate::record) const CYCLE: Schema = Schema {
    name: "takt_msgs/msg/Cycle",
    fields: "builtin_interfaces/Time stamp\nuint64 cycle\nfloat64 interval_us\nuint64 missed\nuint32 nets\n",
    parts: &[TIME],
};

/// All inputs and outputs of a cycle, for a replay: those that changed, see [`crate::record::cycles`].
pub(in crate::record) const WORDS: Schema = Schema {
    name: "takt_msgs/msg/Words",
    fields: "uint64[] words\n",
    parts: &[],
};

/// Devices, nets and machines, for a replay.
pub(in crate::record) const STRING: Schema = Schema {
    name: "std_msgs/msg/String",
    fields: "string data\n",
    parts: &[],
};

/// What happened to a net.
pub(in crate::record) const NET_EVENT: Schema = Schema {
    name: "takt_msgs/msg/NetEvent",
    fields: "builtin_interfaces/Time stamp\nuint64 cycle\nstring net\nstring event\nstring cause\n",
    parts: &[TIME],
};

/// A change of a machine, or of one inside: its state and status from this cycle on.
pub(in crate::record) const MACHINE_EVENT: Schema = Schema {
    name: "takt_msgs/msg/MachineEvent",
    fields: "builtin_interfaces/Time stamp\nuint64 cycle\nstring machine\nstring event\nstring state\nstring status\n",
    parts: &[TIME],
};

/// A cycle of a net thread in a flight file: how long after the one before it began, and cycles missed between them.
pub(in crate::record) const THREAD_CYCLE: Schema = Schema {
    name: "takt_msgs/msg/ThreadCycle",
    fields: "builtin_interfaces/Time stamp\nuint64 cycle\nfloat64 interval_us\nuint64 missed\n",
    parts: &[TIME],
};

/// Digital and analogue inputs and outputs; not a number where a value is not known.
pub(in crate::record) const SIGNALS: Schema = Schema {
    name: "takt_msgs/msg/Signals",
    fields: "builtin_interfaces/Time stamp\nfloat64[] digital_inputs\nfloat64[] digital_outputs\n\
             float64[] analogue_inputs\nfloat64[] analogue_outputs\n",
    parts: &[TIME],
};

/// The definition of a message with a time and these fields.
pub(in crate::record) fn of_values(fields: &str) -> String {
    let schema = Schema {
        name: "",
        fields: "",
        parts: &[TIME],
    };
    format!("builtin_interfaces/Time stamp\n{fields}{}", schema.text())
}
