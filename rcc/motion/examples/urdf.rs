//! Reads an arm from a URDF and answers for each line of joint positions, velocities and accelerations on its input:
//! flange (position and quaternion), Jacobian and torques, as one line of JSON.
//!
//! `echo "0 0 0 0 0 0  0 0 0 0 0 0  0 0 0 0 0 0" | cargo run -p takt-motion --example urdf -- rcc/motion/tests/arms/tx90.urdf`

use std::error::Error;
use std::io::{BufRead, Write, stdin, stdout};

use nalgebra::Vector3;
use serde_json::json;
use takt_motion::dynamics::GRAVITY;
use takt_motion::urdf::Urdf;
use takt_net::Twist;
use takt_net::device::Kinematics;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let file = arguments.first().ok_or("usage: urdf FILE [BASE TIP]")?;
    let link = |number: usize| arguments.get(number).map(String::as_str);
    let model = Urdf::parse(&std::fs::read_to_string(file)?)?.arm(link(1), link(2))?;
    let names: Vec<_> = model.joints.iter().map(|joint| &joint.name).collect();
    let structure = model.serial.structure().to_string();
    let mut out = stdout().lock();
    writeln!(
        out,
        "{}",
        json!({ "base": model.base, "tip": model.tip, "joints": names, "structure": structure })
    )?;
    let count = names.len();
    for line in stdin().lock().lines() {
        let line = line?;
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        let numbers = numbers?;
        let [positions, velocities, accelerations] = [0, 1, 2].map(|part| {
            let all = numbers.chunks_exact(count);
            all.clone().nth(part).unwrap_or_default()
        });
        let flange = model.serial.forward(positions);
        let mut columns = vec![Twist::default(); count];
        model.serial.jacobian(positions, &mut columns);
        let columns: Vec<_> = columns
            .iter()
            .map(|it| [it.vel.as_slice(), it.rot.as_slice()].concat())
            .collect();
        let motions = positions.iter().zip(velocities).zip(accelerations);
        let motions: Vec<_> = motions.map(|((at, by), rate)| [*at, *by, *rate]).collect();
        let torques = model.dynamics.as_ref().map(|arm| {
            let mut torques = vec![0.0; count];
            arm.torques(&motions, &Vector3::new(0.0, 0.0, -GRAVITY), &mut torques);
            torques
        });
        let rotation = flange.rotation.coords;
        writeln!(
            out,
            "{}",
            json!({
                "position": flange.translation.vector.as_slice(), "quaternion": rotation.as_slice(),
                "jacobian": columns, "torques": torques,
            })
        )?;
    }
    Ok(())
}
