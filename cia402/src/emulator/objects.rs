//! The objects of the profile that the emulated drive supports, one row each. Their behaviour is elsewhere.

use crate::dictionary::{Access, Address, Dictionary, DictionaryError, Entry, Key, Object, PdoUse};

/// Makes the struct of keys and the rows of entries from one table.
macro_rules! objects {
    ($($(#[doc = $doc:literal])* $key:ident: $number:ty =
       $index:literal $sub:literal $name:literal $access:ident $pdo:ident $default:expr;)*) => {
        /// Keys of the drive's objects in a dictionary.
        #[derive(Clone, Copy, Debug)]
        #[expect(dead_code, reason = "some objects are used by the bus alone")]
        pub(super) struct Keys {
            $($(#[doc = $doc])* pub(super) $key: Key<$number>,)*
        }

        impl Keys {
            /// Finds the objects of an axis.
            pub(super) fn new(dictionary: &Dictionary, axis: u8) -> Result<Self, DictionaryError> {
                let on_axis = |index, sub| {
                    let address = Address::new(index, sub);
                    address.on_axis(axis).ok_or(DictionaryError::Missing(address))
                };
                Ok(Self {
                    $($key: dictionary.key(on_axis($index, $sub)?)?,)*
                })
            }
        }

        fn rows() -> Vec<(Address, Entry)> {
            vec![$((
                Address::new($index, $sub),
                Entry::number::<$number>($name, Access::$access, $default)
                    .mappable(PdoUse::$pdo),
            ),)*]
        }
    };
}

objects! {
    control_word: u16 = 0x6040 0 "controlword" ReadWrite Receive 0;
    status_word: u16 = 0x6041 0 "statusword" ReadOnly Transmit 0;
    error_code: u16 = 0x603F 0 "error code" ReadOnly Transmit 0;
    abort_connection: i16 = 0x6007 0 "abort connection option code" ReadWrite None 1;
    quick_stop_option: i16 = 0x605A 0 "quick stop option code" ReadWrite None 2;
    shutdown_option: i16 = 0x605B 0 "shutdown option code" ReadWrite None 0;
    disable_option: i16 = 0x605C 0 "disable operation option code" ReadWrite None 1;
    halt_option: i16 = 0x605D 0 "halt option code" ReadWrite None 1;
    fault_option: i16 = 0x605E 0 "fault reaction option code" ReadWrite None 2;
    mode: i8 = 0x6060 0 "modes of operation" ReadWrite Receive 0;
    mode_display: i8 = 0x6061 0 "modes of operation display" ReadOnly Transmit 0;
    supported_modes: u32 = 0x6502 0 "supported drive modes" ReadOnly Transmit 0;
    vl_target: i16 = 0x6042 0 "vl target velocity" ReadWrite Receive 0;
    vl_demand: i16 = 0x6043 0 "vl velocity demand" ReadOnly Transmit 0;
    vl_actual: i16 = 0x6044 0 "vl velocity actual value" ReadOnly Transmit 0;
    vl_min: u32 = 0x6046 1 "vl velocity min amount" ReadWrite None 0;
    vl_max: u32 = 0x6046 2 "vl velocity max amount" ReadWrite None 3000;
    vl_acceleration_speed: u32 = 0x6048 1 "delta speed" ReadWrite None 6000;
    vl_acceleration_time: u16 = 0x6048 2 "delta time" ReadWrite None 1;
    vl_deceleration_speed: u32 = 0x6049 1 "delta speed" ReadWrite None 6000;
    vl_deceleration_time: u16 = 0x6049 2 "delta time" ReadWrite None 1;
    vl_numerator: i32 = 0x604C 1 "vl dimension factor numerator" ReadWrite None 1;
    vl_denominator: i32 = 0x604C 2 "vl dimension factor denominator" ReadWrite None 1;
    position_demand: i32 = 0x6062 0 "position demand value" ReadOnly Transmit 0;
    position_internal: i32 = 0x6063 0 "position actual internal value" ReadOnly Transmit 0;
    position_actual: i32 = 0x6064 0 "position actual value" ReadOnly Transmit 0;
    following_window: u32 = 0x6065 0 "following error window" ReadWrite Both 20_000;
    following_timeout: u16 = 0x6066 0 "following error time out" ReadWrite Both 10;
    position_window: u32 = 0x6067 0 "position window" ReadWrite Both 10;
    position_window_time: u16 = 0x6068 0 "position window time" ReadWrite Both 10;
    velocity_demand: i32 = 0x606B 0 "velocity demand value" ReadOnly Transmit 0;
    velocity_actual: i32 = 0x606C 0 "velocity actual value" ReadOnly Transmit 0;
    velocity_window: u16 = 0x606D 0 "velocity window" ReadWrite Both 100;
    velocity_window_time: u16 = 0x606E 0 "velocity window time" ReadWrite Both 10;
    velocity_threshold: u16 = 0x606F 0 "velocity threshold" ReadWrite Both 100;
    velocity_threshold_time: u16 = 0x6070 0 "velocity threshold time" ReadWrite Both 10;
    target_torque: i16 = 0x6071 0 "target torque" ReadWrite Receive 0;
    max_torque: u16 = 0x6072 0 "max torque" ReadWrite Receive 3000;
    torque_demand: i16 = 0x6074 0 "torque demand" ReadOnly Transmit 0;
    rated_current: u32 = 0x6075 0 "motor rated current" ReadWrite None 2500;
    rated_torque: u32 = 0x6076 0 "motor rated torque" ReadWrite None 640;
    torque_actual: i16 = 0x6077 0 "torque actual value" ReadOnly Transmit 0;
    current_actual: i16 = 0x6078 0 "current actual value" ReadOnly Transmit 0;
    dc_link: u32 = 0x6079 0 "DC link circuit voltage" ReadOnly Transmit 48_000;
    target_position: i32 = 0x607A 0 "target position" ReadWrite Receive 0;
    home_offset: i32 = 0x607C 0 "home offset" ReadWrite None 0;
    limit_min: i32 = 0x607D 1 "min position limit" ReadWrite None 0;
    limit_max: i32 = 0x607D 2 "max position limit" ReadWrite None 0;
    polarity: u8 = 0x607E 0 "polarity" ReadWrite None 0;
    max_profile_velocity: u32 = 0x607F 0 "max profile velocity" ReadWrite Both 200_000;
    max_motor_speed: u32 = 0x6080 0 "max motor speed" ReadWrite None 3000;
    profile_velocity: u32 = 0x6081 0 "profile velocity" ReadWrite Receive 40_000;
    end_velocity: u32 = 0x6082 0 "end velocity" ReadWrite Receive 0;
    profile_acceleration: u32 = 0x6083 0 "profile acceleration" ReadWrite Receive 400_000;
    profile_deceleration: u32 = 0x6084 0 "profile deceleration" ReadWrite Receive 400_000;
    quick_stop_deceleration: u32 = 0x6085 0 "quick stop deceleration" ReadWrite Receive 2_000_000;
    motion_profile: i16 = 0x6086 0 "motion profile type" ReadWrite None 0;
    torque_slope: u32 = 0x6087 0 "torque slope" ReadWrite Receive 10_000;
    encoder_increments: u32 = 0x608F 1 "encoder increments" ReadWrite None 4096;
    encoder_revolutions: u32 = 0x608F 2 "motor revolutions" ReadWrite None 1;
    gear_motor: u32 = 0x6091 1 "motor shaft revolutions" ReadWrite None 1;
    gear_shaft: u32 = 0x6091 2 "driving shaft revolutions" ReadWrite None 1;
    feed: u32 = 0x6092 1 "feed" ReadWrite None 4096;
    feed_revolutions: u32 = 0x6092 2 "shaft revolutions" ReadWrite None 1;
    velocity_numerator: u32 = 0x6096 1 "velocity factor numerator" ReadWrite None 1;
    velocity_divisor: u32 = 0x6096 2 "velocity factor divisor" ReadWrite None 1;
    acceleration_numerator: u32 = 0x6097 1 "acceleration factor numerator" ReadWrite None 1;
    acceleration_divisor: u32 = 0x6097 2 "acceleration factor divisor" ReadWrite None 1;
    homing_method: i8 = 0x6098 0 "homing method" ReadWrite Receive 37;
    homing_fast: u32 = 0x6099 1 "speed during search for switch" ReadWrite Receive 20_000;
    homing_slow: u32 = 0x6099 2 "speed during search for zero" ReadWrite Receive 2000;
    homing_acceleration: u32 = 0x609A 0 "homing acceleration" ReadWrite Receive 400_000;
    jerk_use: u8 = 0x60A3 0 "profile jerk use" ReadWrite None 1;
    profile_jerk: u32 = 0x60A4 1 "profile jerk 1" ReadWrite Receive 20_000_000;
    position_offset: i32 = 0x60B0 0 "position offset" ReadWrite Receive 0;
    velocity_offset: i32 = 0x60B1 0 "velocity offset" ReadWrite Receive 0;
    torque_offset: i16 = 0x60B2 0 "torque offset" ReadWrite Receive 0;
    probe_function: u16 = 0x60B8 0 "touch probe function" ReadWrite Receive 0;
    probe_status: u16 = 0x60B9 0 "touch probe status" ReadOnly Transmit 0;
    probe_1_positive: i32 = 0x60BA 0 "touch probe 1 positive edge" ReadOnly Transmit 0;
    probe_1_negative: i32 = 0x60BB 0 "touch probe 1 negative edge" ReadOnly Transmit 0;
    probe_2_positive: i32 = 0x60BC 0 "touch probe 2 positive edge" ReadOnly Transmit 0;
    probe_2_negative: i32 = 0x60BD 0 "touch probe 2 negative edge" ReadOnly Transmit 0;
    interpolation_submode: i16 = 0x60C0 0 "interpolation sub mode select" ReadWrite None 0;
    interpolation_target: i32 = 0x60C1 1 "interpolation data record" ReadWrite Receive 0;
    interpolation_value: u8 = 0x60C2 1 "interpolation time period value" ReadWrite None 1;
    interpolation_index: i8 = 0x60C2 2 "interpolation time index" ReadWrite None -3;
    buffer_max: u32 = 0x60C4 1 "maximum buffer size" Const None 16;
    buffer_size: u32 = 0x60C4 2 "actual buffer size" ReadWrite None 1;
    buffer_organisation: u8 = 0x60C4 3 "buffer organisation" ReadWrite None 0;
    buffer_position: u16 = 0x60C4 4 "buffer position" ReadOnly None 0;
    record_size: u8 = 0x60C4 5 "size of data record" WriteOnly None 4;
    buffer_clear: u8 = 0x60C4 6 "buffer clear" WriteOnly None 0;
    max_acceleration: u32 = 0x60C5 0 "max acceleration" ReadWrite None 10_000_000;
    max_deceleration: u32 = 0x60C6 0 "max deceleration" ReadWrite None 10_000_000;
    positive_torque_limit: u16 = 0x60E0 0 "positive torque limit" ReadWrite Receive 3000;
    negative_torque_limit: u16 = 0x60E1 0 "negative torque limit" ReadWrite Receive 3000;
    positioning_option: u16 = 0x60F2 0 "positioning option code" ReadWrite None 0;
    following_error: i32 = 0x60F4 0 "following error actual value" ReadOnly Transmit 0;
    position_demand_internal: i32 = 0x60FC 0 "position demand internal value" ReadOnly Transmit 0;
    digital_inputs: u32 = 0x60FD 0 "digital inputs" ReadOnly Transmit 0;
    digital_outputs: u32 = 0x60FE 1 "physical outputs" ReadWrite Receive 0;
    output_mask: u32 = 0x60FE 2 "output bit mask" ReadWrite None 0;
    target_velocity: i32 = 0x60FF 0 "target velocity" ReadWrite Receive 0;
}

/// Limits on what can be written, beyond those of the types.
const LIMITS: [(u16, u8, i64, i64); 20] = [
    (0x6007, 0, 0, 3),
    (0x605A, 0, -1, 8),
    (0x605B, 0, 0, 1),
    (0x605C, 0, 0, 1),
    (0x605D, 0, 1, 4),
    (0x605E, 0, 0, 4),
    (0x6048, 2, 1, u16::MAX as i64),
    (0x6049, 2, 1, u16::MAX as i64),
    (0x6086, 0, 0, 3),
    (0x608F, 2, 1, u32::MAX as i64),
    (0x6091, 1, 1, u32::MAX as i64),
    (0x6098, 0, 0, 37),
    (0x60A3, 0, 1, 1),
    (0x60A4, 1, 1, u32::MAX as i64),
    (0x60C0, 0, 0, 0),
    (0x60C2, 2, -6, 0),
    (0x60C4, 2, 1, 16),
    (0x60C4, 3, 0, 1),
    (0x60C4, 5, 4, 4),
    (0x60C4, 6, 0, 1),
];

/// Names of objects with sub-indices.
const NAMES: [(u16, &str); 15] = [
    (0x6046, "vl velocity min max amount"),
    (0x6048, "vl velocity acceleration"),
    (0x6049, "vl velocity deceleration"),
    (0x604C, "vl dimension factor"),
    (0x607D, "software position limit"),
    (0x608F, "position encoder resolution"),
    (0x6091, "gear ratio"),
    (0x6092, "feed constant"),
    (0x6096, "velocity factor"),
    (0x6097, "acceleration factor"),
    (0x6099, "homing speeds"),
    (0x60A4, "profile jerk"),
    (0x60C1, "interpolation data record"),
    (0x60C2, "interpolation time period"),
    (0x60C4, "interpolation data configuration"),
];

/// The objects of an axis, 0 to 7.
pub(super) fn objects(axis: u8) -> Vec<Object> {
    let mut objects: Vec<Object> = Vec::new();
    for (address, mut entry) in rows() {
        let index = address.index + Address::AXIS * u16::from(axis.min(7));
        let same = |l: &&(u16, u8, i64, i64)| (l.0, l.1) == (address.index, address.sub);
        if let Some((.., low, high)) = LIMITS.iter().find(same) {
            entry = entry.within(*low, *high);
        }
        match objects.iter_mut().find(|object| object.index == index) {
            Some(object) => {
                object.entries.push((address.sub, entry));
                object.entries[0].1.default = vec![address.sub];
            }
            None if address.sub == 0 => objects.push(Object::var(index, entry)),
            None => {
                let named = NAMES.iter().find(|(known, _)| *known == address.index);
                let name = named.map_or("physical outputs", |(_, name)| name);
                objects.push(Object::record(index, name, vec![entry]));
            }
        }
    }
    objects
}
