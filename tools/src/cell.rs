//! `takt cell`: frames of a cell file, taught by an arm. What they mean is checked by `takt-core`.

use std::path::PathBuf;

use anyhow::{Context as _, ensure};
use clap::{Args, Subcommand};
use takt_api::{Arm, Pose};
use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, value};

use crate::Verdict;
use crate::motion::hinted;
use crate::net::server::Server;
use crate::output::{check_writable, save, say};

/// What is done with the frames of a cell.
#[derive(Debug, Subcommand)]
pub(crate) enum Cell {
    Frame(Frame),
}

/// Print the `[[frame]]` table of where the flange or a tool of an arm is, or write it into a cell file.
///
/// Move the arm there first, by hand or by `takt move ARM jog`. Position (m) and rotation (degrees) are those measured; the joint
/// positions become the hint with which the arm reaches the frame.
///
/// Exit status: 0 done; 1 the arm moves, or its pose is not known; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt cell frame slot --from left
  takt cell frame slot --from left --tool pen --parent table --config cell.toml")]
pub(crate) struct Frame {
    /// Name of the frame, without a dot.
    name: String,
    /// The arm, as in cell.toml.
    #[arg(long, value_name = "ARM")]
    from: String,
    /// The tool whose tip shows the frame, as in `[[tool]]`; else the flange.
    #[arg(long, value_name = "NAME")]
    tool: Option<String>,
    /// The frame in which it is placed: a name of a `[[frame]]`, `world`, or DEVICE.base; else the base of the arm.
    #[arg(long, value_name = "FRAME")]
    parent: Option<String>,
    /// Write it into this cell file: a frame of that name is replaced, else it is added. Everything else remains as it is.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    server: Server,
}

/// Farthest that a joint of an arm at rest moves between two measurements, rad.
const REST: f64 = 1e-3;

/// What an arm taught.
#[derive(Debug)]
struct Taught {
    name: String,
    arm: String,
    parent: String,
    pose: Pose,
    /// rad.
    joints: Vec<f64>,
}

impl Cell {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let Self::Frame(frame) = self;
        frame.run()
    }
}

impl Frame {
    fn run(&self) -> anyhow::Result<Verdict> {
        // A name that no cell file takes is reported before anything else.
        let named = format!("[[frame]]\nname = {}\n", value(self.name.as_str()));
        takt_devices::parse_cell(&named)?;
        if let Some(path) = &self.config {
            check_writable(path)?;
        }
        let cell = self.server.cell()?;
        let arm = cell.arm(&self.from).map_err(hinted)?;
        let taught = self.teach(&cell, &arm)?;
        match &self.config {
            None => say(taught.written_into("")?.trim())?,
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .with_context(|| format!("cannot read {}", path.display()))?;
                let text = taught.written_into(&text)?;
                takt_devices::parse_cell(&text)
                    .with_context(|| format!("{} with this frame is no cell", path.display()))?;
                save(path, &text)?;
                say(&format!(
                    "{}: frame `{}`; the controller reads it again on SIGHUP (`systemctl reload takt`)",
                    path.display(),
                    self.name
                ))?;
            }
        }
        Ok(Verdict::Good)
    }

    fn teach(&self, cell: &takt_api::Cell, arm: &Arm) -> anyhow::Result<Taught> {
        let parent = arm.base_frame().name();
        let parent = self.parent.as_deref().unwrap_or(parent);
        let base = cell.frame(parent).map_err(hinted)?;
        let base = arm.base_frame().within(&base).map_err(hinted)?;
        let tip = match &self.tool {
            None => Pose::IDENTITY,
            Some(tool) => {
                let [tool, flange] =
                    [tool, "flange"].map(|part| cell.frame(&format!("{}.{part}", self.from)));
                let (tool, flange) = (tool.map_err(hinted)?, flange.map_err(hinted)?);
                tool.within(&flange).map_err(hinted)?
            }
        };
        let before = arm.positions().map_err(hinted)?;
        let pose = arm.pose().map_err(hinted)?;
        let joints = arm.positions().map_err(hinted)?;
        let moved = before
            .iter()
            .zip(&joints)
            .map(|(from, to)| (to - from).abs());
        ensure!(
            moved.fold(0.0, f64::max) < REST,
            crate::motion::Refused::new(&format!(
                "{} moves\nhint: a frame is taught at rest",
                self.from
            ))
        );
        Ok(Taught {
            name: self.name.clone(),
            arm: self.from.clone(),
            parent: parent.to_owned(),
            pose: base * pose * tip,
            joints,
        })
    }
}

