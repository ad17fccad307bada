//! The proof against a model of a drive that uses its process data as it likes, in virtual time. The model obeys a
//! controlword as the profile says; its bus is a cycle late each way, and its SDO server takes some cycles.

use super::*;
use takt_tests::Random;

use crate::emulator::Distortion;
use crate::{ControlWord, Feedback, Goal, Master, MasterOptions, Trigger, transition};

const CYCLE: Duration = Duration::from_millis(1);
const SENT: [u16; 5] = [0x6040, 0x6060, 0x607A, 0x60FF, 0x6071];
const RECEIVED: [u16; 6] = [0x6041, 0x6061, 0x6064, 0x606C, 0x6077, 0x603F];

/// From `-most` to `most`.
fn around(random: &mut Random, most: i32) -> i32 {
    let span = usize::try_from(most.unsigned_abs() * 2 + 1).unwrap();
    i32::try_from(random.below(span)).unwrap() - most
}

fn lens(indices: &[u16]) -> Vec<usize> {
    let len = |index: &u16| Object::of(*index).unwrap().bytes();
    indices.iter().map(len).collect()
}

fn pack(indices: &[u16], values: &Values) -> Vec<u8> {
    let bytes = |index: &u16| {
        let object = Object::of(*index).unwrap();
        values.get(object).to_le_bytes()[..object.bytes()].to_vec()
    };
    indices.iter().flat_map(bytes).collect()
}

fn unpack(indices: &[u16], bytes: &[u8], values: &mut Values) {
    let mut at = 0;
    for index in indices {
        let object = Object::of(*index).unwrap();
        let mut raw = [0; 4];
        raw[..object.bytes()].copy_from_slice(&bytes[at..at + object.bytes()]);
        values.set(object, u32::from_le_bytes(raw));
        at += object.bytes();
    }
}

/// A drive.
struct Model {
    objects: Values,
    outputs: Distortion,
    inputs: Distortion,
    state: State,
    word: ControlWord,
    /// Where its shaft is, how fast it is turned from outside (increments per cycle), and how it shakes.
    position: f64,
    turned: f64,
    noise: i32,
    random: Random,
    /// It had power at some time.
    powered: bool,
    /// The first 607Ah that it saw enabled, and 6064h then.
    enabled_at: Option<(u32, u32)>,
}

impl Model {
    fn new(position: i32) -> Self {
        Self {
            objects: Values::default(),
            outputs: Distortion::default(),
            inputs: Distortion::default(),
            state: State::SwitchOnDisabled,
            word: ControlWord::DISABLE_VOLTAGE,
            position: position.into(),
            turned: 0.0,
            noise: 0,
            random: Random::new(0x9E37_79B9_7F4A_7C15),
            powered: false,
            enabled_at: None,
        }
    }

    fn step(&mut self, sent: &Values) -> Values {
        let mut bytes = pack(&SENT, sent);
        self.outputs.receive(&lens(&SENT), &mut bytes);
        unpack(&SENT, &bytes, &mut self.objects);
        let word = ControlWord::new(u16::try_from(self.objects.at(0x6040)).unwrap());
        let command = word.command(self.word).map(Trigger::Command);
        self.word = word;
        if let Some(arrow) = command.and_then(|trigger| transition(self.state, trigger)) {
            self.state = arrow.to;
        }
        self.powered |= matches!(self.state, State::SwitchedOn | State::OperationEnabled);
        self.position += self.turned;
        #[expect(clippy::cast_possible_truncation, reason = "positions in here fit")]
        let position = self.position as i32 + around(&mut self.random, self.noise);
        #[expect(clippy::cast_possible_truncation, reason = "speeds in here fit")]
        let velocity = (self.turned * 1000.0) as i32 + around(&mut self.random, self.noise * 20);
        let shaking = if self.noise > 0 {
            u32::from(self.random.byte()) << 5 & 0x1C00
        } else {
            0
        };
        let objects = &mut self.objects;
        objects.put(
            0x6041,
            u32::from(self.state.status_bits()) | 0x0210 | shaking,
        );
        objects.put(0x6061, objects.at(0x6060));
        objects.put(0x6064, position.cast_unsigned());
        objects.put(0x606C, velocity.cast_unsigned());
        objects.put(0x6077, around(&mut self.random, self.noise).cast_unsigned());
        if self.state == State::OperationEnabled && self.enabled_at.is_none() {
            self.enabled_at = Some((self.objects.at(0x607A), self.objects.at(0x6064)));
        }
        let mut bytes = pack(&RECEIVED, &self.objects);
        self.inputs.transmit(&lens(&RECEIVED), &mut bytes);
        let mut received = Values::default();
        unpack(&RECEIVED, &bytes, &mut received);
        received
    }
}

