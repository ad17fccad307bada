//! The time of a cycle in which a program executes 1,000 instructions, by kind of instruction, compared with a loop of additions that
//! are checked alike; of a cycle of a motion, and of the one in which it begins; and of compiling 10,000 lines. Judges no figure. `cargo bench
//! -p takt-irl --bench irl`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a benchmark that cannot go on ends")]

use std::fmt::Write as _;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use takt_irl::{Control, Machine, Phase, Program, System, compile};

const SPEC: &str = include_str!("../../../examples/irl/two.spc");
const PERIOD: Duration = Duration::from_millis(1);
/// Steps of a cycle.
const STEPS: u32 = 1_000;
const CYCLES: usize = 2_000;

fn machine(text: &str) -> Machine {
    let system = System::parse(SPEC).unwrap();
    let compiled = compile(text, &system, SPEC);
    let program = compiled
        .map_err(|rejection| rejection.render("bench", text))
        .unwrap()
        .program;
    let program = Program::decode(&program.encode()).unwrap();
    let mut machine = Machine::new(Arc::new(program), &[], PERIOD, STEPS).unwrap();
    let home = [0.0, 0.0, 90.0, 0.0, 60.0, 0.0_f64].map(f64::to_radians);
    machine.place(0, &home);
    machine
}

/// Median, 99th percentile and largest of these times, us.
fn summary(mut times: Vec<f64>) -> [f64; 3] {
    times.sort_by(f64::total_cmp);
    let at = |per_mille: usize| times[(times.len() - 1) * per_mille / 1_000];
    [at(500), at(990), at(1_000)]
}

/// Times of cycles while a program runs, us.
fn cycles(text: &str) -> Vec<f64> {
    let mut machine = machine(text);
    let cycle = |_| {
        let begin = Instant::now();
        let phase = black_box(machine.cycle(Control::default()));
        let time = begin.elapsed().as_secs_f64() * 1e6;
        (phase, time)
    };
    let all = (0..CYCLES).map(cycle);
    let running = all.take_while(|(phase, _)| *phase == Phase::Running);
    running.map(|(_, time)| time).collect()
}

/// A loop of checked additions, ns each.
fn straight() -> f64 {
    let mut sum = 0_i64;
    let begin = Instant::now();
    for i in 0..10_000_000_i64 {
        let next = black_box(sum).checked_add(black_box(i & 7));
        sum = next.filter(|sum| i32::try_from(*sum).is_ok()).unwrap_or(0);
    }
    black_box(sum);
    begin.elapsed().as_secs_f64() * 1e9 / 1e7
}

fn source(lines: usize) -> String {
    let mut text = "program large; var i, j: int; x: real; b: bool; begin\n".to_owned();
    for line in 0..lines.saturating_sub(2) {
        let statement = match line % 5 {
            0 => "i := (i + 3) * 2 mod 1000;",
            1 => "x := x * 0.5 + sin(x) - 1.25;",
            2 => "if i < j and not b then j := i; else b := true; endif;",
            3 => "for i := 1 to 3 do j := j + i; endfor;",
            _ => "move ptp mainjoint(1, 2, 80, 4, 5, 6) act_rob := \"tx90\" speed_ptp := 0.5;",
        };
        let _ = writeln!(text, "{statement}");
    }
    text.push_str("endprogram;\n");
    text
}

fn main() {
    let reference = straight();
    println!("checked addition in a loop: {reference:.2} ns");
    let head = "program b; var i, j: int; x: real; a: array[1..8] of real; p, q: pose; begin q := pose((1, 2, 3), orizyx(1, 2, 3)); p := q; while true do";
    for (name, body) in [
        ("additions", "i := i + 1; if i > 1000 then i := 0; endif;"),
        (
            "arrays and reals",
            "a[i + 1] := a[3] * 0.5 + 1.0; i := (i + 1) mod 8;",
        ),
        ("functions", "x := sin(x) + sqrt(2.0) + x * 0.1;"),
        ("poses", "p := p @ q;"),
    ] {
        let [median, p99, worst] = summary(cycles(&format!("{head} {body} endwhile; endprogram;")));
        println!(
            "{name}: {STEPS} steps in a cycle: median {median:.1} us, p99 {p99:.1} us, largest {worst:.1} us; {:.1} ns a step, ratio {:.1}",
            median * 1e3 / f64::from(STEPS),
            median * 1e3 / f64::from(STEPS) / reference
        );
    }
    for (name, attributes) in [("ptp", ""), ("lin", ""), ("rounded lin", "c_cp := 20")] {
        let kind = name.rsplit(' ').next().unwrap();
        let [to, back] = if kind == "ptp" {
            [
                "mainjoint(20, 0, 0, 0, 0, 0)",
                "mainjoint(-20, 0, 0, 0, 0, 0)",
            ]
        } else {
            ["(0, 60, 0)", "(0, -60, 0)"]
        };
        let text = format!(
            "program m; begin while true do move_inc {kind} {to} act_rob := \"tx90\" {attributes}; move_inc {kind} {back} act_rob := \
             \"tx90\" {attributes}; endwhile; endprogram;"
        );
        let [median, p99, worst] = summary(cycles(&text));
        println!(
            "{name}: a cycle of one arm: median {median:.1} us, p99 {p99:.1} us, largest {worst:.1} us"
        );
    }
    let system = System::parse(SPEC).unwrap();
    let text = source(10_000);
    let compiling = (0..15).map(|_| {
        let begin = Instant::now();
        let compiled = compile(black_box(&text), &system, SPEC).unwrap();
        black_box(compiled.program.encode());
        begin.elapsed().as_secs_f64() * 1e6
    });
    let [median, _, worst] = summary(compiling.collect());
    println!(
        "10,000 lines to object code: median {:.1} ms, largest {:.1} ms",
        median / 1e3,
        worst / 1e3
    );
}
