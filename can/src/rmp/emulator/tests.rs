//! The driver with emulated power bases, in virtual time.

use std::time::Duration;

use super::super::{
    BACK, Base, Channel, DriverConfig, FRONT, Hindrance, Integrators, Mode, Model, Omni,
    OmniConfig, State, StatusWord1, YawSign,
};
use super::*;

const MS: Duration = Duration::from_millis(1);

struct Single {
    base: Base,
    powerbase: Powerbase,
    now: Duration,
    connected: bool,
}

impl Single {
    fn new() -> Self {
        Self::with(PowerbaseConfig::default())
    }

    fn with(config: PowerbaseConfig) -> Self {
        let driver = DriverConfig {
            model: config.model,
            ..DriverConfig::default()
        };
        Self {
            base: Base::new(driver, 1.0, 2.0),
            powerbase: Powerbase::new(config),
            now: Duration::ZERO,
            connected: true,
        }
    }

    fn run(&mut self, wanted: Option<[f64; 2]>, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now += MS;
            if let Some(frame) = self.base.poll_transmit(wanted, self.now)
                && self.connected
            {
                self.powerbase.handle_frame(&frame, self.now);
            }
            while let Some((channel, frame)) = self.powerbase.poll_transmit(self.now) {
                if self.connected {
                    self.base.handle_frame(channel, &frame, self.now);
                }
            }
        }
    }

    fn ready() -> Self {
        let mut single = Self::new();
        single.start();
        single
    }

    fn start(&mut self) {
        self.run(None, Duration::from_secs(1));
        assert_eq!(self.base.driver().state(), State::Ready);
    }

    fn state(&self) -> State {
        self.base.driver().state()
    }

    fn speed(&self) -> f64 {
        let [left, right] = self.powerbase.speed();
        f64::midpoint(left, right)
    }
}