/// A drive and its master.
struct Bench {
    model: Model,
    master: Master,
    proof: Proof,
    received: Values,
    sent: Values,
    now: Duration,
    /// An upload under way, and how many cycles it still takes.
    upload: Option<(Address, u32)>,
    latency: u32,
    denied: Option<(u16, Denied)>,
}

impl Bench {
    fn new(model: Model) -> Self {
        let carried: Vec<u16> = SENT.into_iter().chain(RECEIVED).collect();
        let carried = Objects::of(&carried).unwrap();
        let mut master = Master::new(MasterOptions {
            no_follow_bit: true,
            ..MasterOptions::default()
        });
        master.set_mode(8);
        master.set_goal(Goal::OperationEnabled);
        Self {
            model,
            master,
            proof: Proof::new(0, carried, Objects::default()),
            received: Values::default(),
            sent: Values::default(),
            now: Duration::from_secs(1),
            upload: None,
            latency: 3,
            denied: None,
        }
    }

    fn cycle(&mut self) {
        self.now += CYCLE;
        let status = StatusWord::new(u16::try_from(self.received.at(0x6041)).unwrap());
        let exchanged = Exchanged {
            received: self.received,
            sent: self.sent,
            fresh: true,
            state: status.state().ok(),
            wanted: true,
            mode: 8,
        };
        self.proof.step(&exchanged, self.now);
        self.serve();
        self.master.set_ceiling(self.proof.ceiling());
        let feedback = Feedback {
            status,
            mode: Some(self.received.at(0x6061).to_le_bytes()[0].cast_signed()),
            position: self.received.at(0x6064).cast_signed(),
        };
        let drive_command = self.master.step(&feedback, self.now);
        let mut targets = Values::default();
        targets.put(0x6040, drive_command.control.raw().into());
        targets.put(0x6060, 8);
        targets.put(0x607A, self.received.at(0x6064));
        let next = *self.proof.instead().unwrap_or(&targets);
        let arrived = std::mem::replace(&mut self.sent, next);
        self.received = self.model.step(&arrived);
    }

    fn serve(&mut self) {
        if let Some(address) = self.proof.poll_upload() {
            self.upload = Some((address, self.latency));
        }
        match &mut self.upload {
            Some((address, 0)) => {
                let object = Object::of(address.index).unwrap();
                let value = self.model.objects.get(object).to_le_bytes();
                let denied = self.denied.filter(|(index, _)| *index == address.index);
                let answer =
                    denied.map_or_else(|| Ok(&value[..object.bytes()]), |(_, denied)| Err(denied));
                self.proof.handle_upload(answer, self.now);
                self.upload = None;
            }
            Some((_, left)) => *left -= 1,
            None => {}
        }
    }

    /// Until it is proven or refused.
    fn decide(&mut self) -> Result<Duration, ProofFault> {
        for _ in 0..3000 {
            self.cycle();
            if let Some(fault) = self.proof.fault() {
                for _ in 0..100 {
                    self.cycle();
                }
                return Err(fault);
            }
            if let Some(took) = self.proof.took() {
                return Ok(took);
            }
        }
        panic!("no decision: {:?}", self.proof);
    }

