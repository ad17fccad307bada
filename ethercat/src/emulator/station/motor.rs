//! A DC servomotor with its velocity amplifier, gear, brake and proximity switch: first order with back EMF.

/// Counts of the encoder in a turn of the motor: 500 lines, four edges each. One C pulse a turn.
pub(super) const TURN: i64 = 2000;
/// Play of the proximity switch, degrees of the joint.
const HYSTERESIS_DEG: f64 = 0.5;
/// Longest step of the model, s.
const STEP_S: f64 = 1e-3;
/// Largest current that friction absorbs at standstill, as volts.
const FRICTION_V: f64 = 0.005;

/// What an amplifier with that fault adds by itself, V: more than a driver compensates.
const FAULTY_OFFSET_V: f64 = 0.5;

/// A motor of the station.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StationMotor {
    /// Turns of the motor for one of the joint.
    pub gear: f64,
    /// Speed of the motor at 10 V, turns per second.
    pub speed_max: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
    /// Voltage that the amplifier adds by itself, V.
    pub offset_v: f64,
    /// Angle of the joint at power-on, degrees.
    pub start_deg: f64,
    /// The proximity switch is on at this angle and below, degrees.
    pub proximity_deg: f64,
    /// End stops, degrees.
    pub stops_deg: [f64; 2],
    /// Position of the C pulse in a turn of the motor, counts.
    pub index_at: i64,
}

impl StationMotor {
    /// The three motors of the station: each starts elsewhere, and has another offset.
    #[must_use]
    pub fn three() -> [Self; super::STATION_AXES] {
        [(20.0, 0.02), (35.0, -0.03), (-10.0, 0.025)].map(|(start_deg, offset_v)| Self {
            start_deg,
            offset_v,
            ..Self::default()
        })
    }
}

impl Default for StationMotor {
    /// 3,000 min⁻¹ at 10 V, gear 100, switch at -80 degrees.
    fn default() -> Self {
        Self {
            gear: 100.0,
            speed_max: 50.0,
            time_constant_s: 8e-3,
            offset_v: 0.0,
            start_deg: 20.0,
            proximity_deg: -80.0,
            stops_deg: [-120.0, 120.0],
            index_at: 700,
        }
    }
}

/// Faults of a motor and its wires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a fault of its own, and several may be there"
)]
pub struct StationFaults {
    /// The encoder is cut off: open circuit, the counter stands.
    pub open_circuit: bool,
    /// The encoder gives no C pulse.
    pub no_index: bool,
    /// The proximity switch is stuck on or off.
    pub proximity: Option<bool>,
    /// The brake stays closed.
    pub brake_stuck: bool,
    /// The amplifier is not ready.
    pub not_ready: bool,
    /// The motor is connected the wrong way round.
    pub reversed: bool,
    /// The motor is not connected: it turns at no voltage.
    pub motor_open: bool,
    /// The amplifier adds 0.5 V more by itself.
    pub offset: bool,
    /// The supply is off: the amplifier is not ready, and the brake is closed.
    pub power_lost: bool,
}

impl StationFaults {
    /// Names of the faults, and what each does.
    pub const NAMES: [(&'static str, &'static str); 10] = [
        ("open-circuit", "the encoder is cut off"),
        ("no-index", "the encoder gives no C pulse"),
        ("switch-on", "the proximity switch is stuck on"),
        ("switch-off", "the proximity switch is stuck off"),
        ("brake-stuck", "the brake stays closed"),
        ("not-ready", "the amplifier is not ready"),
        ("reversed", "the motor turns the wrong way"),
        ("motor-open", "the motor is not connected and does not move"),
        ("offset", "the amplifier adds 0.5 V by itself"),
        ("power-lost", "the supply is off, and the brake closes"),
    ];

