//! Pictures of curves as SVG, for plans and for programs that show what their robots did. Not here: colours of a theme, and
//! pictures that move.

use std::fmt::Write as _;

/// Width of a picture, px.
const WIDTH: f64 = 900.0;
/// Height of a chart whose axes have scales of their own, px.
const HEIGHT: f64 = 280.0;
/// Largest height of a chart whose axes have one scale, px.
const HEIGHT_MAX: f64 = 1200.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 46.0;
const BOTTOM: f64 = 40.0;
/// Ticks of an axis, about.
const TICKS: f64 = 7.0;
/// Most ticks of an axis.
const TICKS_MAX: u8 = 14;
/// Colours that are distinguishable with colour blindness.
const COLOURS: [&str; 7] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000",
];

/// Curves over two axes.
#[derive(Clone, Debug)]
pub struct Chart {
    title: String,
    units: [String; 2],
    is_to_scale: bool,
    curves: Vec<(String, Vec<[f64; 2]>)>,
}

impl Chart {
    /// A chart with the quantities of its axes, such as `time, s`.
    pub fn new(title: &str, horizontal: &str, vertical: &str) -> Self {
        Self {
            title: title.to_owned(),
            units: [horizontal, vertical].map(str::to_owned),
            is_to_scale: false,
            curves: Vec::new(),
        }
    }

    /// The same with one scale for both axes, such as for paths in a plane.
    #[must_use]
    pub const fn to_scale(mut self) -> Self {
        self.is_to_scale = true;
        self
    }

    /// The same with one more curve through points. Points that are not finite are left out.
    #[must_use]
    pub fn curve(mut self, name: &str, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let points = points.into_iter();
        let finite = points.filter(|point| point.iter().all(|value| value.is_finite()));
        self.curves.push((name.to_owned(), finite.collect()));
        self
    }

    /// The picture, as the text of an SVG file. A chart without points has axes only.
    pub fn svg(&self) -> String {
        stacked(std::slice::from_ref(self))
    }

    fn range(&self, axis: usize) -> [f64; 2] {
        let points = self.curves.iter().flat_map(|(_, points)| points);
        let values = || points.clone().filter_map(|point| point.get(axis).copied());
        let min = values().fold(f64::INFINITY, f64::min);
        let max = values().fold(f64::NEG_INFINITY, f64::max);
        if min > max {
            return [0.0, 1.0];
        }
        let margin = ((max - min) * 0.04).max(1e-6 * max.abs().max(1.0));
        [min - margin, max + margin]
    }

    fn scales(&self) -> Scales {
        let [x, y] = [self.range(0), self.range(1)];
        let width = WIDTH - LEFT - RIGHT;
        let height = if self.is_to_scale {
            ((y[1] - y[0]) * width / (x[1] - x[0])).clamp(80.0, HEIGHT_MAX)
        } else {
            HEIGHT - TOP - BOTTOM
        };
        let [mut per_x, mut per_y] = [width / (x[1] - x[0]), height / (y[1] - y[0])];
        if self.is_to_scale {
            per_x = per_x.min(per_y);
            per_y = per_x;
        }
        Scales {
            x,
            y,
            per_x,
            per_y,
            width,
            height,
        }
    }

