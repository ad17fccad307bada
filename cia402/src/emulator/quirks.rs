//! Deviations of real drives from the profile, as switches. Each is one that a master must tolerate; the profile itself
//! is [`Quirks::default`].

use std::time::Duration;

/// How a drive departs from the profile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Quirks {
    /// Switch on disabled is shown as 0020h (slaves on a sample stack before version 5.12).
    pub sod_as_0020: bool,
    /// A fault is reset by the level of bit 7, not by its edge.
    pub fault_reset_by_level: bool,
    /// Transition 16 exists.
    pub transition_16: bool,
    /// Bit 2 of the controlword (quick stop) is ignored.
    pub no_quick_stop: bool,
    /// Supported quick stop option codes; empty for all of the profile.
    pub quick_stop_options: &'static [i16],
    /// The mode changes only while halt is low.
    pub mode_needs_no_halt: bool,
    /// The mode changes only in Operation enabled.
    pub mode_after_enable: bool,
    /// Delay from 6060h to 6061h.
    pub mode_delay: Duration,
    /// Cyclic modes follow only while controlword bits 4 to 6 are high.
    pub cyclic_needs_bits_4_to_6: bool,
    /// Bit 12 of the statusword stays low in cyclic modes.
    pub no_follow_bit: bool,
    /// Homing ends without target reached.
    pub homing_without_target_reached: bool,
    /// 6098h does not accept 0.
    pub no_homing_method_0: bool,
    /// After homing the home position reads as + 607Ch; by the profile it is - 607Ch.
    pub home_offset_positive: bool,
    /// Cycles without a set-point after which cyclic modes fault; `None` for never.
    pub missing_set_points: Option<u32>,
    /// Modes of 6502h.
    pub supported_modes: u32,
    /// 605Ah, 6007h and 6065h after a reset.
    pub defaults: (i16, i16, u32),
    /// Bit 9 of 6041h is low although the drive follows 6040h.
    pub never_remote: bool,
    /// Bit 10 of 6041h is high in a fault (0638h).
    pub reached_in_fault: bool,
    /// Number of enablings that end in a fault (5201h) right after Operation enabled; `u32::MAX` for all.
    pub faults_on_enable: u32,
}

impl Default for Quirks {
    fn default() -> Self {
        Self {
            sod_as_0020: false,
            fault_reset_by_level: false,
            transition_16: true,
            no_quick_stop: false,
            quick_stop_options: &[],
            mode_needs_no_halt: false,
            mode_after_enable: false,
            mode_delay: Duration::ZERO,
            cyclic_needs_bits_4_to_6: false,
            no_follow_bit: false,
            homing_without_target_reached: false,
            no_homing_method_0: false,
            home_offset_positive: false,
            missing_set_points: Some(3),
            // PP VL PV TQ HM IP CSP CSV CST.
            supported_modes: 0x3EF,
            defaults: (2, 1, 20_000),
            never_remote: false,
            reached_in_fault: false,
            faults_on_enable: 0,
        }
    }
}

impl Quirks {
    /// The quirks of that name; see [`Self::NAMES`].
    pub fn named(name: &str) -> Option<Self> {
        let plain = Self::default();
        Some(match name {
            "profile" => plain,
            "epos4" => Self {
                defaults: (6, 3, 2000),
                home_offset_positive: true,
                supported_modes: 0x3A5,
                no_homing_method_0: true,
                ..plain
            },
            "ax8000" => Self {
                quick_stop_options: &[2, 6, -1],
                transition_16: false,
                ..plain
            },
            "ssc-5.11" => Self {
                sod_as_0020: true,
                fault_reset_by_level: true,
                transition_16: false,
                ..plain
            },
            "el7411" => Self {
                no_quick_stop: true,
                ..plain
            },
            "halt-before-mode" => Self {
                mode_needs_no_halt: true,
                mode_delay: Duration::from_millis(20),
                ..plain
            },
            "mis" => Self {
                homing_without_target_reached: true,
                ..plain
            },
            "dm556ec" => Self {
                cyclic_needs_bits_4_to_6: true,
                ..plain
            },
            "never-remote" => Self {
                never_remote: true,
                ..plain
            },
            "reached-in-fault" => Self {
                reached_in_fault: true,
                ..plain
            },
            _ => return None,
        })
    }

    /// Names for [`Self::named`].
    pub const NAMES: [&'static str; 10] = [
        "profile",
        "epos4",
        "ax8000",
        "ssc-5.11",
        "el7411",
        "halt-before-mode",
        "mis",
        "dm556ec",
        "never-remote",
        "reached-in-fault",
    ];
}
