//! Chains of motions that end at random instants in every way that an end can come: cancelled, aborted, by a fault of
//! the device, by the death of the program, by a cut connection. Whatever happens, every handle ends, nothing stays
//! loaded, and the arm comes to rest within its limits and can be used again.

#![expect(
    clippy::unwrap_used,
    clippy::print_stderr,
    reason = "tests and their helpers fail by panicking, with the seed"
)]

mod robotics;

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use robotics::Bench;
use robotics::watched::{self, Watched};
use takt_api::{Arm, Cell, Handle, Outcome};
use takt_core::NetId;
use takt_core::device::DeviceStatus;
use takt_link::Random;
use takt_tests::steady;

/// Arms that move at the same time, each for a program of its own.
const ARMS: usize = 8;
/// How often the chain of each of them ends: 200 instants together.
const ROUNDS: usize = 25;
/// Of the random numbers of the first arm; each other arm has the next one.
const SEED: u64 = 20_261_123;
/// The chain takes about this long.
const CHAIN_MS: usize = 900;
/// Nothing takes this long on a host that works.
const LONG: Duration = Duration::from_secs(20);
/// Address and arm of a program that is to be killed.
const PROGRAM: &str = "TAKT_TEST_PROGRAM";
/// Differences of double-precision positions over a millisecond are that inexact.
const WITHIN: f64 = 1.0 + 1e-4;

/// Ways in which a chain ends.
const WAYS: [fn(&Bench, &Watched, &str, &mut Random); 5] =
    [cancelled, aborted, failed, killed, cut];

#[test]
fn chain_ended_at_200_random_instants_rests_within_limits() {
    steady(|| {
        let (cell, arms) = watched::cell(ARMS);
        let bench = Bench::of(&cell);
        std::thread::scope(|scope| {
            for (number, watched) in arms.iter().enumerate() {
                let bench = &bench;
                scope.spawn(move || rounds(bench, watched, number));
            }
        });
        assert_eq!(bench.nets(), 0);
    });
}

fn rounds(bench: &Bench, watched: &Watched, number: usize) {
    let (arm, seed) = (format!("arm{number}"), SEED + number as u64);
    let mut random = Random::new(seed);
    for round in 0..ROUNDS {
        let way = (round + number) % WAYS.len();
        let place = format!("{arm}, seed {seed}, round {round}, way {way}");
        let failed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            WAYS[way](bench, watched, &arm, &mut random);
            at_rest(bench, watched, &arm);
        }));
        if let Err(panic) = failed {
            eprintln!("{place}: failed");
            std::panic::resume_unwind(panic);
        }
    }
}

/// Nothing stays loaded, the arm rests within its limits, and another program can move it.
fn at_rest(bench: &Bench, watched: &Watched, arm: &str) {
    until("its nets are unloaded", || nets_of(bench, arm).is_empty());
    until("it rests", || watched.is_resting());
    let cycles = watched.cycles();
    until("it receives more", || watched.cycles() > cycles + 5);
    assert!(watched.is_resting(), "it moved again");
    let [velocity, acceleration] = watched.shares();
    assert!(velocity <= WITHIN, "{velocity} of its velocity limit");
    assert!(
        acceleration <= WITHIN,
        "{acceleration} of its acceleration limit"
    );
    let cell = bench.cell();
    let home = cell.arm(arm).unwrap().ptp([0.0; 7]).run();
    assert_eq!(home, Ok(Outcome::Completed));
}

/// Six motions of all joints that blend into each other.
fn chain(arm: &Arm) -> Vec<Handle> {
    let goal = |sign: f64| [0.08, 0.06, -0.05, 0.04, 0.08, -0.08, 0.02].map(|by| sign * by);
    let goals = [1.0, -0.5, 1.0, 0.0, 1.0, -1.0];
    let begin = |sign| arm.ptp(goal(sign)).blend(0.5).queue().unwrap();
    goals.map(begin).into()
}

/// A program with its chain in progress.
fn program(address: &str, arm: &str, random: &mut Random) -> (Cell, Arm, Vec<Handle>) {
    let cell = Cell::connect(address).unwrap();
    let arm = cell.arm(arm).unwrap();
    let chain = chain(&arm);
    instant(random);
    (cell, arm, chain)
}