    /// Writes it below what is `above`, px; returns its height.
    fn write(&self, svg: &mut String, above: f64) -> f64 {
        let scales = self.scales();
        let (right, bottom) = (LEFT + scales.width, above + TOP + scales.height);
        let middle = above + TOP + scales.height / 2.0;
        let mut line = |text: std::fmt::Arguments<'_>| {
            // Writing to a String does not fail.
            let _ = writeln!(svg, "{text}");
        };
        let title = escaped(&self.title);
        line(format_args!(
            r#"<text x="{LEFT}" y="{:.0}" font-size="14">{title}</text>"#,
            above + 18.0
        ));
        for (tick, text) in ticks(scales.x) {
            let x = scales.at_x(tick);
            line(format_args!(
                r##"<path d="M{x:.1} {:.1}V{bottom:.1}" stroke="#ddd"/>"##,
                above + TOP
            ));
            line(format_args!(
                r#"<text x="{x:.1}" y="{:.1}" text-anchor="middle">{text}</text>"#,
                bottom + 15.0
            ));
        }
        for (tick, text) in ticks(scales.y) {
            let y = bottom - scales.up(tick);
            line(format_args!(
                r##"<path d="M{LEFT} {y:.1}H{right:.1}" stroke="#ddd"/>"##
            ));
            line(format_args!(
                r#"<text x="{:.1}" y="{:.1}" text-anchor="end">{text}</text>"#,
                LEFT - 5.0,
                y + 4.0
            ));
        }
        let [horizontal, vertical] = self.units.each_ref().map(|unit| escaped(unit));
        line(format_args!(
            r#"<text x="{right:.1}" y="{:.1}" text-anchor="end">{horizontal}</text>"#,
            bottom + 31.0
        ));
        line(format_args!(
            r#"<text x="14" y="{middle:.1}" text-anchor="middle" transform="rotate(-90 14 {middle:.1})">{vertical}</text>"#
        ));
        let mut legend = LEFT;
        for ((name, points), colour) in self.curves.iter().zip(COLOURS.iter().cycle()) {
            let at =
                |[x, y]: &[f64; 2]| format!("{:.1},{:.1}", scales.at_x(*x), bottom - scales.up(*y));
            let points: Vec<_> = points.iter().map(at).collect();
            let points = points.join(" ");
            line(format_args!(
                r#"<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>"#
            ));
            line(format_args!(
                r#"<text x="{legend:.0}" y="{:.0}" fill="{colour}">{}</text>"#,
                above + 36.0,
                escaped(name)
            ));
            legend += 7.0 * name.chars().count() as f64 + 20.0;
        }
        TOP + scales.height + BOTTOM
    }
}

/// Charts below each other in one picture, as the text of an SVG file.
pub fn stacked(charts: &[Chart]) -> String {
    let mut body = String::new();
    let height = charts
        .iter()
        .fold(0.0, |above, chart| above + chart.write(&mut body, above));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n{body}</svg>\n"
    )
}

/// What the axes show, and how many px a unit has.
struct Scales {
    x: [f64; 2],
    y: [f64; 2],
    per_x: f64,
    per_y: f64,
    width: f64,
    height: f64,
}

impl Scales {
    fn at_x(&self, value: f64) -> f64 {
        LEFT + (value - self.x[0]) * self.per_x
    }

    fn up(&self, value: f64) -> f64 {
        (value - self.y[0]) * self.per_y
    }
}

/// Round values within a range, with their texts.
fn ticks([min, max]: [f64; 2]) -> Vec<(f64, String)> {
    let rough = (max - min) / TICKS;
    let power = 10_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|factor| factor * power >= rough);
    let step = factor.unwrap_or(10.0) * power;
    // Digits after the point by which neighbours differ.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "of 0 to 9"
    )]
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (min / step).ceil();
    (0..TICKS_MAX)
        .map(|number| (first + f64::from(number)) * step)
        .take_while(|value| *value <= max)
        // Not -0.
        .map(|value| (value, format!("{:.digits$}", value + 0.0)))
        .collect()
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chart_has_a_line_per_curve_and_round_ticks() {
        let chart = Chart::new("a < b", "time, s", "deg")
            .curve("one", [[0.0, -1.0], [2.0, 1.0], [f64::NAN, 0.0]])
            .curve("two", [[0.0, 0.0]]);
        let svg = chart.svg();
        assert_eq!(svg.matches("<polyline").count(), 2, "{svg}");
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"), "{svg}");
        for tick in [">0.0<", ">1.5<", ">-0.5<"] {
            assert!(svg.contains(tick), "{tick} is missing in {svg}");
        }
    }

    #[test]
    fn chart_to_scale_has_equal_units() {
        let square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]];
        let scales = Chart::new("", "x, m", "y, m")
            .to_scale()
            .curve("square", square)
            .scales();
        assert!((scales.per_x - scales.per_y).abs() < 1e-9);
    }

    #[test]
    fn chart_without_points_or_extent_is_finite() {
        for points in [vec![], vec![[3.0, 3.0]], vec![[0.0, 1e300], [1.0, 1e300]]] {
            let svg = Chart::new("", "", "").curve("c", points).svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}
