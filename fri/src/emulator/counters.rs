//! Totals of an emulated controller, common to both generations. Nothing is counted here.

/// Totals since the controller's start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ControllerCounters {
    /// Measurements sent, including those lost by the line.
    pub sent: u64,
    /// New answers received.
    pub answers: u64,
    /// Cycles (LWR) or command periods (Sunrise) without an answer in time.
    pub missed: u32,
    /// Answers ignored as duplicates or as older than the newest.
    pub old: u64,
    /// Datagrams rejected by the decoder, or in another framing.
    pub malformed: u64,
    /// Datagrams lost by fault settings, both directions.
    pub dropped: u64,
    /// Measurements not sent because the emulator's host stalled; not the client's fault.
    pub stalls: u64,
    /// Outputs written by the client that do not exist; 0 for an LWR.
    pub refused_ios: u64,
}
