//! `takt ecat graph`: the topology of a segment as a picture, with states and faults, for a report or a wall.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use plotters::prelude::{
    IntoDrawingArea as _, IntoFont as _, PathElement, RGBColor, Rectangle, SVGBackend, ShapeStyle,
    Text,
};
use serde_json::Value;
use takt_ethercat::AlState;

use super::controller::Remote;
use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target, scan};
use crate::Verdict;
use crate::output::{check_writable, save, say};

/// Draw the topology of a segment.
///
/// Brings all slaves to PRE-OP, or asks a running controller. Exit status: 0 all slaves are good; 1 one is not, and is drawn red;
/// 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat graph enp2s0 --svg line.svg
  takt ecat graph enp2s0 --svg line.svg --controller localhost:8080")]
pub(crate) struct Graph {
    #[command(flatten)]
    target: Target,
    #[command(flatten)]
    remote: Remote,
    /// Where to write the picture.
    #[arg(long, value_name = "FILE")]
    svg: PathBuf,
}

impl Graph {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        check_writable(&self.svg)?;
        let (title, boxes) = if self.remote.is_given() {
            let report = self.remote.report(Some(&self.target.interface))?;
            let name = report["segment"].as_str().unwrap_or_default().to_owned();
            (name, of_report(&report))
        } else {
            let session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
            (session.interface().to_owned(), of_session(&session))
        };
        save(&self.svg, draw(&title, &boxes)?)?;
        say(&format!(
            "{} slaves drawn in {}",
            boxes.len(),
            self.svg.display()
        ))?;
        let is_good = boxes.iter().all(|it| it.is_good);
        Ok(if is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// A slave to draw.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SlaveBox {
    position: usize,
    name: String,
    detail: String,
    is_good: bool,
    /// Position and port of the slave before it; `None` for the master.
    parent: Option<(usize, usize)>,
}

pub(super) fn of_session<W: Wire>(session: &Session<W>) -> Vec<SlaveBox> {
    let master = session.master();
    let slaves = (0..master.len()).filter_map(|number| master.slave(number));
    let mut boxes: Vec<SlaveBox> = slaves
        .filter_map(|slave| {
            let position = usize::from(slave.position()?);
            Some(SlaveBox {
                position,
                name: scan::title(slave).to_owned(),
                detail: format!("{:04X}h  {}", slave.station(), scan::state(slave)),
                is_good: slave.is_running() && slave.fault().is_none(),
                parent: master.topology().parent(position),
            })
        })
        .collect();
    boxes.sort_by_key(|it| it.position);
    boxes
}

fn of_report(report: &Value) -> Vec<SlaveBox> {
    let number = |value: &Value| usize::try_from(value.as_u64()?).ok();
    let slaves = report["slaves"].as_array().map_or(&[][..], Vec::as_slice);
    let mut boxes: Vec<SlaveBox> = slaves
        .iter()
        .filter_map(|slave| {
            let parent = &slave["parent"];
            Some(SlaveBox {
                position: number(&slave["position"])?,
                name: slave["spec"].as_str().unwrap_or_default().to_owned(),
                detail: format!("{}  {}", slave["name"].as_str()?, slave["state"].as_str()?),
                is_good: slave["running"] == true,
                parent: number(&parent["position"]).zip(number(&parent["port"])),
            })
        })
        .collect();
    boxes.sort_by_key(|it| it.position);
    boxes
}

/// Sizes, pixels.
const BOX: (i32, i32) = (168, 54);
const STEP: (i32, i32) = (208, 84);
const MARGIN: i32 = 20;
const TITLE: i32 = 34;

const INK: RGBColor = RGBColor(23, 32, 42);
const DIM: RGBColor = RGBColor(100, 112, 125);
const GOOD: RGBColor = RGBColor(20, 128, 74);
const BAD: RGBColor = RGBColor(179, 38, 30);

/// Column and row of each slave: a branch gets a row of its own, a line continues its row.
fn places(boxes: &[SlaveBox]) -> Vec<(i32, i32)> {
    let mut places: Vec<(i32, i32)> = Vec::new();
    let mut rows = 0;
    for (at, slave) in boxes.iter().enumerate() {
        let parent = slave.parent.and_then(|(parent, _)| {
            let before = boxes.get(..at)?;
            before.iter().position(|it| it.position == parent)
        });
        let above = parent.and_then(|parent| places.get(parent).copied());
        let place = above.map_or((0, rows), |(column, row)| {
            let is_taken = places.iter().any(|(c, r)| *c > column && *r == row);
            (column + 1, if is_taken { rows } else { row })
        });
        rows = rows.max(place.1 + 1);
        places.push(place);
    }
    places
}

/// The picture.
pub(super) fn draw(title: &str, boxes: &[SlaveBox]) -> anyhow::Result<String> {
    let places = places(boxes);
    let most = |of: fn(&(i32, i32)) -> i32| places.iter().map(of).max().unwrap_or(0) + 1;
    let (columns, rows) = (most(|place| place.0), most(|place| place.1));
    let size = (
        2 * MARGIN + columns * STEP.0,
        TITLE + 2 * MARGIN + rows * STEP.1,
    );
    let size = (size.0.unsigned_abs().max(320), size.1.unsigned_abs());
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let broken = |error: &dyn std::fmt::Display| anyhow!("cannot draw: {error}");
        let font =
            |pixels: i32, colour: &RGBColor| ("sans-serif", pixels).into_font().color(colour);
        let corner =
            |(column, row): (i32, i32)| (MARGIN + column * STEP.0, TITLE + MARGIN + row * STEP.1);
        let text = format!("{title}: {} slaves", boxes.len());
        area.draw(&Text::new(text, (MARGIN, 14), font(18, &INK)))
            .map_err(|e| broken(&e))?;
        for (slave, place) in boxes.iter().zip(&places) {
            let (x, y) = corner(*place);
            let parent = slave.parent.and_then(|(parent, port)| {
                let at = boxes.iter().position(|it| it.position == parent)?;
                Some((*places.get(at)?, port))
            });
            if let Some((above, port)) = parent {
                let (from_x, from_y) = corner(above);
                let (begin, middle) = ((from_x + BOX.0, from_y + BOX.1 / 2), from_x + BOX.0 + 12);
                let cable = vec![
                    begin,
                    (middle, begin.1),
                    (middle, y + BOX.1 / 2),
                    (x, y + BOX.1 / 2),
                ];
                area.draw(&PathElement::new(
                    cable,
                    ShapeStyle::from(&DIM).stroke_width(2),
                ))
                .map_err(|e| broken(&e))?;
                let label = Text::new(
                    port.to_string(),
                    (x - 14, y + BOX.1 / 2 - 14),
                    font(11, &DIM),
                );
                area.draw(&label).map_err(|e| broken(&e))?;
            }
            let colour = if slave.is_good { GOOD } else { BAD };
            let frame = Rectangle::new(
                [(x, y), (x + BOX.0, y + BOX.1)],
                ShapeStyle::from(&colour).stroke_width(2),
            );
            area.draw(&frame).map_err(|e| broken(&e))?;
            let short = |text: &str, most: usize| text.chars().take(most).collect::<String>();
            let head = short(&format!("{} {}", slave.position, slave.name), 24);
            area.draw(&Text::new(head, (x + 8, y + 10), font(13, &INK)))
                .map_err(|e| broken(&e))?;
            let detail = short(&slave.detail, 28);
            area.draw(&Text::new(detail, (x + 8, y + 31), font(11, &colour)))
                .map_err(|e| broken(&e))?;
        }
        area.present().map_err(|e| broken(&e))?;
    }
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ecat::tests::{tree, up};

