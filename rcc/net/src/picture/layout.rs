//! Where the primitives of a net stand in a picture and how its links run: in columns, sources on the left, each
//! primitive right of all that feed it. Links pass between boxes, never behind them: where one skips a column it has a
//! lane there, and where one leads back it runs below all boxes.

use std::collections::{BTreeMap, BTreeSet};

use super::graph::{Graph, Link, Port, Primitive};

/// Width of a box and of the space between two columns, pixels.
const BOX_WIDTH: i32 = 190;
const GUTTER: i32 = 70;
/// Height of the name and type of a box, and of a line with ports.
pub(super) const HEAD: i32 = 32;
pub(super) const LINE: i32 = 13;
/// Space between two boxes of a column, and height of a lane.
const GAP: i32 = 10;
const LANE: i32 = 10;
const MARGIN: i32 = 12;

/// A box: left upper corner and size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Rect {
    pub(super) x: i32,
    pub(super) y: i32,
    pub(super) width: i32,
    pub(super) height: i32,
}

/// A point, pixels from the left upper corner.
pub(super) type Point = (i32, i32);

/// A picture of a net.
#[derive(Debug)]
pub(super) struct Layout {
    /// Boxes, in the order of the graph's nodes.
    pub(super) boxes: Vec<Rect>,
    /// By link, the points through which it runs. Between the first and the second it crosses a gutter, then a column,
    /// and so on.
    pub(super) routes: Vec<Vec<Point>>,
    pub(super) size: Point,
}

/// What has a place in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Item {
    Node(usize),
    /// Links that begin at one out port, on their way to columns further right.
    Lane(Port),
}

/// By column and item, its upper end.
type Columns = Vec<BTreeMap<Item, i32>>;

impl Layout {
    pub(super) fn of(graph: &Graph) -> Self {
        let levels = graph.levels();
        let columns = columns(graph, &levels);
        let boxes: Vec<_> = (0..graph.nodes.len())
            .map(|node| Rect {
                x: column_x(levels[node]),
                y: columns[levels[node]][&Item::Node(node)],
                width: BOX_WIDTH,
                height: height(&graph.nodes[node]),
            })
            .collect();
        let bottom = boxes.iter().map(|b| b.y + b.height);
        let lanes = columns.iter().flat_map(BTreeMap::values);
        let bottom = bottom.chain(lanes.map(|y| y + LANE)).max().unwrap_or(0);
        let (mut routes, mut back) = (Vec::new(), 0);
        for link in &graph.links {
            let (start, end) = ends(&boxes, link);
            let (from, to) = (levels[link.from.0], levels[link.to.0]);
            let route = if from < to {
                let lanes = (from + 1..to).flat_map(|column| {
                    let y = columns[column][&Item::Lane(link.from)] + LANE / 2;
                    [(column_x(column), y), (column_x(column) + BOX_WIDTH, y)]
                });
                [start].into_iter().chain(lanes).chain([end]).collect()
            } else {
                back += 1;
                let y = bottom + back * LANE;
                vec![
                    start,
                    (start.0 + GUTTER / 2, y),
                    (end.0 - GUTTER / 2, y),
                    end,
                ]
            };
            routes.push(route);
        }
        let right = columns.len().checked_sub(1).map_or(0, column_x) + BOX_WIDTH;
        // Links that lead back into the last column turn right of it.
        let turn = if back > 0 { GUTTER / 2 } else { 0 };
        Self {
            boxes,
            routes,
            size: (right + turn + MARGIN, bottom + (back + 1) * LANE + MARGIN),
        }
    }
}

/// The left side of a column. The first one has a gutter at its left, for links that lead back to it.
fn column_x(column: usize) -> i32 {
    let column = i32::try_from(column).unwrap_or(i32::MAX / 1000);
    MARGIN + GUTTER / 2 + column * (BOX_WIDTH + GUTTER)
}

fn height(node: &Primitive) -> i32 {
    let lines = node.ins.len().max(node.outs.len());
    HEAD + LINE * i32::try_from(lines).unwrap_or(0)
}

/// The middle of a line of ports, from the upper end of its box.
pub(super) fn port_y(port: usize) -> i32 {
    HEAD + LINE * i32::try_from(port).unwrap_or(0) + LINE / 2 - 2
}

/// Where a link begins and ends: at the sides of its boxes, at the heights of its ports.
fn ends(boxes: &[Rect], link: &Link) -> (Point, Point) {
    let (from, to) = (boxes[link.from.0], boxes[link.to.0]);
    (
        (from.x + from.width, from.y + port_y(link.from.1)),
        (to.x, to.y + port_y(link.to.1)),
    )
}

