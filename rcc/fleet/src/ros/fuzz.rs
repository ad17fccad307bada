//! What must hold for any bytes from the network: no panic, and what was read can be written and read again. Random inputs are
//! those of the test, and of the fuzz target `ros`.

use super::keys::{Attachment, Endpoint};
use super::messages::{
    FollowGoal, GripperGoal, Trajectory, decode_cancel, decode_get_result, decode_set_bool,
};

/// Reads bytes as everything that comes from others.
///
/// # Panics
/// If a property is violated.
#[expect(clippy::panic, reason = "a fuzz function reports what it finds")]
pub fn fuzz(bytes: &[u8]) {
    // The first byte chooses nothing: each reader gets all of it.
    if let Ok(goal) = FollowGoal::decode(bytes)
        && goal.multi_dof == 0
    {
        let again = FollowGoal::decode(&goal.encode());
        let same = again.is_ok_and(|again| again.encode() == goal.encode());
        if !same {
            panic!("a goal is not read as written");
        }
        let joints = goal.trajectory.joints.clone();
        drop(super::goal::check(&goal, &joints, 0));
    }
    drop(Trajectory::decode(bytes));
    drop(GripperGoal::decode(bytes));
    drop(GripperGoal::decode_parallel(bytes));
    drop(decode_cancel(bytes));
    drop(decode_get_result(bytes));
    drop(decode_set_bool(bytes));
    if let Some(attachment) = Attachment::decode(bytes)
        && attachment.encode() != bytes
    {
        panic!("an attachment is not read as written");
    }
    drop(Endpoint::read(&String::from_utf8_lossy(bytes)));
}
