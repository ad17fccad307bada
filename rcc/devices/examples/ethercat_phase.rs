//! Draws how the driver's cycle reaches and keeps its phase to SYNC0 of an emulated segment, in virtual time: the
//! reference clock drifts by 50 ppm, each direction of a frame is delayed by up to some ten microseconds.
//!
//! ```console
//! $ cargo run -p takt-devices --example ethercat_phase > docs/ethercat-phase.svg
//! ```
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example: it prints, and ends where something is wrong"
)]

#[path = "../tests/common/phase.rs"]
mod phase;

use std::fmt::Write as _;
use std::time::Duration;

use phase::{Point, rms_ns, run};

const SECONDS: f64 = 5.0;
const LEFT: f64 = 72.0;
const WIDTH: f64 = 864.0;
/// Middle of the plot, pixels, and pixels for a microsecond.
const ZERO: f64 = 250.0;
const SCALE: f64 = 3.2;
/// The drawn range, us.
const RANGE: f64 = 50.0;

fn x(at: Duration) -> f64 {
    LEFT + WIDTH * at.as_secs_f64() / SECONDS
}

#[expect(clippy::cast_precision_loss, reason = "below a period")]
fn y(ns: i64) -> f64 {
    ZERO - SCALE * (ns as f64 / 1e3).clamp(-RANGE, RANGE)
}

fn axes(svg: &mut String) {
    for us in [-40, -20, 0, 20, 40] {
        let at = y(us * 1000);
        let color = if us == 0 { "#888" } else { "#e4e4e4" };
        let end = LEFT + WIDTH;
        writeln!(
            svg,
            "<path d=\"M{LEFT} {at:.1}H{end}\" stroke=\"{color}\"/>"
        )
        .unwrap();
        let (left, base) = (LEFT - 8.0, at + 4.0);
        writeln!(
            svg,
            "<text x=\"{left}\" y=\"{base:.1}\" font-size=\"11\" text-anchor=\"end\">{us} us</text>"
        )
        .unwrap();
    }
    let (top, bottom) = (ZERO - SCALE * RANGE, ZERO + SCALE * RANGE);
    for second in 0..=5 {
        let at = x(Duration::from_secs(second));
        let base = bottom + 16.0;
        writeln!(
            svg,
            "<path d=\"M{at:.1} {top}V{bottom}\" stroke=\"#e4e4e4\"/>"
        )
        .unwrap();
        writeln!(
            svg,
            "<text x=\"{at:.1}\" y=\"{base}\" font-size=\"11\" text-anchor=\"middle\">{second} s</text>"
        )
        .unwrap();
    }
}

fn dots(svg: &mut String, points: &[Point]) {
    svg.push_str("<path d=\"");
    for point in points.iter().step_by(3) {
        write!(svg, "M{:.1} {:.1}h2", x(point.at), y(point.frame_ns)).unwrap();
    }
    svg.push_str("\" stroke=\"#8fb4d0\" stroke-width=\"2\"/>\n");
}

fn line(svg: &mut String, points: &[Point]) {
    svg.push_str("<path d=\"");
    for (number, point) in points.iter().enumerate() {
        let step = if number == 0 { 'M' } else { 'L' };
        write!(svg, "{step}{:.1} {:.1}", x(point.at), y(point.cycle_ns)).unwrap();
    }
    svg.push_str("\" stroke=\"#c03a2b\" stroke-width=\"1.4\" fill=\"none\"/>\n");
}

fn main() {
    let points = run(
        &[50_000, -50_000, 0],
        10e3,
        Duration::from_secs_f64(SECONDS),
    );
    let rms = rms_ns(&points, Duration::from_secs(2)) / 1e3;
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"960\" height=\"450\" viewBox=\"0 0 960 450\" \
         font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"960\" height=\"450\" fill=\"#fff\"/>\n\
         <text x=\"72\" y=\"28\" font-size=\"17\" font-weight=\"bold\">Phase of the cycle to SYNC0, 1 ms, \
         wanted 500 us behind it</text>\n",
    );
    writeln!(
        svg,
        "<text x=\"72\" y=\"48\" font-size=\"11\" fill=\"#555\">emulated segment in virtual time; the reference clock \
         gains 50 ppm, each way of a frame is delayed by |N(0, 10 us)|</text>"
    )
    .unwrap();
    writeln!(
        svg,
        "<text x=\"72\" y=\"66\" font-size=\"11\"><tspan fill=\"#c03a2b\">when cycles are to begin: {rms:.2} us rms \
         after 2 s</tspan> \u{b7} <tspan fill=\"#5b8db3\">when their frames pass the reference clock: late by the \
         host's wake-up and the way</tspan></text>"
    )
    .unwrap();
    axes(&mut svg);
    dots(&mut svg, &points);
    line(&mut svg, &points);
    let (left, base) = (LEFT, ZERO + SCALE * RANGE + 36.0);
    let first = points.first().map_or(0.0, |point| point.at.as_secs_f64());
    writeln!(
        svg,
        "<text x=\"{left}\" y=\"{base}\" font-size=\"11\" fill=\"#555\">time since power-on; the segment is scanned and \
         the reference clock set until {first:.2} s; beyond 50 us points lie on the edge</text>\n</svg>"
    )
    .unwrap();
    print!("{svg}");
}