const fn s(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

#[test]
fn rmp_driver_configures_power_base_which_follows() {
    let mut single = Single::ready();
    assert_eq!(single.powerbase.mode(), Mode::Tractor);
    assert_eq!(
        single.powerbase.scales(),
        [16; 3],
        "the stored scale is not believed"
    );
    single.run(Some([0.5, 0.0]), s(3));
    assert!((single.speed() - 0.5).abs() < 0.005, "{}", single.speed());
    single.run(Some([0.3, 0.4]), s(5));
    let motion = single.base.motion();
    assert!((motion.velocity[2] - 0.4).abs() < 0.02, "{motion:?}");
    assert_eq!(single.powerbase.hurried(), 0);
}

#[test]
fn rmp_odometry_matches_truth_over_resets_and_wraps() {
    let mut single = Single::ready();
    single.powerbase.faults.keeps = Integrators(0b0101);
    for leg in 0..8 {
        single.run(Some([0.6, 0.0]), s(4));
        single.run(Some([0.2, 0.5]), s(3));
        if leg == 3 {
            let reset = super::super::Command {
                config: super::super::Config::ResetIntegrators(Integrators::ALL),
                ..super::super::Command::default()
            };
            single.powerbase.handle_frame(&reset.frame(), single.now);
        }
    }
    single.run(None, s(2));
    let (measured, truth) = (single.base.motion().pose, single.powerbase.truth());
    let path = 8.0 * (0.6 * 4.0 + 0.2 * 3.0);
    let off = (measured.x - truth.x).hypot(measured.y - truth.y);
    assert!(off < path * 0.001, "{off} m of {path} m");
    assert!((measured.heading - truth.heading).abs() < truth.heading * 0.001);
    assert!(single.base.jumps() > 0, "the reset was seen");
}

#[test]
fn rmp_power_base_stops_without_host() {
    let mut single = Single::ready();
    single.run(Some([0.5, 0.0]), s(2));
    single.connected = false;
    single.run(Some([0.5, 0.0]), s(2));
    assert!(single.speed().abs() < 1e-3);
    assert_eq!(single.state(), State::Silent);
    single.connected = true;
    single.run(Some([0.5, 0.0]), s(2));
    assert_eq!(single.state(), State::Ready);
    assert!(
        single.speed().abs() < 1e-3,
        "moves by itself after a lost link"
    );
    single.run(None, s(1));
    single.run(Some([0.5, 0.0]), s(2));
    assert!((single.speed() - 0.5).abs() < 0.005);
}

#[test]
fn rmp_base_without_set_points_decelerates_to_rest() {
    let mut single = Single::ready();
    single.run(Some([0.5, 0.0]), s(2));
    single.run(None, Duration::from_millis(300));
    assert!((0.1..0.45).contains(&single.speed()), "{}", single.speed());
    single.run(None, s(1));
    assert!(single.speed().abs() < 1e-3);
}

#[test]
fn rmp_every_hindrance_is_reported_and_cleared() {
    let fault = StatusWord1(0x2000);
    for (inject, wanted) in [
        (
            (|faults: &mut Faults| faults.emergency_stop = true) as fn(&mut Faults),
            Hindrance::EmergencyStop,
        ),
        (
            |faults| faults.word1 = 0x2000,
            Hindrance::Fault(StatusWord1(fault.0 | StatusWord1::MOTORS_ENABLED.0)),
        ),
    ] {
        let mut single = Single::ready();
        single.run(Some([0.5, 0.0]), s(2));
        inject(&mut single.powerbase.faults);
        single.run(Some([0.5, 0.0]), s(1));
        assert_eq!(single.state(), State::Blocked(wanted));
        assert_eq!(single.base.driver().lost(), 1);
        single.powerbase.faults = Faults::default();
        single.run(Some([0.5, 0.0]), s(2));
        assert_eq!(single.state(), State::Ready, "{wanted}");
        assert!(
            single.speed().abs() < 1e-3,
            "moves by itself after {wanted}"
        );
    }
}

#[test]
fn rmp_refused_mode_is_reported() {
    let mut single = Single::new();
    single.powerbase.faults.refuses_mode = true;
    single.run(None, s(3));
    let refused = Hindrance::ModeRefused(Mode::Disabled);
    assert_eq!(single.state(), State::Blocked(refused));
    assert!(refused.to_string().contains("disabled"));
}

#[test]
fn rmp_power_base_off_differs_from_silent() {
    let mut single = Single::new();
    single.powerbase.power(false);
    single.run(None, s(1));
    assert_eq!(single.state(), State::PoweredOff);
    single.powerbase.power(true);
    single.start();
    single.powerbase.power(false);
    single.run(None, s(1));
    assert_eq!(single.state(), State::PoweredOff);
    single.connected = false;
    single.run(None, s(1));
    assert_eq!(single.state(), State::Silent, "its cable was pulled");
    let mut silent = Single::new();
    silent.connected = false;
    silent.run(None, s(1));
    assert_eq!(silent.state(), State::Silent);
}

#[test]
fn rmp_power_cycle_keeps_pose() {
    let mut single = Single::ready();
    single.run(Some([0.5, 0.0]), s(3));
    single.run(None, s(2));
    single.powerbase.power(false);
    single.run(None, s(1));
    single.powerbase.power(true);
    single.run(None, s(2));
    let (measured, truth) = (single.base.motion().pose, single.powerbase.truth());
    assert!(
        (measured.x - truth.x).abs() < 0.002,
        "{measured:?} {truth:?}"
    );
}

#[test]
fn rmp_silent_channel_is_replaced_by_other() {
    let mut single = Single::with(PowerbaseConfig {
        both_channels: true,
        ..PowerbaseConfig::default()
    });
    single.start();
    single.run(Some([0.5, 0.0]), s(2));
    single.powerbase.faults.silent = [true, false];
    single.run(Some([0.5, 0.0]), s(2));
    assert_eq!(single.state(), State::Ready);
    assert_eq!(single.base.driver().lost(), 0);
    let (measured, truth) = (single.base.motion().pose, single.powerbase.truth());
    assert!((measured.x - truth.x).abs() < 0.01);
}

#[test]
fn rmp_incomplete_cycle_is_dropped() {
    for id in 0x401..=0x406 {
        let mut single = Single::new();
        single.powerbase.faults.lacks = Some(id);
        single.run(None, s(1));
        assert_eq!(single.state(), State::Silent, "without {id:x}h");
        assert!(single.base.driver().broken() > 50);
    }
}

#[test]
fn rmp_silent_power_base_executes_shutdown() {
    let mut single = Single::ready();
    single.base.shut_down();
    single.run(None, s(1));
    assert!(matches!(single.state(), State::Silent | State::PoweredOff));
}

struct Platform {
    omni: Omni,
    pair: Pair,
    now: Duration,
    cut: Option<usize>,
    fastest: f64,
}

impl Platform {
    fn ready() -> Self {
        let config = OmniConfig::default();
        let mut platform = Self {
            omni: Omni::new(config),
            pair: Pair::new(config),
            now: Duration::ZERO,
            cut: None,
            fastest: 0.0,
        };
        platform.pair.parts[FRONT].store_scale(6);
        platform.run(None, s(1));
        assert!(platform.omni.follows());
        platform
    }

    fn run(&mut self, wanted: Option<[f64; 3]>, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now += MS;
            let frames = self.omni.poll_transmit(wanted, self.now);
            for (part, frame) in frames.into_iter().enumerate() {
                if let Some(frame) = frame
                    && self.cut != Some(part)
                {
                    self.pair.handle_frame(part, &frame, self.now);
                }
            }
            for part in [FRONT, BACK] {
                while let Some((channel, frame)) = self.pair.poll_transmit(part, self.now) {
                    if self.cut != Some(part) {
                        self.omni.handle_frame(part, channel, &frame, self.now);
                    }
                }
            }
            let speeds = self.pair.parts.iter().flat_map(Powerbase::speed);
            self.fastest = speeds.map(f64::abs).fold(0.0, f64::max);
        }
    }

    fn off(&self) -> f64 {
        let (measured, truth) = (self.omni.motion().pose, self.pair.truth());
        (measured.x - truth.x).hypot(measured.y - truth.y)
    }
}

