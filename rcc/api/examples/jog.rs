//! Jogging with a dead man: the arm moves while a key is held, and brakes when it is released. A key that is held sends its
//! velocity 50 times a second. Nothing else stops the arm: it brakes as well if the program sleeps, hangs or dies.
//! `cargo run -p takt-api --features embedded --example jog`

#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::thread::sleep;
use std::time::{Duration, Instant};

use takt_api::{Arm, Cell, Error, Outcome, Pose, Twist};

/// How long each key is held.
const HELD: Duration = Duration::from_millis(800);
/// How often a key sends its velocity.
const EVERY: Duration = Duration::from_millis(20);

/// What a key did.
pub(crate) struct Key {
    /// How far the flange moved in the base until it was at rest, m.
    pub(crate) moved: [f64; 3],
    /// Speed of the fastest joint half a second after the release, rad/s.
    pub(crate) speed_after: f64,
}

fn main() -> Result<(), Error> {
    run().map(drop)
}

/// Holds three keys one after the other, and prints the table.
pub(crate) fn run() -> Result<(Vec<Key>, Outcome), Error> {
    let cell = Cell::emulated("two_lwr")?;
    let robot = cell.arm("left")?;
    robot.ptp([0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0]).run()?;
    let velocities = [
        ("up", Twist::xyz(0.0, 0.0, 0.1)),
        ("left", Twist::xyz(0.0, 0.1, 0.0)),
        ("turn", Twist::default().turning(0.0, 0.0, 0.3)),
    ];
    let jog = robot.jog().begin()?;
    let mut keys = Vec::new();
    println!("key    x / mm  y / mm  z / mm  turned / rad  speed 0.5 s after / rad/s");
    for (name, velocity) in velocities {
        let (start, pressed) = (robot.pose()?, Instant::now());
        while pressed.elapsed() < HELD {
            jog.send(velocity)?;
            sleep(EVERY);
        }
        sleep(Duration::from_millis(500)); // released
        let speed_after = speed(&robot)?;
        let end = robot.pose()?;
        let moved = [0, 1, 2].map(|axis: usize| part(&end, axis) - part(&start, axis));
        let turned = (start.inverse() * end).isometry().rotation.angle();
        let key = Key { moved, speed_after };
        let ([x, y, z], after) = (key.moved.map(|part| part * 1e3), key.speed_after);
        println!("{name:5}  {x:6.1}  {y:6.1}  {z:6.1}  {turned:12.3}  {after:26.4}");
        keys.push(key);
    }
    jog.cancel();
    let outcome = jog.wait()?;
    println!("the jog ended: {outcome:?}");
    Ok((keys, outcome))
}

fn part(pose: &Pose, axis: usize) -> f64 {
    pose.position().get(axis).copied().unwrap_or(f64::NAN)
}

/// Speed of the fastest joint, rad/s, over a tenth of a second.
fn speed(robot: &Arm) -> Result<f64, Error> {
    let time = Duration::from_millis(100);
    let before = robot.commanded()?;
    sleep(time);
    let after = robot.commanded()?;
    let pairs = before.iter().zip(&after);
    let most = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    Ok(most / time.as_secs_f64())
}
