//! Controllers inside of a program, with emulated robots, and the examples, which use them.

#![allow(
    clippy::duplicate_mod,
    reason = "every example is a program with its own module for pictures"
)]

#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/figures.rs"]
mod figures;
#[path = "../examples/first.rs"]
mod first;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/follow.rs"]
mod follow;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/jog.rs"]
mod jog;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/lift.rs"]
mod lift;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/listing1.rs"]
mod listing1;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/press.rs"]
mod press;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/recovery.rs"]
mod recovery;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/stream.rs"]
mod stream;
#[allow(dead_code, reason = "tests call what `main` calls")]
#[path = "../examples/youbot.rs"]
mod youbot;

use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use takt_api::{Cell, ErrorKind, Outcome, together};
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.6, 0.0, -1.1, 0.0, 0.7, 0.0];

#[test]
fn first_example_moves_an_arm() {
    steady(|| first::main().unwrap());
}

/// Each motion begins in the state that the net before it commanded. From the state that the driver has reached with its
/// set-points, one and a half periods earlier, such motions ran away.
#[test]
fn motions_replaced_30_times_a_second_stay_near_goal() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let left = cell.arm("left").unwrap();
        left.ptp(BENT).speed(0.5).run().unwrap();
        let start = Instant::now();
        let mut handles = Vec::new();
        while start.elapsed() < Duration::from_secs(4) {
            let turn = start.elapsed().as_secs_f64() * 0.3 * std::f64::consts::TAU;
            let mut goal = BENT;
            goal[0] = 0.3 * turn.sin();
            handles.push(left.ptp(goal).speed(0.5).now().begin().unwrap());
            let position = left.commanded().unwrap()[0];
            assert!(position.abs() < 0.6, "{position} rad, at most 0.3 wanted");
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(handles.len() > 10, "{} motions", handles.len());
        cell.close().unwrap();
    });
}

/// Runs an example with a directory of its own, and checks that it draws a picture of two curves.
fn with_picture<T>(
    name: &str,
    example: impl Fn(&Path) -> Result<T, Box<dyn std::error::Error>>,
) -> T {
    let directory = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
    let run = || {
        std::fs::create_dir_all(&directory)?;
        let result = example(&directory)?;
        let svg = std::fs::read_to_string(directory.join(format!("{name}.svg")))?;
        std::fs::remove_dir_all(&directory)?;
        Ok::<_, Box<dyn std::error::Error>>((result, svg))
    };
    let (result, svg) = run().expect("the example runs and draws");
    assert_eq!(svg.matches("<polyline").count(), 2, "{svg}");
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    result
}

#[test]
fn listing_1_example_rounds_corners_by_blending() {
    steady(|| {
        let [blended, stopping] = with_picture("listing1", listing1::run);
        let (last, others) = blended.outcomes.split_last().unwrap();
        assert_eq!(*last, Outcome::Completed);
        assert_eq!(others, [const { Outcome::TakenOver }; 11]);
        assert_eq!(stopping.outcomes, [const { Outcome::Completed }; 12]);
        let misses = blended.misses.iter().zip(&stopping.misses);
        for (round, sharp) in misses.take(others.len()) {
            // A stop at a corner misses it by rounding, a blend by nearly 1 mm or more.
            assert!(*round > 7e-4 && *sharp < 5e-4, "{round} m, {sharp} m");
        }
    });
}

#[test]
fn lift_example_keeps_the_grasp() {
    steady(|| {
        let steps = with_picture("lift", lift::run);
        assert_eq!(steps.len(), 4);
        for step in &steps {
            assert_eq!(step.outcome, Outcome::Completed);
            // Measured positions may rest 10 µm from the set-points that the path begins with.
            assert!(step.planned < 2e-5, "{} m", step.planned);
            assert!(step.rested < 1e-4, "{} m", step.rested);
        }
    });
}

#[test]
fn recovery_example_goes_on_after_errors() {
    steady(|| {
        let attempts = recovery::run().unwrap();
        let errors: Vec<_> = attempts.iter().map(|attempt| &attempt.error.kind).collect();
        assert!(
            matches!(
                errors[..],
                [
                    ErrorKind::Invalid(_),
                    ErrorKind::Limit { .. },
                    ErrorKind::Unreachable { .. } | ErrorKind::TooFast { .. },
                    ErrorKind::Unreachable { .. },
                    ErrorKind::Invalid(_),
                ]
            ),
            "{errors:?}"
        );
        for (number, attempt) in attempts.iter().enumerate() {
            assert_eq!(attempt.recovered, Outcome::Completed);
            let has_moved = attempt.moved > 1e-3;
            assert_eq!(has_moved, number == 3, "only the unchecked motion begins");
        }
    });
}