    /// It is refused, and has not had power.
    #[track_caller]
    fn refused(mut self) -> String {
        let fault = self.decide().unwrap_err();
        assert!(!self.model.powered, "{fault}");
        fault.to_string()
    }
}

fn drive_command(of: usize) -> Vec<Vec<usize>> {
    let mut all = vec![vec![]];
    for _ in 0..of {
        all = all
            .iter()
            .flat_map(|order: &Vec<usize>| {
                let rest = (0..of).filter(|n| !order.contains(n));
                rest.map(|n| [order.as_slice(), &[n]].concat())
            })
            .collect();
    }
    all
}

#[test]
fn proof_of_a_faithful_drive_leads_to_power() {
    let mut bench = Bench::new(Model::new(9999));
    let took = bench.decide().unwrap();
    assert!(!bench.model.powered, "before the proof");
    assert!(took < Duration::from_millis(200), "{took:?}");
    for _ in 0..20 {
        bench.cycle();
    }
    assert_eq!(bench.model.state, State::OperationEnabled);
    let (target, actual) = bench.model.enabled_at.unwrap();
    assert_eq!(target, actual, "its first 607Ah");
}

#[test]
fn proof_refuses_all_119_other_orders_of_outputs() {
    for order in drive_command(5) {
        let mut model = Model::new(9999);
        model.outputs = Distortion::order(order.clone());
        let mut bench = Bench::new(model);
        let decided = bench.decide();
        let same = order == [0, 1, 2, 3, 4];
        assert_eq!(decided.is_ok(), same, "{order:?} {decided:?}");
        assert!(same || !bench.model.powered, "{order:?}");
    }
}

/// 606Ch, 6077h and 603Fh are zero at rest: orders that only mix these lead the axis by the right values.
#[test]
fn proof_refuses_all_orders_of_inputs_that_misplace_a_value() {
    let mut seen = 0;
    for order in drive_command(6) {
        let mut model = Model::new(9999);
        model.inputs = Distortion::order(order.clone());
        let mut bench = Bench::new(model);
        let decided = bench.decide();
        let right = order[..3] == [0, 1, 2];
        assert_eq!(decided.is_ok(), right, "{order:?} {decided:?}");
        assert!(right || !bench.model.powered, "{order:?}");
        seen += usize::from(!right);
    }
    assert_eq!(seen, 714);
}

#[test]
fn proof_refuses_every_shift_of_either_direction() {
    for shift in 1..13 {
        let mut model = Model::new(9999);
        model.outputs.shift = shift;
        Bench::new(model).refused();
        let mut model = Model::new(9999);
        model.inputs.shift = shift;
        Bench::new(model).refused();
    }
}

#[test]
fn proof_refuses_long_delays_and_lets_short_ones_through() {
    for (delay, good) in [(1, true), (8, true), (200, false), (1000, false)] {
        let mut model = Model::new(9999);
        model.outputs.delay = delay;
        let mut bench = Bench::new(model);
        assert_eq!(bench.decide().is_ok(), good, "outputs {delay}");
        let mut model = Model::new(9999);
        model.inputs.delay = delay;
        let mut bench = Bench::new(model);
        assert_eq!(bench.decide().is_ok(), good, "inputs {delay}");
    }
}

#[test]
fn proof_refuses_frozen_process_data_of_either_direction() {
    for cycle in (0..150).step_by(3) {
        for inputs in [false, true] {
            let mut bench = Bench::new(Model::new(9999));
            for _ in 0..cycle {
                bench.cycle();
            }
            if bench.proof.is_proven() {
                continue;
            }
            let frozen = if inputs {
                &mut bench.model.inputs
            } else {
                &mut bench.model.outputs
            };
            frozen.frozen = true;
            // Frozen at the very end the last value is right; then the drive never comes up.
            let decided = (0..400).find_map(|_| {
                bench.cycle();
                bench
                    .proof
                    .fault()
                    .map(Err)
                    .or_else(|| bench.proof.took().map(Ok))
            });
            for _ in 0..100 {
                bench.cycle();
            }
            let enabled = bench.model.enabled_at;
            assert_eq!(enabled, None, "{cycle} {inputs} {decided:?}");
        }
    }
}