fn instant(random: &mut Random) {
    std::thread::sleep(Duration::from_millis(random.below(CHAIN_MS) as u64));
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < LONG, "not within {LONG:?}: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The outcomes of a chain.
fn ended(chain: &[Handle]) -> Vec<Result<Outcome, takt_api::Error>> {
    let ended = chain.iter().map(|handle| handle.wait_for(LONG));
    ended.map(|outcome| outcome.unwrap()).collect()
}

/// The nets that command an arm.
fn nets_of(bench: &Bench, arm: &str) -> Vec<NetId> {
    let name = format!("'{arm}'");
    let nets = bench.controller.nets().into_iter();
    let is_mine = |net: &NetId| {
        let info = bench.controller.net(*net);
        info.is_some_and(|info| info.text.contains(&name))
    };
    nets.filter(is_mine).collect()
}

fn cancelled(bench: &Bench, _: &Watched, arm: &str, random: &mut Random) {
    let (_cell, arm, chain) = program(&bench.address, arm, random);
    let number = random.below(2 * chain.len());
    match chain.get(number) {
        Some(one) => one.cancel(),
        None => arm.cancel(),
    }
    for outcome in ended(&chain) {
        assert!(outcome.is_ok(), "{outcome:?}");
    }
}

fn aborted(bench: &Bench, _: &Watched, arm: &str, random: &mut Random) {
    let (_cell, _arm, chain) = program(&bench.address, arm, random);
    let nets = nets_of(bench, arm);
    nets.into_iter()
        .for_each(|net| drop(bench.controller.abort(net)));
    ended(&chain);
}

fn failed(bench: &Bench, watched: &Watched, arm: &str, random: &mut Random) {
    let (_cell, _arm, chain) = program(&bench.address, arm, random);
    let was_done = chain.last().is_some_and(|last| last.outcome().is_some());
    watched.set_faulty(true);
    let outcomes = ended(&chain);
    watched.set_faulty(false);
    let has_failed = outcomes.iter().any(Result::is_err);
    assert!(was_done || has_failed, "{outcomes:?}");
    until("it follows commands again", || {
        let mut devices = bench.controller.devices().into_iter();
        devices.any(|device| device.name == arm && device.status == DeviceStatus::Operational)
    });
}

/// Kills the process of the program.
fn killed(bench: &Bench, _: &Watched, arm: &str, random: &mut Random) {
    let mut program = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "program_moves_until_killed", "--ignored"])
        .env(PROGRAM, format!("{} {arm}", bench.address))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    until("the program moves the arm", || {
        !nets_of(bench, arm).is_empty()
    });
    instant(random);
    program.kill().unwrap();
    program.wait().unwrap();
}

#[test]
#[ignore = "the program that another test kills"]
fn program_moves_until_killed() {
    let Ok(task) = std::env::var(PROGRAM) else {
        return;
    };
    let (address, arm) = task.split_once(' ').unwrap();
    let cell = Cell::connect(address).unwrap();
    let _chain = chain(&cell.arm(arm).unwrap());
    // If it is not killed, it ends all the same.
    std::thread::sleep(LONG);
}

/// Cuts the connection between program and controller.
fn cut(bench: &Bench, _: &Watched, arm: &str, random: &mut Random) {
    let wire = Wire::to(&bench.address);
    let (cell, held, chain) = program(&wire.address, arm, random);
    wire.cut();
    let outcomes = ended(&chain);
    drop((chain, held, cell));
    let whole = |outcome: &Result<Outcome, _>| {
        matches!(outcome, Ok(Outcome::Completed | Outcome::TakenOver))
    };
    let is_done = outcomes.iter().all(whole);
    let has_lost = outcomes.last().is_some_and(Result::is_err);
    assert!(is_done || has_lost, "{outcomes:?}");
}

/// A connection that can be cut.
struct Wire {
    address: String,
    streams: Arc<Mutex<Vec<TcpStream>>>,
}

impl Wire {
    /// Forwards one connection.
    fn to(controller: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let streams = Arc::<Mutex<Vec<TcpStream>>>::default();
        let (controller, held) = (controller.to_owned(), Arc::clone(&streams));
        std::thread::spawn(move || {
            let (program, _) = listener.accept().unwrap();
            let server = TcpStream::connect(controller).unwrap();
            for stream in [&program, &server] {
                stream.set_nodelay(true).unwrap();
                held.lock().unwrap().push(stream.try_clone().unwrap());
            }
            let (back, forth) = (server.try_clone().unwrap(), program.try_clone().unwrap());
            let there = std::thread::spawn(move || forward(program, server));
            forward(back, forth);
            there.join().unwrap();
        });
        Self { address, streams }
    }

    fn cut(&self) {
        for stream in &*self.streams.lock().unwrap() {
            // Fails if the peer closed first.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }
}

fn forward(mut from: TcpStream, mut to: TcpStream) {
    let mut bytes = [0; 4096];
    while let Ok(count) = from.read(&mut bytes) {
        if count == 0 || to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
