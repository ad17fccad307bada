//! Hashes from the definitions of types, by REP-2016: SHA-256 of a description as JSON. It knows only the syntax that occurs here.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use sha2_const_stable::Sha256;

use super::*;

/// Definitions of `.msg` files, one a line: name, then fields.
const MESSAGES: &str = "
builtin_interfaces/msg/Time: int32 sec; uint32 nanosec
builtin_interfaces/msg/Duration: int32 sec; uint32 nanosec
std_msgs/msg/Header: builtin_interfaces/msg/Time stamp; string frame_id
std_msgs/msg/String: string data
geometry_msgs/msg/Vector3: float64 x; float64 y; float64 z
geometry_msgs/msg/Quaternion: float64 x; float64 y; float64 z; float64 w
geometry_msgs/msg/Transform: geometry_msgs/msg/Vector3 translation; geometry_msgs/msg/Quaternion rotation
geometry_msgs/msg/TransformStamped: std_msgs/msg/Header header; string child_frame_id; geometry_msgs/msg/Transform transform
geometry_msgs/msg/Twist: geometry_msgs/msg/Vector3 linear; geometry_msgs/msg/Vector3 angular
geometry_msgs/msg/Wrench: geometry_msgs/msg/Vector3 force; geometry_msgs/msg/Vector3 torque
geometry_msgs/msg/WrenchStamped: std_msgs/msg/Header header; geometry_msgs/msg/Wrench wrench
sensor_msgs/msg/JointState: std_msgs/msg/Header header; string[] name; float64[] position; float64[] velocity; float64[] effort
tf2_msgs/msg/TFMessage: geometry_msgs/msg/TransformStamped[] transforms
diagnostic_msgs/msg/KeyValue: string key; string value
diagnostic_msgs/msg/DiagnosticStatus: byte level; string name; string message; string hardware_id; diagnostic_msgs/msg/KeyValue[] values
diagnostic_msgs/msg/DiagnosticArray: std_msgs/msg/Header header; diagnostic_msgs/msg/DiagnosticStatus[] status
trajectory_msgs/msg/JointTrajectoryPoint: float64[] positions; float64[] velocities; float64[] accelerations; float64[] effort; builtin_interfaces/msg/Duration time_from_start
trajectory_msgs/msg/JointTrajectory: std_msgs/msg/Header header; string[] joint_names; trajectory_msgs/msg/JointTrajectoryPoint[] points
trajectory_msgs/msg/MultiDOFJointTrajectoryPoint: geometry_msgs/msg/Transform[] transforms; geometry_msgs/msg/Twist[] velocities; geometry_msgs/msg/Twist[] accelerations; builtin_interfaces/msg/Duration time_from_start
trajectory_msgs/msg/MultiDOFJointTrajectory: std_msgs/msg/Header header; string[] joint_names; trajectory_msgs/msg/MultiDOFJointTrajectoryPoint[] points
control_msgs/msg/JointTolerance: string name; float64 position; float64 velocity; float64 acceleration
control_msgs/msg/JointComponentTolerance: string joint_name; uint16 component; float64 position; float64 velocity; float64 acceleration
control_msgs/msg/GripperCommand: float64 position; float64 max_effort
unique_identifier_msgs/msg/UUID: uint8[16] uuid
action_msgs/msg/GoalInfo: unique_identifier_msgs/msg/UUID goal_id; builtin_interfaces/msg/Time stamp
action_msgs/msg/GoalStatus: action_msgs/msg/GoalInfo goal_info; int8 status
action_msgs/msg/GoalStatusArray: action_msgs/msg/GoalStatus[] status_list
service_msgs/msg/ServiceEventInfo: uint8 event_type; builtin_interfaces/msg/Time stamp; char[16] client_gid; int64 sequence_number
";

/// Services: name, request, response.
const SERVICES: &str = "
action_msgs/srv/CancelGoal: action_msgs/msg/GoalInfo goal_info --- int8 return_code; action_msgs/msg/GoalInfo[] goals_canceling
std_srvs/srv/SetBool: bool data --- bool success; string message
";