#[test]
fn stream_example_follows_goals_closely() {
    steady(|| {
        let (turns, outcome) = with_picture("stream", stream::run);
        assert_eq!(outcome, Outcome::Cancelled);
        for turn in &turns {
            assert!(turn.mean < 0.02 && turn.most < 0.05, "{} m", turn.most);
        }
    });
}

#[test]
fn press_example_holds_force_until_table_vanishes() {
    steady(|| {
        let steps = with_picture("press", press::run);
        let outcomes: Vec<_> = steps.iter().map(|step| &step.outcome).collect();
        let stopped = Outcome::Stopped("vanished".to_owned());
        let (completed, holds) = (Outcome::Completed, Outcome::Maintaining);
        assert_eq!(outcomes, [&completed, &holds, &holds, &stopped, &completed]);
        for step in &steps[1..3] {
            assert!((step.force - 20.0).abs() < 3.0, "{} N", step.force);
        }
        let fell = steps[2].height - steps[3].height;
        assert!(steps[3].force.abs() < 0.1 && fell < 5e-3, "{fell} m");
    });
}

#[test]
fn follow_example_keeps_to_its_frame() {
    steady(|| {
        let (steps, outcome) = with_picture("follow", follow::run);
        assert_eq!(outcome, Outcome::Completed);
        for step in &steps {
            assert_eq!(step.outcome, Outcome::Completed);
            assert!(step.most < 0.03 && step.last < 1e-3, "{} m", step.most);
        }
    });
}

#[test]
fn jog_example_rests_after_each_key() {
    steady(|| {
        let (keys, outcome) = jog::run().unwrap();
        assert_eq!(outcome, Outcome::Cancelled);
        let [up, left, turn] = &keys[..] else {
            panic!("{} keys", keys.len());
        };
        assert!(up.moved[2] > 0.04 && left.moved[1] > 0.04);
        assert!(turn.moved.iter().all(|part| part.abs() < 2e-3));
        assert!(keys.iter().all(|key| key.speed_after < 1e-6));
    });
}

#[test]
fn youbot_example_grips_and_comes_home() {
    steady(|| {
        let steps = youbot::run().unwrap();
        assert!(steps.iter().all(|step| step.outcome == Outcome::Completed));
        let [there, gripped, .., home] = &steps[..] else {
            panic!("{} steps", steps.len());
        };
        assert!((there.at[0] - 0.3).abs() < 0.02 && (there.at[1] - 0.1).abs() < 0.02);
        assert!(gripped.width < 0.01 && home.width > 0.02);
        assert!(home.at.iter().all(|part| part.abs() < 0.02));
    });
}

#[test]
fn figures_example_measures_in_one_run() {
    steady(|| figures::run(2).unwrap());
}

#[test]
fn emulated_cells_run_side_by_side() {
    steady(|| {
        let cells = [
            Cell::emulated("two_lwr").unwrap(),
            Cell::emulated("iiwa").unwrap(),
            Cell::emulated("lwr_wsg").unwrap(),
        ];
        let names = cells.each_ref().map(|cell| {
            let arms = cell.arms().unwrap();
            let names: Vec<_> = arms
                .iter()
                .map(|arm| arm.description().name.clone())
                .collect();
            names.join(" ")
        });
        assert_eq!(names, ["left right", "arm", "arm"]);
        for cell in &cells {
            let arm = cell.arms().unwrap().remove(0);
            assert_eq!(arm.ptp(BENT).run(), Ok(Outcome::Completed));
        }
    });
}

#[test]
fn emulated_factory_has_arms_of_all_makes() {
    steady(|| {
        let cell = Cell::emulated("factory").unwrap();
        let arms = cell.arms().unwrap();
        let names: Vec<_> = arms.iter().map(|arm| &arm.description().name).collect();
        assert_eq!(names, ["arm", "left", "right", "tx90"]);
        let tx90 = cell.arm("tx90").unwrap();
        assert_eq!(tx90.ptp([0.2; 6]).run(), Ok(Outcome::Completed));
    });
}

#[test]
fn emulated_cell_unknown_name_lists_known_ones() {
    let error = Cell::emulated("three_lwr").unwrap_err();
    assert!(matches!(error.kind, ErrorKind::Invalid(_)), "{error}");
    let text = error.to_string();
    assert!(
        text.contains("lwr_wsg, lwr_table, assembly, assembly_unloaded, lola"),
        "{text}"
    );
}

