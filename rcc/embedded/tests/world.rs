//! Emulated robots in a world that they share, in virtual time: what the world does to them is read from the datagrams and
//! packets of the real devices.
#![expect(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};
use takt_can::rmp::{Base, DriverConfig};
use takt_devices::wsg::emulator::{Gripper, GripperConfig};
use takt_devices::wsg::wire::{Command, PACKET_MAX, Packet};
use takt_embedded::{CellWorld, Mounted};
use takt_fri::lwr::emulator::{Krc, KrcConfig, Sensing};
use takt_fri::lwr::wire::{Cmd, CmdFlags, Control, Msr};
use takt_fri::lwr::{Load, Session, SessionConfig};
use takt_fri::sunrise;
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX};
use takt_world::{BodyConfig, Builder, GraspConfig, Pose, SurfaceConfig, World};

/// Flange down, well above the table.
const JOINTS: [f64; 7] = [0.0, 0.5, 0.0, 1.2, 0.0, -1.0, 0.0];

/// An LWR with its client on the wire.
struct Pair {
    krc: Krc,
    session: Session,
    now: Duration,
}

impl Pair {
    fn new(world: &World, base: Pose, sensing: Sensing) -> Self {
        let config = KrcConfig {
            joints: JOINTS,
            control: Control::CartesianImpedance,
            sensing,
            ..KrcConfig::default()
        };
        let mut krc = Krc::new(config, Duration::ZERO);
        let hands = vec![world.hand("hand").unwrap()];
        krc.set_surroundings(Box::new(Mounted::new(base, hands)));
        let mut session = Session::new(SessionConfig::default());
        let flags = CmdFlags::JNTPOS | CmdFlags::CARTSTIFF | CmdFlags::CARTDAMP | CmdFlags::TCPFT;
        session.choose(flags).unwrap();
        let mut pair = Self {
            krc,
            session,
            now: Duration::ZERO,
        };
        pair.run(200);
        assert!(pair.session.is_commanding(), "{:?}", pair.krc);
        pair
    }

    fn run(&mut self, cycles: u32) {
        let (mut msr, mut cmd) = ([0; Msr::LEN], [0; Cmd::LEN]);
        for _ in 0..cycles {
            self.now = self.krc.poll_timeout();
            while self.krc.poll_transmit(self.now, &mut msr).is_some() {
                self.session.handle_datagram(&msr, self.now).unwrap();
                let joints = self.session.mirror();
                self.session.answer(Some(&joints), &mut cmd).unwrap();
                self.krc.handle_datagram(&cmd, self.now).unwrap();
            }
        }
    }

    /// External force along z of the base frame, N, as on the wire.
    fn force(&self) -> f64 {
        f64::from(self.session.measurement().unwrap().external_wrench[2])
    }
}

/// Where the flange is at first, in the base frame.
fn flange() -> Vector3<f64> {
    let config = KrcConfig {
        joints: JOINTS,
        ..KrcConfig::default()
    };
    Krc::new(config, Duration::ZERO).flange().into()
}

/// An arm that stands turned by a right angle somewhere in the world.
fn base() -> Pose {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    Isometry3::from_parts(Vector3::new(0.3, 0.2, 0.1).into(), turn)
}

/// A table below the tip by so much.
fn table(gap: f64) -> Builder {
    let mut at = base() * Isometry3::from(flange());
    at.rotation = UnitQuaternion::identity();
    at.translation.z -= gap;
    World::builder().surface(SurfaceConfig::table("table", at, [0.3, 0.3]))
}

fn pressed(sensing: Sensing) -> (Pair, World) {
    let world = table(0.002)
        .probe("hand", Pose::identity())
        .build()
        .unwrap();
    let mut pair = Pair::new(&world, base(), sensing);
    while pair.force() < 20.0 {
        let press = &mut pair.session.fields_mut().wrench[2];
        *press -= 0.05;
        assert!(*press > -60.0, "{}", pair.force());
        pair.run(5);
    }
    pair.run(500);
    (pair, world)
}

#[test]
fn lwr_impedance_presses_table_of_world() {
    let (mut pair, world) = pressed(Sensing::default());
    let wrench = world.truth().hand("hand").unwrap().wrench;
    let force = pair.force();
    assert!((force - 20.0).abs() < 2.0, "{force}");
    assert!((wrench.force.z - force).abs() < 0.05, "{force} {wrench:?}");
    // The estimated joint torques are those of the wrench: as much about the second axis as its lever gives.
    let torque = f64::from(pair.session.measurement().unwrap().external_torque[1]);
    assert!(torque.abs() > 2.0, "{torque}");
    // Away from the table, nothing is left.
    pair.session.fields_mut().wrench[2] = 20.0;
    pair.run(1000);
    assert!(pair.force().abs() < 1e-6, "{}", pair.force());
    assert!(world.truth().hand("hand").unwrap().touches.is_none());
}

