//! The axes of a segment as a commented robot arm. Its figures are left open, as a guessed gear ratio or range would move a
//! robot wrongly.

use std::fmt::Write as _;

use takt_core::device::ARM_JOINTS_MAX;

const HEAD: &str = "
# The axes as robot arms. Remove the first `#` of each line and replace each `?`: slaves do not report these figures. Objects 608Fh
# (encoder resolution) and 6091h (gear ratio) of a drive help, by `takt ecat sdo`; docs/cell.md lists all keys of a joint.
";

/// Writes commented arms with the axes of the slaves, by name and number of axes.
pub(super) fn write(out: &mut String, slaves: &[(String, usize)]) {
    let axes = slaves
        .iter()
        .flat_map(|(slave, axes)| (0..*axes).map(move |axis| (slave, axis)));
    let axes: Vec<_> = axes.collect();
    for (number, joints) in axes.chunks(ARM_JOINTS_MAX).enumerate() {
        if number == 0 {
            out.push_str(HEAD);
        }
        let name = match number {
            0 => "arm".to_owned(),
            _ => format!("arm_{}", number + 1),
        };
        let _ = writeln!(out, "#[[ethercat.arm]]\n#name = '{name}'");
        for (slave, axis) in joints {
            let _ = write!(
                out,
                "#[[ethercat.arm.joint]]\n\
                 #slave = '{slave}'\n\
                 #axis = {axis}\n\
                 #increments_per_turn = ? # of the drive per turn of the joint, including gear; negative: opposite direction\n\
                 #zero = ? # increments at joint zero\n\
                 #range = [?, ?] # degrees\n\
                 #velocity_max = ? # degrees per second\n\
                 #acceleration_max = ? # degrees per second squared\n"
            );
        }
    }
}