#[test]
fn proof_error_shows_both_values_and_hint() {
    let mut model = Model::new(9999);
    // As a mapping of an earlier use: 607Ah first, behind 6040h.
    model.outputs = Distortion::order([0, 2, 1, 3, 4]);
    let text = Bench::new(model).refused();
    assert!(text.starts_with("6060h by PDO 8, by SDO "), "{text}");
    assert!(
        text.contains(": the slave does not use the mapping it acknowledged\nhint: power-cycle it"),
        "{text}"
    );
    let fault = ProofFault::Differs {
        object: Object::TARGET,
        axis: 1,
        pdo: 9992,
        sdo: 2_557_960,
    };
    let text = fault.to_string();
    assert!(
        text.starts_with("687Ah by PDO 9992, by SDO 2557960: the slave does"),
        "{text}"
    );
}

#[test]
fn proof_of_a_noisy_turned_shaft_has_no_false_alarm_in_1000_starts() {
    let mut random = Random::new(7);
    let mut longest = Duration::ZERO;
    for start in 0..1000_u64 {
        let mut model = Model::new(around(&mut random, 1 << 30));
        model.random = Random::new(start);
        model.noise = around(&mut random, 50).abs();
        // Up to 20 turns of 4,096 increments in a second.
        model.turned = f64::from(around(&mut random, 82));
        let mut bench = Bench::new(model);
        bench.latency = u32::try_from(random.below(40)).unwrap();
        let decided = bench.decide();
        assert!(decided.is_ok(), "{start}: {decided:?}");
        longest = longest.max(decided.unwrap());
    }
    println!("longest proof of 1000: {longest:?}");
}

#[test]
fn proof_names_objects_that_sdo_does_not_read() {
    let mut bench = Bench::new(Model::new(9999));
    let code = AbortCode::WriteOnly;
    bench.denied = Some((0x6071, Denied::Abort(code)));
    let text = bench.refused();
    assert!(text.starts_with("6071h cannot be read by SDO ("), "{text}");
    assert!(
        text.contains("\nhint: name 6071h in `not_mirrored`"),
        "{text}"
    );

    let mut bench = Bench::new(Model::new(9999));
    bench.denied = Some((0x6071, Denied::Abort(code)));
    bench.proof.not_mirrored = Objects::of(&[0x6071]).unwrap();
    bench.decide().unwrap();
    assert_eq!(bench.proof.taken_on_trust().to_string(), "6071h");
    assert_eq!(Objects::of(&[0x6071, 0x1000]), Err(0x1000));
}

#[test]
fn proof_without_answers_is_tried_again() {
    let mut bench = Bench::new(Model::new(9999));
    bench.denied = Some((0x6064, Denied::Silent));
    let fault = bench.decide().unwrap_err();
    assert!(matches!(fault, ProofFault::Silent { .. }), "{fault}");
    bench.denied = None;
    for _ in 0..8000 {
        bench.cycle();
    }
    assert!(bench.proof.is_proven() && bench.proof.fault().is_none());
    assert!(bench.model.powered);
}

#[test]
fn proof_begins_again_after_a_restart() {
    let mut bench = Bench::new(Model::new(9999));
    bench.decide().unwrap();
    bench.proof.restart();
    assert_eq!(bench.proof.ceiling(), Goal::SwitchOnDisabled);
    assert_eq!(bench.proof.instead(), Some(&Values::default()));
    bench.model.outputs = Distortion::order([1, 0, 2, 3, 4]);
    bench.model.powered = false;
    bench.decide().unwrap_err();
    assert!(!bench.model.powered);
}