#[test]
fn lwr_estimates_have_noise_and_delay() {
    let sensing = Sensing {
        noise_n: 1.0,
        noise_nm: 0.5,
        delay: Duration::from_millis(10),
    };
    let (mut pair, world) = pressed(sensing);
    let mut largest: f64 = 0.0;
    for _ in 0..200 {
        pair.run(1);
        let truth = world.truth().hand("hand").unwrap().wrench.force.z;
        largest = largest.max((pair.force() - truth).abs());
    }
    assert!((0.7..1.5).contains(&largest), "{largest}");
    // The table vanishes for the arm five cycles later than in truth.
    pair.session.fields_mut().wrench[2] = 40.0;
    while world.truth().hand("hand").unwrap().touches.is_some() {
        pair.run(1);
    }
    assert!(pair.force() > 1.0, "{}", pair.force());
    pair.run(6);
    assert!(pair.force().abs() <= 1.0, "{}", pair.force());
}

#[test]
fn lwr_carried_body_weighs_unless_stated() {
    let at = base() * Isometry3::from(flange());
    let body = BodyConfig::new("block", 1.5, [0.04, 0.04, 0.04])
        .at(at, None)
        .grip(Pose::identity(), 0.04);
    let grasp = GraspConfig {
        reach_m: [0.5; 3],
        ..GraspConfig::default()
    };
    // Whatever the wrist looks like, the fingers close along the grip.
    let world = World::builder()
        .body(body)
        .gripper("hand", Pose::identity(), grasp)
        .build()
        .unwrap();
    let fingers = world.fingers("hand").unwrap();
    let mut krc = Krc::new(
        KrcConfig {
            joints: JOINTS,
            ..KrcConfig::default()
        },
        Duration::ZERO,
    );
    krc.set_surroundings(Box::new(Mounted::new(
        base(),
        vec![world.hand("hand").unwrap()],
    )));
    let mut msr = [0; Msr::LEN];
    let mut run = |krc: &mut Krc, cycles: u32| {
        let mut force = 0.0;
        for _ in 0..cycles {
            let now = krc.poll_timeout();
            while krc.poll_transmit(now, &mut msr).is_some() {}
            let _stopped = fingers.post(now, 0.04, 80.0);
            force = f64::from(Msr::decode(&msr).unwrap().external_wrench[2]);
        }
        force
    };
    let weighed = run(&mut krc, 1000);
    let truth = world.truth();
    assert_eq!(truth.hand("hand").unwrap().holds.as_deref(), Some("block"));
    assert!((weighed + 1.5 * 9.81).abs() < 0.05, "{weighed}");
    krc.set_load(Load {
        mass_kg: 1.5,
        ..Load::default()
    });
    let stated = run(&mut krc, 10);
    assert!(stated.abs() < 0.05, "{stated}");
}

#[test]
fn iiwa_reports_world_over_wire() {
    let config = CabinetConfig {
        dialect: Dialect::V3,
        ..CabinetConfig::default()
    };
    let mut cabinet = Cabinet::new(config, Duration::ZERO);
    let mut at = base() * Isometry3::from(Vector3::from(cabinet.flange()));
    at.rotation = UnitQuaternion::identity();
    // The stiff arm stands 1 mm deep in the table.
    at.translation.z += 0.001;
    let world = World::builder()
        .surface(SurfaceConfig::table("table", at, [0.3, 0.3]))
        .probe("hand", Pose::identity())
        .build()
        .unwrap();
    let hands = vec![world.hand("hand").unwrap()];
    cabinet.set_surroundings(Box::new(Mounted::new(base(), hands)));
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let mut buf = [0; MESSAGE_MAX];
    for _ in 0..50 {
        let now = cabinet.poll_timeout();
        while let Some(len) = cabinet.poll_transmit(now, &mut buf) {
            let _reception = session.handle_datagram(&buf[..len], now).unwrap();
        }
    }
    let data = session.message().unwrap().monitor.unwrap();
    let force = data.external_force.unwrap()[2];
    assert!((force - 20.0).abs() < 0.1, "{force}");
    assert!(data.external_torque.unwrap()[1].abs() > 5.0);
}