#[test]
fn rmp_platform_follows_velocity_in_every_direction() {
    for wanted in [
        [0.3, 0.0, 0.0],
        [0.0, 0.3, 0.0],
        [0.0, 0.0, 0.4],
        [0.2, -0.2, 0.3],
    ] {
        let mut platform = Platform::ready();
        platform.run(Some(wanted), s(4));
        for (measured, wanted) in platform.omni.motion().velocity.iter().zip(wanted) {
            assert!((measured - wanted).abs() < 0.01, "{measured} for {wanted}");
        }
        assert!(platform.omni.slip().abs() < 0.02);
    }
}

#[test]
fn rmp_platform_odometry_matches_truth() {
    let mut platform = Platform::ready();
    for part in &mut platform.pair.parts {
        part.faults.keeps = Integrators::RIGHT;
    }
    for wanted in [
        [0.3, 0.0, 0.3],
        [0.0, -0.3, 0.2],
        [-0.2, 0.2, -0.4],
        [0.3, 0.1, 0.0],
    ] {
        platform.run(Some(wanted), s(10));
    }
    platform.run(None, s(2));
    let path = 12.0;
    assert!(
        platform.off() < path * 0.001,
        "{} m of {path} m",
        platform.off()
    );
}

#[test]
fn rmp_one_lost_link_stops_both_power_bases() {
    for part in [FRONT, BACK] {
        let mut platform = Platform::ready();
        platform.run(Some([0.3, 0.2, 0.0]), s(2));
        platform.cut = Some(part);
        platform.run(Some([0.3, 0.2, 0.0]), s(2));
        assert!(
            platform.fastest < 1e-3,
            "part {part} lost, {} m/s",
            platform.fastest
        );
        platform.cut = None;
        platform.run(Some([0.3, 0.2, 0.0]), s(2));
        assert!(platform.fastest < 1e-3, "moves by itself");
        platform.run(None, s(1));
        platform.run(Some([0.3, 0.0, 0.0]), s(2));
        assert!(platform.fastest > 0.2);
    }
}

#[test]
fn rmp_platform_limit_keeps_direction() {
    let mut platform = Platform::ready();
    platform.run(Some([6.0, 3.0, 0.0]), s(8));
    let [x, y, rotation] = platform.omni.motion().velocity;
    assert!((y / x - 0.5).abs() < 0.01, "{x} {y}");
    assert!(rotation.abs() < 0.01);
}

#[test]
fn rmp_models_have_names_and_scales() {
    for model in Model::ALL {
        assert_eq!(Model::named(model.name()), Some(model));
        assert!(model.scales().displacement > model.scales().speed);
    }
    assert_eq!(Channel::default(), Channel::A);
}

/// Turns a base left for some seconds; returns its heading, and whether rate and integral contradict each other.
fn turned_left(base: YawSign, setting: YawSign) -> (f64, bool) {
    let mut powerbase = Powerbase::new(PowerbaseConfig {
        yaw_integral: base,
        ..PowerbaseConfig::default()
    });
    let config = DriverConfig {
        yaw_integral: setting,
        ..DriverConfig::default()
    };
    let mut driven = Base::new(config, 1.0, 1.5);
    for ms in 0..8_000_u32 {
        let now = Duration::from_millis(ms.into());
        while let Some((channel, frame)) = powerbase.poll_transmit(now) {
            driven.handle_frame(channel, &frame, now);
        }
        // After it is configured, it wants to be commanded to rest once.
        let wanted = (ms > 3_000).then_some([0.0, 0.5]);
        if let Some(frame) = driven.poll_transmit(wanted, now) {
            powerbase.handle_frame(&frame, now);
        }
    }
    (driven.motion().pose.heading, driven.yaw_contradicts())
}

#[test]
fn rmp_yaw_integral_sign_is_set_and_checked() {
    for base in YawSign::ALL {
        let (heading, contradicts) = turned_left(base, base);
        assert!(heading > 1.0 && !contradicts, "{base:?} {heading}");
        let (heading, contradicts) = turned_left(base, base.other());
        assert!(heading < -1.0 && contradicts, "{base:?} {heading}");
        assert_eq!(YawSign::named(base.name()), Some(base));
    }
}
