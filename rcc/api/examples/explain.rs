//! Prints the nets of some motions of the arm `left`, separated by empty lines. Programs in other languages compare theirs.
//!
//! ```console
//! $ cargo run -p takt-api --example explain -- 127.0.0.1:8081
//! ```

use std::error::Error;
use std::io::Write as _;
use std::time::Duration;

use takt_api::{Cell, Pose, deg};

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
    let activities = [
        left.ptp(goal),
        left.ptp(goal).speed(0.3).blend(0.8),
        left.lin(pose).speed(0.1).until("touch", touch),
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
    ];
    let mut out = std::io::stdout();
    for activity in activities {
        writeln!(out, "{}\n", activity.explain()?)?;
    }
    Ok(())
}