    #[test]
    fn graph_draws_branches_states_and_ports() {
        let session = up(tree(), AlState::PreOp);
        let boxes = of_session(&session);
        assert_eq!(places(&boxes), [(0, 0), (1, 0), (1, 1)]);
        let svg = draw("line", &boxes).unwrap();
        for part in [
            "line: 3 slaves",
            "1 TK4021 servo",
            "1002h  PRE-OP",
            "#14804A",
            "</svg>",
        ] {
            assert!(svg.contains(part), "{part}\n{svg}");
        }
        assert!(!svg.contains("#B3261E"), "{svg}");
        let empty = draw("line", &[]).unwrap();
        assert!(empty.contains("0 slaves"), "{empty}");
    }

    #[test]
    fn graph_of_controller_report_shows_faults_red() {
        let report = serde_json::json!({ "slaves": [
            { "position": 0, "spec": "coupler", "name": "EK1100", "state": "OP", "running": true, "parent": null },
            { "position": null, "spec": "lost", "name": "", "state": "INIT", "running": false },
            { "position": 1, "spec": "drive", "name": "AKD", "state": "SAFE-OP + error", "running": false,
              "parent": { "position": 0, "port": 1 } },
        ]});
        let boxes = of_report(&report);
        assert_eq!(boxes.len(), 2);
        let svg = draw("cell", &boxes).unwrap();
        assert!(svg.contains("#B3261E") && svg.contains("1 drive"), "{svg}");
    }
}