/// Numbers with so many digits behind the point, and without the sign of zero.
fn numbers(all: impl IntoIterator<Item = f64>, digits: i32) -> Array {
    let scale = 10_f64.powi(digits);
    let rounded = |number: f64| (number * scale).round() / scale + 0.0;
    all.into_iter().map(rounded).collect()
}

impl Taught {
    /// The cell file with the frame.
    fn written_into(&self, text: &str) -> anyhow::Result<String> {
        let mut cell: DocumentMut = text.parse()?;
        let frames = cell.entry("frame");
        let frames = frames.or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
        let frames = frames.as_array_of_tables_mut().context(
            "`frame` of the cell file is no list of tables\nhint: write each frame as `[[frame]]`",
        )?;
        let is_named =
            |table: &Table| table.get("name").and_then(Item::as_str) == Some(self.name.as_str());
        if !frames.iter().any(is_named) {
            let mut table = Table::new();
            table.insert("name", value(self.name.as_str()));
            frames.push(table);
        }
        let table = frames.iter_mut().find(|table| is_named(table));
        let table = table.context("the frame was not added")?;
        self.write(table)?;
        Ok(cell.to_string())
    }

    fn write(&self, table: &mut Table) -> anyhow::Result<()> {
        let rotation = self.pose.isometry().rotation.euler_angles();
        let rotation = [rotation.2, rotation.1, rotation.0].map(f64::to_degrees);
        table["parent"] = value(self.parent.as_str());
        // 1 um, and as much at a distance of 0.6 m.
        table["position"] = value(numbers(self.pose.position(), 6));
        table["rotation"] = value(numbers(rotation, 4));
        let hint = numbers(self.joints.iter().map(|joint| joint.to_degrees()), 3);
        let hints = table.entry("hints").or_insert(value(InlineTable::new()));
        let hints = hints.as_table_like_mut();
        let hints = hints.context(
            "`hints` of the frame is no table\nhint: `{ left = [0, 30, 0, -70, 0, 80, 0] }`",
        )?;
        hints.insert(&self.arm, value(hint));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taught() -> Taught {
        Taught {
            name: "slot".to_owned(),
            arm: "left".to_owned(),
            parent: "left.base".to_owned(),
            pose: Pose::xyz(0.4, -0.05, 0.6).abc(std::f64::consts::FRAC_PI_2, 0.0, -0.0),
            joints: vec![0.0, std::f64::consts::FRAC_PI_6],
        }
    }

    const TABLE: &str = "[[frame]]
name = \"slot\"
parent = \"left.base\"
position = [0.4, -0.05, 0.6]
rotation = [90.0, 0.0, 0.0]
hints = { left = [0.0, 30.0] }
";

    const DEVICE: &str = "# The cell.
[[device]]
name = \"left\" # the arm
type = \"kuka_lwr_fri\"
";

    #[test]
    fn taught_frame_is_added_behind_what_is_there() {
        assert_eq!(taught().written_into("").unwrap().trim(), TABLE.trim());
        let whole = taught().written_into(DEVICE).unwrap();
        assert_eq!(whole, format!("{DEVICE}\n{TABLE}"));
        let cell = takt_devices::parse_cell(&whole).unwrap();
        let placed = cell.frames.frames[0].placement().frame();
        let wrong = placed.rotation.angle_to(&taught().pose.isometry().rotation);
        assert!(wrong < 1e-6, "{wrong}");
    }

    #[test]
    fn taught_frame_replaces_one_of_its_name() {
        let before = format!(
            "{DEVICE}\n[[frame]]\nname = \"slot\" # where parts are\nposition = [1, 2, 3]\nhints = {{ right = [1, 2] }}\n\n\
             [[frame]]\nname = \"other\"\nposition = [1, 2, 3]\n"
        );
        let whole = taught().written_into(&before).unwrap();
        let cell = takt_devices::parse_cell(&whole).unwrap();
        let [slot, other] = &cell.frames.frames[..] else {
            panic!("{whole}");
        };
        assert_eq!(
            slot.position.map(f64::to_bits),
            [0.4, -0.05, 0.6].map(f64::to_bits)
        );
        assert_eq!(slot.hints.keys().collect::<Vec<_>>(), ["left", "right"]);
        assert_eq!(other.parent, "world");
        assert!(whole.contains("# where parts are"), "{whole}");
        assert!(taught().written_into("frame = 1").is_err());
        assert!(taught().written_into("[[frame]\n").is_err());
    }
}