#[test]
fn real_time_factor_out_of_range_is_invalid() {
    for factor in [0.0, 0.09, 10.1, -1.0, f64::NAN, f64::INFINITY] {
        let error = takt_api::simulate_time(factor).unwrap_err();
        assert!(matches!(error.kind, ErrorKind::Invalid(_)), "{error}");
        assert!(error.to_string().contains("0.1 to 10 times"), "{error}");
    }
}

#[test]
fn slow_motion_stops_within_whole_limits() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let left = cell.arm("left").unwrap();
        left.ptp(BENT).run().unwrap();
        let mut far = BENT;
        far[0] = 2.0;
        let handle = left.ptp(far).speed(0.1).begin().unwrap();
        let at = |index: usize| left.commanded().unwrap()[index];
        while at(0) < BENT[0] + 0.3 && handle.outcome().is_none() {}
        assert!(handle.outcome().is_none(), "{:?}", handle.outcome());
        let before = at(0);
        handle.cancel();
        handle.wait_to_end().unwrap();
        // Within limits that are slowed as it is, it would go on as far as from full speed.
        let way = at(0) - before;
        assert!(way < 0.04, "{way} rad");
        cell.close().unwrap();
    });
}

#[test]
fn emulated_cell_dropped_ends_its_controller() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let address = cell.embedded_address().unwrap();
        let left = cell.arm("left").unwrap();
        let mut far = BENT;
        far[0] = 2.0;
        let handle = left.ptp(far).speed(0.2).begin().unwrap();
        drop(cell);
        assert!(TcpStream::connect(address).is_ok(), "the arm keeps it");
        drop((left, handle));
        let until = Instant::now() + Duration::from_secs(20);
        while TcpStream::connect(address).is_ok() {
            assert!(Instant::now() < until, "it still listens");
            std::thread::sleep(Duration::from_millis(10));
        }
    });
}

#[test]
fn embedded_cell_file_admits_this_program_only() {
    let path = std::env::temp_dir().join(format!("takt-embedded-{}.toml", std::process::id()));
    let device = "[[device]]\nname = \"left\"\ntype = \"kuka_lwr_fri\"\nlisten = \"127.0.0.1:0\"\n";
    std::fs::write(&path, device).unwrap();
    let cell = Cell::embedded(&path);
    std::fs::remove_file(&path).unwrap();
    let cell = cell.unwrap();
    assert_eq!(cell.arms().unwrap().len(), 1);
    let address = cell.embedded_address().unwrap().to_string();
    let error = Cell::connect(&address).unwrap_err();
    assert!(error.to_string().contains("token"), "{error}");
    let simulated = takt_api::simulate_time(1.0).unwrap_err();
    assert!(
        matches!(simulated.kind, ErrorKind::Invalid(_)),
        "{simulated}"
    );
    let missing = Cell::embedded(&path).unwrap_err();
    assert!(matches!(missing.kind, ErrorKind::Invalid(_)), "{missing}");
    assert!(missing.to_string().contains("No such file"), "{missing}");
}

#[test]
fn error_of_a_call_names_the_line_of_its_caller() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let left = cell.arm("left").unwrap();
        let wrong = || left.ptp([0.0; 3]);
        let line = line!();
        let errors = [
            wrong().begin().map(drop).unwrap_err(),
            wrong().queue().map(drop).unwrap_err(),
            wrong().run().map(drop).unwrap_err(),
            wrong().plan().map(drop).unwrap_err(),
            wrong().explain().map(drop).unwrap_err(),
            together([wrong()]).run().map(drop).unwrap_err(),
            cell.arm("middle").map(drop).unwrap_err(),
            cell.set_override(2.0).unwrap_err(),
            cell.holds(&left.input(4000)).map(drop).unwrap_err(),
        ];
        for (error, line) in errors.iter().zip(line + 2..) {
            assert_eq!((error.place.file(), error.place.line()), (file!(), line));
            let place = format!(" (at {}:{line})", file!());
            assert!(error.to_string().contains(&place), "{error}");
        }
        assert!(
            errors[6].to_string().ends_with("left, right"),
            "the hint is last"
        );
    });
}

#[test]
fn error_of_a_motion_names_the_line_that_began_it() {
    steady(|| {
        let cell = Cell::emulated("two_lwr").unwrap();
        let left = cell.arm("left").unwrap();
        assert_eq!(left.ptp(BENT).run(), Ok(Outcome::Completed));
        let [x, y, z] = left.pose().unwrap().position();
        let far = left.lin(takt_api::Pose::xyz(x + 1.0, y, z)).unchecked();
        let (handle, line) = (far.begin().unwrap(), line!());
        let error = handle.wait().unwrap_err();
        assert_eq!((error.place.file(), error.place.line()), (file!(), line));
        assert_eq!(handle.place(), error.place);
    });
}
