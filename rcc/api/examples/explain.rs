//! Prints the nets of all kinds of activities, separated by empty lines. Programs in other languages compare theirs.
//!
//! ```console
//! $ cargo run -p takt-api --example explain -- 127.0.0.1:8081
//! ```

use std::error::Error;
use std::io::Write as _;
use std::time::Duration;

use takt_api::{
    Activity, Arm, CartesianLimits, Cell, Condition, Control, Direction, Explanation, ForceLimits,
    MovingFrame, Pose, coupled, deg,
};

fn main() -> Result<(), Box<dyn Error>> {
    let address = std::env::args().nth(1).ok_or("no address is given")?;
    let cell = Cell::connect(&address)?;
    let left = cell.arm("left")?;
    let goal = [0.1, deg(30.0), 0.0, deg(-70.0), 1e-7, deg(45.0), 1.0 / 3.0];
    let pose = Pose::xyz(0.4, 0.1, 0.5).abc(0.1, -0.2, 3.0);
    let via = Pose::quaternion([0.5, 0.0, 0.6], [0.0, 0.0, 1.0, 2.0]);
    let force = left.force();
    let touch = (force.z().abs() * 2.0 - 1.0).over(5.0);
    let bent = left.joint(3).under(0.5).lasting(Duration::from_millis(20));
    let pushed = !(touch.clone() & bent.clone()) | left.input(2);
    let mean = left.joint(1).average(Duration::from_millis(30)).under(0.1);
    let angle = left.joint(2);
    let waves = (angle.clone().sin() + angle.clone().cos() - angle.clone().tan()).over(0.1)
        | (angle.clone().asin() * angle.clone().acos()).under(angle.sqrt());
    let waves = waves.clone().rises() | waves.falls();
    let motions = [
        left.ptp(goal),
        left.ptp(goal).speed(0.3).blend(0.8),
        left.lin(pose).speed(0.1).until("touch", touch.clone()),
        left.clone()
            .with_speed(0.7)
            .circ(via, pose * via)
            .until("bent", bent)
            .until("pushed", pushed),
        left.ptp_near(pose, goal),
        left.clone()
            .with_tool(Pose::xyz(0.0, 0.01, 0.1))
            .spline([via, pose])
            .until("mean", mean),
        left.hold().until("waves", waves),
        left.ptp_to(pose).now(),
    ];
    let texts = motions.iter().map(Activity::explain);
    let texts = texts.chain(live(&left, touch)).chain(coupled_arms(&cell)?);
    let texts = texts.chain(devices(&cell)?).chain(guided(&cell)?);
    let mut out = std::io::stdout();
    for text in texts {
        writeln!(out, "{}\n", text?.net)?;
    }
    Ok(())
}

/// The net of an activity.
type Text = Result<Explanation, takt_api::Error>;

/// Activities that follow what a program sends.
fn live(left: &Arm, touch: Condition) -> [Text; 4] {
    let slow = CartesianLimits {
        velocity: 0.1,
        rot_jerk: 20.0,
        ..CartesianLimits::default()
    };
    let tool = Pose::xyz(0.0, 0.0, 0.1);
    [
        left.clone()
            .with_limits(slow)
            .with_tool(tool)
            .jog()
            .explain(),
        left.jog_joints().speed(0.3).until("touch", touch).explain(),
        left.stream().speed(0.5).now().explain(),
        left.clone().with_tool(tool).stream_poses().explain(),
    ]
}

/// Motions of an object that both arms hold.
fn coupled_arms(cell: &Cell) -> Result<[Text; 3], takt_api::Error> {
    let arms = [
        cell.arm("left")?.with_base(Pose::xyz(0.0, 0.3, 0.0)),
        cell.arm("right")?.with_base(Pose::xyz(0.0, -0.3, 0.0)),
    ];
    let object = Pose::xyz(0.5, 0.0, 0.5);
    let held = coupled(object, &arms)?.with_speed(0.5);
    let (via, to) = (Pose::xyz(0.5, 0.1, 0.6), Pose::xyz(0.5, 0.0, 0.7));
    Ok([
        held.lin(to).explain(),
        held.circ(via, to).explain(),
        held.spline([via, to]).speed(0.4).explain(),
    ])
}

/// Outputs, grippers and a mobile base.
fn devices(cell: &Cell) -> Result<Vec<Text>, takt_api::Error> {
    let (plant, hand) = (cell.io("plant")?, cell.gripper("hand")?);
    let (gripper, platform) = (cell.gripper("gripper")?, cell.base("platform")?);
    let full = gripper.force()?.over(10.0) & !gripper.holds()?;
    let open = gripper.width().over(0.04) & plant.input(1)? | plant.output(2)?;
    let level = (plant.analogue_input(0)? - plant.analogue_output(1)?).under(0.5);
    let turned = platform.wheel(3).over(1.0);
    let quarter = Duration::from_millis(250);
    let activities = [
        plant.set(3, true),
        plant.pulse(0, false, quarter),
        plant.set_analogue(1, -2.5).until("level", level),
        hand.open(),
        hand.move_to(0.02).until("open", hand.width().over(0.01)),
        hand.clone().with_timeout(quarter).close(),
        gripper.open(),
        gripper.clone().with_speed(0.5).close().until("open", open),
        gripper.grasp(0.05, 30.0).until("full", full),
        platform.go_to(Pose::xyz(0.3, -0.2, 0.0).abc(0.5, 0.0, 0.0)),
        platform
            .clone()
            .with_speed(0.5)
            .drive([0.2, 0.0, -0.1], quarter)
            .speed(0.5)
            .until("turned", turned)
            .now(),
    ];
    Ok(activities.iter().map(Activity::explain).collect())
}

/// Motions under force, frames that move and control modes.
fn guided(cell: &Cell) -> Result<Vec<Text>, takt_api::Error> {
    let (left, right) = (cell.arm("left")?, cell.arm("right")?);
    let limits = ForceLimits {
        travel: 0.05,
        damping: 1000.0,
        ..ForceLimits::default()
    };
    let force = || left.force().z();
    let gone = force().under(2.0).after(force().over(10.0));
    let world = cell.frame("world")?;
    let down = world.direction([0.0, 1.0, -2.0]);
    let pose = Pose::xyz(0.4, 0.1, 0.5).abc(0.1, -0.2, 3.0);
    let firm = left.clone().with_force_limits(limits);
    let here = left.clone().with_base(Pose::xyz(0.0, 0.3, 0.0));
    let there = right.clone().with_base(Pose::xyz(0.0, -0.3, 0.1));
    let numbers = MovingFrame::of(
        [right.joint(0), right.joint(1) * 0.5, 0.25.into()],
        [0.0.into(), right.joint(2), 0.5.into()],
    );
    let activities = [
        left.press([0.0, 0.0, -1.0], 20.0),
        firm.press(Direction::of_centre([0.0, 0.0, 0.5]), 10.0)
            .until("gone", gone)
            .speed(0.5),
        here.press_to(pose, down, 15.0),
        here.follow(&there.centre().pose(pose)),
        here.follow(&numbers.in_(&world)),
        left.switch_to(Control::position()),
        left.switch_to(Control::joints([300.0; 7], [0.7; 7])),
        left.switch_to(Control::cartesian(
            [2000.0, 1000.0, 500.0, 200.0, 100.0, 50.0],
            [0.7; 6],
        )),
    ];
    Ok(activities.iter().map(Activity::explain).collect())
}
