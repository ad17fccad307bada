//! What the owner of an axis commands in each cycle.

/// Cyclic command of an axis. Targets apply only while it follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisCommand {
    /// 607Ah, user units; in interpolated position the data record 60C1h:01.
    pub position: i32,
    /// 60FFh, user units/s.
    pub velocity: i32,
    /// 6071h, per mille of the rated torque.
    pub torque: i16,
    /// 60B0h, user units; added to the position.
    pub position_offset: i32,
    /// 60B1h, user units/s; added to the velocity.
    pub velocity_offset: i32,
    /// 60B2h, per mille of the rated torque.
    pub torque_offset: i16,
    /// Mode-specific bits 4 to 6, 8 (halt) and 9 of the controlword.
    pub mode_bits: u16,
}