    /// Adds the fault of this name; false if there is none.
    #[must_use]
    pub fn add(&mut self, name: &str) -> bool {
        match name {
            "open-circuit" => self.open_circuit = true,
            "no-index" => self.no_index = true,
            "switch-on" => self.proximity = Some(true),
            "switch-off" => self.proximity = Some(false),
            "brake-stuck" => self.brake_stuck = true,
            "not-ready" => self.not_ready = true,
            "reversed" => self.reversed = true,
            "motor-open" => self.motor_open = true,
            "offset" => self.offset = true,
            "power-lost" => self.power_lost = true,
            _ => return false,
        }
        true
    }
}

/// A motor in motion.
#[derive(Clone, Debug)]
pub(super) struct Motor {
    config: StationMotor,
    pub(super) faults: StationFaults,
    /// Outputs of the terminals.
    pub(super) volts: f64,
    pub(super) released: bool,
    pub(super) enabled: bool,
    /// Counts since zero of the joint, and their rate per second.
    counts: f64,
    speed: f64,
    near: bool,
}

impl Motor {
    pub(super) fn new(config: StationMotor) -> Self {
        Self {
            config,
            faults: StationFaults::default(),
            volts: 0.0,
            released: false,
            enabled: false,
            counts: config.start_deg * per_degree(&config),
            speed: 0.0,
            near: config.start_deg <= config.proximity_deg,
        }
    }

    pub(super) fn angle(&self) -> f64 {
        self.counts / per_degree(&self.config)
    }

    pub(super) const fn is_braked(&self) -> bool {
        !self.released || self.faults.brake_stuck || self.faults.power_lost
    }

    pub(super) const fn is_ready(&self) -> bool {
        self.enabled && !self.faults.not_ready && !self.faults.power_lost
    }

    pub(super) fn proximity(&self) -> bool {
        self.faults.proximity.unwrap_or(self.near)
    }

    /// The count of the encoder, from zero of the joint.
    #[expect(clippy::cast_possible_truncation, reason = "far below 2^53")]
    pub(super) const fn count(&self) -> i64 {
        self.counts.floor() as i64
    }

    /// The count of the C pulse that lies between two counts, the nearest to the first.
    pub(super) fn index_between(&self, from: i64, to: i64) -> Option<i64> {
        if self.faults.no_index || from == to {
            return None;
        }
        let at = self.config.index_at;
        let pulse = if to > from {
            from + 1 + (at - from - 1).rem_euclid(TURN)
        } else {
            from - (from - at).rem_euclid(TURN)
        };
        let passed = if to > from { pulse <= to } else { pulse > to };
        passed.then_some(pulse)
    }

    /// Moves on by a time, s.
    pub(super) fn run(&mut self, dt_s: f64) {
        let mut left = dt_s.clamp(0.0, 1.0);
        while left > 0.0 {
            let dt = left.min(STEP_S);
            left -= dt;
            self.step(dt);
        }
        let angle = self.angle();
        let config = &self.config;
        self.near = angle <= config.proximity_deg
            || (self.near && angle < config.proximity_deg + HYSTERESIS_DEG);
    }

    fn step(&mut self, dt: f64) {
        let config = &self.config;
        let faults = self.faults;
        let powered = self.is_ready() && !faults.motor_open;
        let sign = if faults.reversed { -1.0 } else { 1.0 };
        let offset = config.offset_v + if faults.offset { FAULTY_OFFSET_V } else { 0.0 };
        let volts = if powered {
            self.volts * sign + offset
        } else {
            0.0
        };
        let volts = if volts.abs() < FRICTION_V { 0.0 } else { volts };
        let wanted = volts / 10.0 * config.speed_max * TURN as f64;
        self.speed += (wanted - self.speed) * (dt / config.time_constant_s).min(1.0);
        if self.is_braked() {
            self.speed = 0.0;
        }
        let per_degree = per_degree(config);
        let [low, high] = config.stops_deg.map(|angle| angle * per_degree);
        let next = self.counts + self.speed * dt;
        if next < low || next > high {
            self.speed = 0.0;
        }
        self.counts = next.clamp(low, high);
    }
}

#[expect(clippy::cast_precision_loss, reason = "2,000")]
fn per_degree(config: &StationMotor) -> f64 {
    config.gear * TURN as f64 / 360.0
}
