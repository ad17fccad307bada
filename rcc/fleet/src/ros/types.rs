//! The message types that are spoken, with their hashes (RIHS01, REP-2016). The hashes are constants; a test computes each of them
//! from the definition of its type. Fields are in [`messages`](super::messages).

#[cfg(test)]
mod tests;

/// A type of messages, or of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Type {
    /// Package, kind and name, such as `std_msgs/msg/String`.
    pub name: &'static str,
    /// Its hash.
    pub hash: &'static str,
}

impl Type {
    /// The name as DDS writes it, such as `std_msgs::msg::dds_::String_`.
    #[must_use]
    pub fn dds_name(&self) -> String {
        let (package, name) = self.name.rsplit_once('/').unwrap_or(("", self.name));
        format!("{}::dds_::{name}_", package.replace('/', "::"))
    }
}

/// The types of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActionType {
    /// Service that sends a goal.
    pub send_goal: Type,
    /// Service that returns the result.
    pub get_result: Type,
    /// Messages about the progress.
    pub feedback: Type,
}

macro_rules! types {
    ($($(#[$doc:meta])* $constant:ident = $name:literal $hash:literal;)*) => {
        $($(#[$doc])* pub const $constant: Type = Type { name: $name, hash: concat!("RIHS01_", $hash) };)*

        /// All of them.
        pub const ALL: &[Type] = &[$($constant),*];
    };
}

types! {
    /// A text, such as a URDF.
    STRING = "std_msgs/msg/String" "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    /// Positions, velocities and torques of joints.
    JOINT_STATE = "sensor_msgs/msg/JointState" "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";
    /// Frames in their parents.
    TF_MESSAGE = "tf2_msgs/msg/TFMessage" "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
    /// States of devices.
    DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray" "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e";
    /// Points of joints over time.
    JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory" "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e";
    /// Force and torque.
    WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped" "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77";
    /// States of goals.
    GOAL_STATUS_ARRAY = "action_msgs/msg/GoalStatusArray" "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e";
    /// Cancels goals.
    CANCEL_GOAL = "action_msgs/srv/CancelGoal" "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a";
    /// Switches something.
    SET_BOOL = "std_srvs/srv/SetBool" "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a";
    /// Sends a goal to follow a trajectory.
    FOLLOW_SEND_GOAL = "control_msgs/action/FollowJointTrajectory_SendGoal" "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f";
    /// Result of following a trajectory.
    FOLLOW_GET_RESULT = "control_msgs/action/FollowJointTrajectory_GetResult" "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b";
    /// Progress along a trajectory, of `control_msgs` up to 6.2 (Humble, Jazzy, Kilted at their release).
    FOLLOW_FEEDBACK = "control_msgs/action/FollowJointTrajectory_FeedbackMessage" "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71";
    /// The same of `control_msgs` 6.3 and later, with the indices of the points.
    FOLLOW_FEEDBACK_INDEX = "control_msgs/action/FollowJointTrajectory_FeedbackMessage" "95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b";
    /// Sends a goal to a gripper.
    GRIPPER_SEND_GOAL = "control_msgs/action/GripperCommand_SendGoal" "6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212";
    /// Result of a gripper's goal.
    GRIPPER_GET_RESULT = "control_msgs/action/GripperCommand_GetResult" "7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd";
    /// Progress of a gripper's goal.
    GRIPPER_FEEDBACK = "control_msgs/action/GripperCommand_FeedbackMessage" "392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d";
    /// Sends a goal to a parallel gripper (Jazzy and later).
    PARALLEL_SEND_GOAL = "control_msgs/action/ParallelGripperCommand_SendGoal" "567c37373fed1260adbe047415688c73e4f3e94b2e3982761ecc71fd63d710a7";
    /// Result of a parallel gripper's goal.
    PARALLEL_GET_RESULT = "control_msgs/action/ParallelGripperCommand_GetResult" "e4c7f0e8a831ce5625ed20abcd13796406d945f92ebc7ad5972e0b0d29b381bd";
    /// Progress of a parallel gripper's goal.
    PARALLEL_FEEDBACK = "control_msgs/action/ParallelGripperCommand_FeedbackMessage" "c61f4cf99d06c5a3e24bed17c2910bdf66a30d89461e2ac7b5fd538a34b022cc";
}

/// Follows a trajectory, as clients with `control_msgs` up to 6.2 expect it.
pub const FOLLOW_JOINT_TRAJECTORY: ActionType = ActionType {
    send_goal: FOLLOW_SEND_GOAL,
    get_result: FOLLOW_GET_RESULT,
    feedback: FOLLOW_FEEDBACK,
};

/// Opens and closes a gripper.
pub const GRIPPER_COMMAND: ActionType = ActionType {
    send_goal: GRIPPER_SEND_GOAL,
    get_result: GRIPPER_GET_RESULT,
    feedback: GRIPPER_FEEDBACK,
};

/// Opens and closes a parallel gripper.
pub const PARALLEL_GRIPPER_COMMAND: ActionType = ActionType {
    send_goal: PARALLEL_SEND_GOAL,
    get_result: PARALLEL_GET_RESULT,
    feedback: PARALLEL_FEEDBACK,
};
