//! Controllers inside of a program, with emulated robots, and the examples, which use them.

#[path = "../examples/first.rs"]
mod first;

use std::net::TcpStream;
use std::time::{Duration, Instant};

use takt_api::{Cell, Error, Outcome};
use takt_tests::steady;

const BENT: [f64; 7] = [0.0, 0.6, 0.0, -1.1, 0.0, 0.7, 0.0];

#[test]
fn first_example_moves_an_arm() {
    steady(|| first::main().unwrap());
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
    assert!(matches!(error, Error::Invalid(_)), "{error}");
    let text = error.to_string();
    assert!(text.contains("two_lwr, iiwa, factory, lwr_wsg"), "{text}");
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
    let missing = Cell::embedded(&path).unwrap_err();
    assert!(matches!(missing, Error::Invalid(_)), "{missing}");
    assert!(missing.to_string().contains("No such file"), "{missing}");
}