/// Actions: name, goal, result, feedback.
const ACTIONS: &str = "
control_msgs/action/FollowJointTrajectory: trajectory_msgs/msg/JointTrajectory trajectory; trajectory_msgs/msg/MultiDOFJointTrajectory multi_dof_trajectory; control_msgs/msg/JointTolerance[] path_tolerance; control_msgs/msg/JointComponentTolerance[] component_path_tolerance; control_msgs/msg/JointTolerance[] goal_tolerance; control_msgs/msg/JointComponentTolerance[] component_goal_tolerance; builtin_interfaces/msg/Duration goal_time_tolerance --- int32 error_code; string error_string --- std_msgs/msg/Header header; string[] joint_names; trajectory_msgs/msg/JointTrajectoryPoint desired; trajectory_msgs/msg/JointTrajectoryPoint actual; trajectory_msgs/msg/JointTrajectoryPoint error; string[] multi_dof_joint_names; trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_desired; trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_actual; trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error
control_msgs/action/GripperCommand: control_msgs/msg/GripperCommand command --- float64 position; float64 effort; bool stalled; bool reached_goal --- float64 position; float64 effort; bool stalled; bool reached_goal
control_msgs/action/ParallelGripperCommand: sensor_msgs/msg/JointState command --- sensor_msgs/msg/JointState state; bool stalled; bool reached_goal --- sensor_msgs/msg/JointState state
";

type Fields = Vec<(String, String)>;

fn fields(text: &str) -> Fields {
    let field = |field: &str| {
        let (ty, name) = field.trim().split_once(' ').unwrap();
        (ty.to_owned(), name.to_owned())
    };
    let all = text.split(';').filter(|field| !field.trim().is_empty());
    all.map(field).collect()
}

fn lines(table: &str) -> impl Iterator<Item = (&str, &str)> {
    let lines = table.lines().filter(|line| !line.is_empty());
    lines.map(|line| line.split_once(": ").unwrap())
}

/// All types by name, with those that services and actions consist of.
fn types() -> BTreeMap<String, Fields> {
    let mut types = BTreeMap::new();
    for (name, text) in lines(MESSAGES) {
        types.insert(name.to_owned(), fields(text));
    }
    let service = |types: &mut BTreeMap<_, _>, name: &str, request: Fields, response: Fields| {
        let part = |part: &str| format!("{name}_{part}");
        let event = format!(
            "service_msgs/msg/ServiceEventInfo info; {}[<=1] request; {}[<=1] response",
            part("Request"),
            part("Response")
        );
        let whole = format!(
            "{} request_message; {} response_message; {} event_message",
            part("Request"),
            part("Response"),
            part("Event")
        );
        types.insert(part("Request"), request);
        types.insert(part("Response"), response);
        types.insert(part("Event"), fields(&event));
        types.insert(name.to_owned(), fields(&whole));
    };
    for (name, text) in lines(SERVICES) {
        let (request, response) = text.split_once("---").unwrap();
        service(&mut types, name, fields(request), fields(response));
    }
    for (name, text) in lines(ACTIONS) {
        let parts: Vec<_> = text.split("---").collect();
        for (part, text) in ["Goal", "Result", "Feedback"].into_iter().zip(parts) {
            types.insert(format!("{name}_{part}"), fields(text));
        }
        let uuid = "unique_identifier_msgs/msg/UUID goal_id";
        let texts = [
            format!("{uuid}; {name}_Goal goal"),
            "bool accepted; builtin_interfaces/msg/Time stamp".to_owned(),
            uuid.to_owned(),
            format!("int8 status; {name}_Result result"),
        ];
        let [goal, accepted, get, result] = texts.map(|text| fields(&text));
        service(&mut types, &format!("{name}_SendGoal"), goal, accepted);
        service(&mut types, &format!("{name}_GetResult"), get, result);
        let message = fields(&format!("{uuid}; {name}_Feedback feedback"));
        types.insert(format!("{name}_FeedbackMessage"), message);
    }
    types
}