/// Stacks what stands in each column. What has its sources higher stands higher.
fn columns(graph: &Graph, levels: &[usize]) -> Columns {
    let count = levels.iter().max().map_or(0, |last| last + 1);
    let mut columns: Columns = vec![BTreeMap::new(); count];
    for column in 0..count {
        let nodes = (0..levels.len()).filter(|node| levels[*node] == column);
        let mut items: Vec<_> = nodes
            .map(|node| (mean_y(graph, node, levels, &columns), Item::Node(node)))
            .collect();
        let passing = graph
            .links
            .iter()
            .filter(|link| levels[link.from.0] < column && column < levels[link.to.0]);
        let lanes: BTreeSet<Port> = passing.map(|link| link.from).collect();
        items.extend(lanes.into_iter().map(|from| {
            let y = source_y(from, column, levels, &columns);
            (y, Item::Lane(from))
        }));
        items.sort_unstable();
        let mut y = MARGIN;
        for (_, item) in items {
            columns[column].insert(item, y);
            y += GAP
                + match item {
                    Item::Node(node) => height(&graph.nodes[node]),
                    Item::Lane(_) => LANE,
                };
        }
    }
    columns
}

/// Where what begins at a port arrives in a column.
fn source_y(port: Port, column: usize, levels: &[usize], columns: &Columns) -> i32 {
    if levels[port.0] + 1 == column {
        columns[column - 1][&Item::Node(port.0)] + port_y(port.1)
    } else {
        columns[column - 1][&Item::Lane(port)]
    }
}

/// Mean height of a primitive's sources; those that are not left of it have none yet.
fn mean_y(graph: &Graph, node: usize, levels: &[usize], columns: &Columns) -> i32 {
    let sources = graph.links.iter().filter(|link| link.to.0 == node);
    let placed = sources.filter(|link| levels[link.from.0] < levels[node]);
    // The place of a lane that ends here is where its link comes from.
    let heights: Vec<_> = placed
        .map(|link| source_y(link.from, levels[node], levels, columns))
        .collect();
    heights.iter().sum::<i32>() / i32::try_from(heights.len()).unwrap_or(1).max(1)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use crate::limits::Limits;
    use crate::text::parse;

    use super::super::curve;
    use super::*;

    fn layout(text: &str) -> (Graph, Layout) {
        let mut faults = Vec::new();
        let graph = Graph::of(&parse(text, &Limits::default(), &mut faults));
        assert_eq!(faults, []);
        let layout = Layout::of(&graph);
        (graph, layout)
    }

    /// All nets of the tests and examples.
    fn nets() -> Vec<String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut folders = vec![root.join("tests/nets"), root.join("examples")];
        let mut nets = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|e| e == "net") {
                    nets.push(fs::read_to_string(path).unwrap());
                }
            }
        }
        nets
    }

    /// Points of a cubic Bezier curve `M x y C … `, in steps of a fiftieth.
    fn points(curve: &str) -> Vec<(f64, f64)> {
        let numbers: Vec<f64> = curve
            .split(['M', 'C', 'L', ' '])
            .filter_map(|number| number.parse().ok())
            .collect();
        let point = |i: usize| (numbers[2 * i], numbers[2 * i + 1]);
        let mut points = Vec::new();
        let mut at = 0;
        for command in curve.matches(['C', 'L']) {
            let last = if command == "C" { at + 3 } else { at + 1 };
            for step in 0..=50 {
                let t = f64::from(step) / 50.0;
                let mix = |a: f64, b: f64, c: f64, d: f64| {
                    let u = 1.0 - t;
                    u * u * u * a + 3.0 * u * u * t * b + 3.0 * u * t * t * c + t * t * t * d
                };
                let (a, d) = (point(at), point(last));
                let (b, c) = if command == "C" {
                    (point(at + 1), point(at + 2))
                } else {
                    (a, d)
                };
                points.push((mix(a.0, b.0, c.0, d.0), mix(a.1, b.1, c.1, d.1)));
            }
            at = last;
        }
        points
    }

    #[test]
    fn links_never_run_behind_boxes() {
        let back = "{a=X(inV=c.outV), b=X(inV=a.outV), c=XPre(inV=b.outV), d=X(inV=a.outV, inW=b.outV), outTerminate=d.outV}";
        let nets = nets();
        assert!(nets.len() > 5);
        for text in nets.iter().map(String::as_str).chain([back]) {
            let (graph, layout) = layout(text);
            assert_eq!(layout.routes.len(), graph.links.len());
            for route in &layout.routes {
                for (x, y) in points(&curve(route)) {
                    let is_inside = |b: &Rect| {
                        let (left, top) = (f64::from(b.x), f64::from(b.y));
                        let (width, height) = (f64::from(b.width), f64::from(b.height));
                        left + 0.5 < x && x < left + width - 0.5 && top < y && y < top + height
                    };
                    assert!(!layout.boxes.iter().any(is_inside), "{x} {y}: {text}");
                    let (width, height) = layout.size;
                    assert!(
                        x >= 0.0 && x < f64::from(width) && y < f64::from(height),
                        "{x} {y}"
                    );
                }
            }
        }
    }

    #[test]
    fn boxes_do_not_overlap() {
        for text in nets() {
            let (_, layout) = layout(&text);
            for (number, one) in layout.boxes.iter().enumerate() {
                let overlaps = |other: &Rect| {
                    one.x == other.x
                        && one.y < other.y + other.height
                        && other.y < one.y + one.height
                };
                assert!(!layout.boxes[..number].iter().any(overlaps), "{text}");
            }
        }
    }
}