/// The true pose of a Segway RMP, driven over CAN frames, carries what stands on it.
#[test]
fn rmp_true_pose_moves_bodies() {
    let world = takt_world::assembly(1).unwrap();
    world.turn_knobs(|knobs| knobs.docking_offset = [0.0; 3]);
    let before = world.truth().body("box_1").unwrap().pose;
    let mut powerbase = Powerbase::new(PowerbaseConfig::default());
    let mut driver = Base::new(DriverConfig::default(), 1.0, 2.0);
    let base = world.base("base").unwrap();
    let mut now = Duration::ZERO;
    for cycle in 0..5000 {
        now += Duration::from_millis(1);
        let wanted = match cycle {
            0..1000 => None,
            1000..3000 => Some([0.3, 0.0]),
            _ => Some([0.0; 2]),
        };
        if let Some(frame) = driver.poll_transmit(wanted, now) {
            powerbase.handle_frame(&frame, now);
        }
        while let Some((channel, frame)) = powerbase.poll_transmit(now) {
            driver.handle_frame(channel, &frame, now);
        }
        let truth = powerbase.truth();
        base.post(now, 2.0 + truth.x, truth.y, truth.heading);
    }
    let way = powerbase.truth().x;
    assert!(way > 0.5, "{way}");
    let after = world.truth().body("box_1").unwrap().pose;
    let moved = after.translation.x - before.translation.x;
    assert!((moved - way).abs() < 1e-3, "{moved} {way}");
    assert!(world.truth().body("box_1").unwrap().is_resting);
}

/// A gripper over a block, and its client.
struct Hold {
    gripper: Gripper,
    world: World,
    now: Duration,
    /// Of the hand, m, and how fast it rises, m/s.
    height: [f64; 2],
}

impl Hold {
    fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.now += Duration::from_millis(1);
            let hand = self.world.hand("hand").unwrap();
            let [height, speed] = &mut self.height;
            *height += *speed * 1e-3;
            let mut twist = takt_world::Twist::default();
            twist.linear.z = *speed;
            let pose = Pose::translation(0.0, 0.0, *height);
            let _wrench = hand.post(self.now, &pose, &twist);
            self.gripper.step(self.now);
        }
    }

    fn send(&mut self, packet: &Packet) {
        let mut bytes = [0; PACKET_MAX];
        let len = packet.encode(&mut bytes);
        self.gripper.handle_bytes(&bytes[..len], self.now);
    }
}

#[test]
fn wsg_fingers_stop_at_body_and_notice_loss() {
    let world = World::builder()
        .body(
            BodyConfig::new("block", 0.5, [0.03, 0.03, 0.05])
                .at(Pose::translation(0.0, 0.0, 0.025), Some("shelf"))
                .grip(Pose::identity(), 0.03),
        )
        .surface(SurfaceConfig::table("shelf", Pose::identity(), [0.1, 0.1]))
        .gripper(
            "hand",
            Pose::translation(0.0, 0.0, 0.025),
            GraspConfig::default(),
        );
    let world = world.build().unwrap();
    let cell = CellWorld {
        world: world.clone(),
        arms: Vec::new(),
        grippers: vec![("gripper".into(), "hand".into())],
        screwdrivers: Vec::new(),
        switches: Vec::new(),
        base: None,
        sensing: Sensing::default(),
    };
    let start = Duration::from_secs(1);
    let mut gripper = Gripper::new(GripperConfig::default(), start);
    gripper.set_surroundings(cell.pads("gripper").unwrap());
    let mut hold = Hold {
        gripper,
        world,
        now: start,
        height: [0.0; 2],
    };
    hold.run(10);
    hold.send(&Packet::new(Command::Homing).with(&[1]));
    hold.run(3000);
    assert!((hold.gripper.width() - 110.0).abs() < 0.1, "homed");
    let grasp = Packet::new(Command::Grasp);
    hold.send(&grasp.with_float(30.0).with_float(100.0));
    hold.run(3000);
    assert!(
        (hold.gripper.width() - 30.0).abs() < 1e-6,
        "{}",
        hold.gripper.width()
    );
    assert_eq!(hold.gripper.grasping(), 4, "holds");
    let truth = hold.world.truth();
    assert_eq!(truth.hand("hand").unwrap().holds.as_deref(), Some("block"));
    hold.height[1] = 0.05;
    hold.run(2000);
    hold.height[1] = 0.0;
    hold.run(100);
    assert_eq!(hold.gripper.grasping(), 4, "lifts it");
    let block = hold.world.truth().body("block").unwrap().pose;
    assert!((block.translation.z - 0.125).abs() < 1e-3, "{block}");
    // 40 N hold 0.5 kg, but not on oil.
    hold.world.turn_knobs(|knobs| knobs.grip_friction = 0.05);
    hold.run(1000);
    assert_eq!(hold.gripper.grasping(), 3, "part lost");
    assert!(hold.world.truth().hand("hand").unwrap().holds.is_none());
}