/// Identifier, capacity and nested type of a field's type.
fn field_type(text: &str) -> (u64, u64, String) {
    let (element, array) = text
        .split_once('[')
        .map_or((text, None), |(element, rest)| {
            (element, Some(rest.trim_end_matches(']')))
        });
    let known = [
        ("int8", 2),
        ("uint8", 3),
        ("char", 3),
        ("uint16", 5),
        ("int32", 6),
        ("uint32", 7),
        ("int64", 8),
        ("float64", 11),
        ("bool", 15),
        ("byte", 16),
        ("string", 17),
    ];
    let found = known.iter().find(|(name, _)| *name == element);
    let (id, nested) = found.map_or((1, element), |(_, id)| (*id, ""));
    let (more, capacity) = match array {
        None => (0, 0),
        Some("") => (144, 0),
        Some(size) => match size.strip_prefix("<=") {
            Some(bound) => (96, bound.parse().unwrap()),
            None => (48, size.parse().unwrap()),
        },
    };
    (id + more, capacity, nested.to_owned())
}

fn description(name: &str, types: &BTreeMap<String, Fields>) -> Value {
    let field = |(ty, name): &(String, String)| {
        let (id, capacity, nested) = field_type(ty);
        json!({"name": name, "type": {"type_id": id, "capacity": capacity, "string_capacity": 0,
            "nested_type_name": nested}})
    };
    let fields: Vec<_> = types[name].iter().map(field).collect();
    json!({"type_name": name, "fields": fields})
}

fn referenced(name: &str, types: &BTreeMap<String, Fields>, all: &mut BTreeMap<String, Value>) {
    for (ty, _) in &types[name] {
        let (_, _, nested) = field_type(ty);
        if !nested.is_empty() && !all.contains_key(&nested) {
            all.insert(nested.clone(), description(&nested, types));
            referenced(&nested, types, all);
        }
    }
}

/// Members in the order of the standard, which is not that of the alphabet.
fn text(value: &Value) -> String {
    const ORDER: [&str; 10] = [
        "type_description",
        "referenced_type_descriptions",
        "type_name",
        "name",
        "fields",
        "type",
        "type_id",
        "capacity",
        "string_capacity",
        "nested_type_name",
    ];
    match value {
        Value::Array(items) => {
            let items: Vec<_> = items.iter().map(text).collect();
            format!("[{}]", items.join(", "))
        }
        Value::Object(members) => {
            let member = |key: &&str| Some(format!("\"{key}\": {}", text(members.get(*key)?)));
            let members: Vec<_> = ORDER.iter().filter_map(member).collect();
            format!("{{{}}}", members.join(", "))
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => value.to_string(),
    }
}

fn hash(name: &str, types: &BTreeMap<String, Fields>) -> String {
    let mut all = BTreeMap::new();
    referenced(name, types, &mut all);
    let all: Vec<_> = all.into_values().collect();
    let whole =
        json!({"type_description": description(name, types), "referenced_type_descriptions": all});
    let digest = Sha256::new().update(text(&whole).as_bytes()).finalize();
    let digits: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    format!("RIHS01_{digits}")
}

#[test]
fn hashes_of_types_are_those_of_their_definitions() {
    let plain = types();
    let mut later = types();
    let feedback = "control_msgs/action/FollowJointTrajectory_Feedback";
    let with_index = later.get_mut(feedback).unwrap();
    let at = with_index
        .iter()
        .position(|(_, name)| name == "error")
        .unwrap();
    with_index.insert(at + 1, ("int32".to_owned(), "index".to_owned()));
    with_index.push(("int32".to_owned(), "multi_dof_index".to_owned()));
    let mut wrong = Vec::new();
    for ty in ALL {
        let types = if *ty == FOLLOW_FEEDBACK_INDEX {
            &later
        } else {
            &plain
        };
        let computed = hash(ty.name, types);
        if computed != ty.hash {
            wrong.push(format!("{}: {computed}", ty.name));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn dds_names_are_those_of_rmw() {
    assert_eq!(STRING.dds_name(), "std_msgs::msg::dds_::String_");
    assert_eq!(
        CANCEL_GOAL.dds_name(),
        "action_msgs::srv::dds_::CancelGoal_"
    );
    let feedback = "control_msgs::action::dds_::FollowJointTrajectory_FeedbackMessage_";
    assert_eq!(FOLLOW_FEEDBACK.dds_name(), feedback);
}
