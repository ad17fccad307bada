//! `Irl::Program`: the interpreter as a primitive of nets. Robots and signals are connected by links, so that a net decides
//! which devices they are.

use std::sync::Arc;

use takt_net::definition::port;
use takt_net::failure::FailureCell;
use takt_net::{
    ArrayIn, ArrayOut, Build, Cycle, Definition, Fault, FaultKind, In, NullRule, Out, Primitive,
};

use crate::code::Program;
use crate::machine::{Control, Machine, Phase, STEP_COST_NS};
use crate::spec::{Direction, SignalKind};
use arms::arms;
use failure::{code_of_failure, text_of_failure};

/// Most steps of a cycle.
const STEPS_MAX: usize = 100_000;
/// Cost of a cycle of one robot, in array elements of 10 ns: two inverses of an arm, and the beginning of a motion.
const ROBOT_ELEMENTS: usize = 20_000;

mod arms;
mod failure;

/// All definitions of this crate.
#[must_use]
pub fn all() -> Vec<Definition> {
    vec![definition()]
}

/// Signals of one direction and kind: number in the program and channel.
type Channels = Box<[(usize, usize)]>;

struct Interpreter {
    machine: Machine,
    is_placed: bool,
    joints: Box<[usize]>,
    position: Option<ArrayIn<f64>>,
    speed: In<f64>,
    pause: In<bool>,
    resume: Edge,
    step: Edge,
    stop: In<bool>,
    breakpoints: Option<ArrayIn<i32>>,
    digital_in: Inputs<bool>,
    analog_in: Inputs<f64>,
    binary_in: Inputs<i32>,
    positions: ArrayOut<f64>,
    digital_out: (ArrayOut<bool>, Channels),
    analog_out: (ArrayOut<f64>, Channels),
    binary_out: (ArrayOut<i32>, Channels),
    observed: Box<[usize]>,
    values: ArrayOut<f64>,
    state: Out<i32>,
    line: Out<i32>,
    column: Out<i32>,
    error: Out<i32>,
    done: Out<bool>,
    failure: Arc<FailureCell>,
    scratch: Box<[f64]>,
}

/// A request that counts when it becomes true.
struct Edge {
    input: In<bool>,
    was: bool,
}

impl Edge {
    const fn new(input: In<bool>) -> Self {
        Self { input, was: false }
    }

    fn rises(&mut self, cycle: &Cycle<'_>) -> bool {
        let is = self.input.get(cycle) == Some(true);
        let was = std::mem::replace(&mut self.was, is);
        is && !was
    }
}

impl Interpreter {
    /// Takes the positions of all robots, once; returns whether they are known.
    fn place(&mut self, cycle: &Cycle<'_>) -> bool {
        let Some(position) = &self.position else {
            return true;
        };
        let Some(values) = position.get(cycle) else {
            return false;
        };
        for (known, value) in self.scratch.iter_mut().zip(values) {
            *known = value.get();
        }
        if !self.scratch.iter().all(|value| value.is_finite()) {
            return false;
        }
        let mut first = 0;
        for (robot, count) in self.joints.iter().enumerate() {
            let values = self.scratch.get(first..first + count);
            self.machine.place(robot, values.unwrap_or_default());
            first += count;
        }
        true
    }

    fn read_inputs(&mut self, cycle: &Cycle<'_>) {
        let machine = &mut self.machine;
        self.digital_in.read(cycle, machine, u64::from);
        self.analog_in.read(cycle, machine, f64::to_bits);
        let word = |value: i32| i64::from(value).cast_unsigned();
        self.binary_in.read(cycle, machine, word);
        if let Some(lines) = self.breakpoints.as_ref().and_then(|port| port.get(cycle)) {
            let lines = lines.iter().map(|line| u32::try_from(line.get()));
            machine.set_breakpoints(lines.map(|line| line.unwrap_or(0)));
        }
    }

    fn write_outputs(&self, cycle: &Cycle<'_>) {
        let machine = &self.machine;
        let output = |channels: &Channels, index: usize| {
            let mut found = channels.iter().filter(|(_, channel)| *channel == index);
            found
                .find_map(|(signal, _)| machine.output(*signal))
                .unwrap_or(0)
        };
        let (port, channels) = &self.digital_out;
        port.set(cycle, (0..port.len()).map(|i| output(channels, i) != 0));
        let (port, channels) = &self.analog_out;
        port.set(
            cycle,
            (0..port.len()).map(|i| f64::from_bits(output(channels, i))),
        );
        let (port, channels) = &self.binary_out;
        let whole = |i| i32::try_from(output(channels, i).cast_signed()).unwrap_or(0);
        port.set(cycle, (0..port.len()).map(whole));
        let robots = (0..self.joints.len()).flat_map(|robot| machine.positions(robot));
        self.positions.set(cycle, robots.copied());
        let values = self.observed.iter();
        self.values.set(
            cycle,
            values.map(|v| machine.variable(*v).unwrap_or(f64::NAN)),
        );
    }
}

/// Inputs of a kind.
struct Inputs<T: takt_net::Value> {
    port: Option<ArrayIn<T>>,
    /// Which of them have no value.
    nulls: Option<ArrayIn<bool>>,
    channels: Channels,
}

impl<T: takt_net::value::text::TextValue> Inputs<T> {
    fn linked(
        b: &mut Build<'_, '_>,
        [name, nulls]: [&'static str; 2],
        channels: Channels,
    ) -> Result<Self, Fault> {
        let needed = width(&channels);
        let port = linked::<T>(b, name, needed)?;
        let is_linked = b.is_linked(nulls);
        let nulls = if is_linked {
            linked::<bool>(b, nulls, needed)?
        } else {
            None
        };
        Ok(Self {
            port,
            nulls,
            channels,
        })
    }

    fn read(&self, cycle: &Cycle<'_>, machine: &mut Machine, word: impl Fn(T) -> u64) {
        let values = self.port.as_ref().and_then(|port| port.get(cycle));
        let nulls = self.nulls.as_ref().and_then(|port| port.get(cycle));
        for (signal, channel) in &self.channels {
            let null = nulls.and_then(|nulls| nulls.get(*channel));
            let value = values.and_then(|values| values.get(*channel));
            let value = value.filter(|_| !null.is_some_and(|null| null.get()));
            machine.set_input(*signal, value.map(|value| word(value.get())));
        }
    }
}

impl Primitive for Interpreter {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if !self.is_placed {
            self.is_placed = self.place(cycle);
            if !self.is_placed {
                self.positions.set_null(cycle);
                self.digital_out.0.set_null(cycle);
                self.analog_out.0.set_null(cycle);
                self.binary_out.0.set_null(cycle);
                self.values.set_null(cycle);
                self.state.set(cycle, 0);
                self.line.set(cycle, None);
                self.column.set(cycle, None);
                self.error.set(cycle, 0);
                self.done.set(cycle, false);
                return;
            }
        }
        self.read_inputs(cycle);
        let phase = self.machine.cycle(Control {
            speed: self.speed.get(cycle).unwrap_or(0.0),
            pause: self.pause.get(cycle) == Some(true),
            resume: self.resume.rises(cycle),
            step: self.step.rises(cycle),
            stop: self.stop.get(cycle) == Some(true),
        });
        self.write_outputs(cycle);
        let fault = self.machine.fault();
        if let Some(fault) = fault {
            self.failure.note(code_of_failure(fault));
        }
        let at = fault.map_or_else(|| self.machine.location(), |fault| fault.at);
        let number = |value: u32| i32::try_from(value).unwrap_or(i32::MAX);
        self.state.set(cycle, phase as i32);
        self.line.set(cycle, number(at.line));
        self.column.set(cycle, number(at.column));
        self.error
            .set(cycle, fault.map_or(0, |fault| fault.kind as i32));
        let has_ended = matches!(phase, Phase::Ended | Phase::Failed);
        self.done.set(cycle, has_ended && self.machine.is_at_rest());
    }
}

/// Object code from its text: hexadecimal digits.
fn code_of(text: &str) -> Result<Program, String> {
    let digits = text.trim().as_bytes();
    let byte = |pair: &[u8]| {
        let pair = std::str::from_utf8(pair).ok()?;
        (pair.len() == 2).then(|| u8::from_str_radix(pair, 16).ok())?
    };
    let bytes: Option<Vec<u8>> = digits.chunks(2).map(byte).collect();
    let bytes = bytes.ok_or_else(|| "this is not object code in hexadecimal digits".to_owned())?;
    Program::decode(&bytes).map_err(|error| error.to_string())
}

fn channels(program: &Program, direction: Direction, kind: SignalKind) -> Channels {
    let signals = program.system.signals.iter().enumerate();
    let fitting = signals.filter(|(_, s)| s.direction == direction && s.kind == kind);
    fitting.map(|(i, s)| (i, usize::from(s.channel))).collect()
}

/// Number of channels of a port.
fn width(channels: &Channels) -> usize {
    channels
        .iter()
        .map(|(_, channel)| channel + 1)
        .max()
        .unwrap_or(0)
}

fn linked<T: takt_net::value::text::TextValue>(
    b: &mut Build<'_, '_>,
    name: &'static str,
    needed: usize,
) -> Result<Option<ArrayIn<T>>, Fault> {
    if !b.is_linked(name) {
        if needed == 0 {
            return Ok(None);
        }
        let why = format!("the program reads {needed} channels of {name}, which is not connected");
        return Err(b.parameter_fault("Code", why));
    }
    let port = b.array_input::<T>(name)?;
    if port.len() < needed {
        let found = port.len();
        let why = format!("{name} carries {found} elements, the program reads {needed}");
        return Err(b.fault(FaultKind::ArraySize(why)));
    }
    Ok(Some(port))
}

/// The variables that parameter `Watch` names.
fn observed(b: &Build<'_, '_>, program: &Program) -> Result<Box<[usize]>, Fault> {
    let names = b.text("Watch").split(',').map(str::trim);
    let find = |name: &str| {
        let name = name.to_ascii_lowercase();
        let mut variables = program.variables.iter();
        variables.position(|v| v.name == name).ok_or_else(|| {
            let known = program.variables.iter().map(|v| v.name.as_str());
            let similar = takt_net::fault::similar(&name, known);
            let similar = similar.map_or_else(String::new, |s| format!("; did you mean `{s}`?"));
            let why = format!("the program has no global number or truth value `{name}`{similar}");
            b.parameter_fault("Watch", why)
        })
    };
    names.filter(|name| !name.is_empty()).map(find).collect()
}

/// Puts all robots where their specification begins.
fn place_at_home(machine: &mut Machine) {
    let homes: Vec<Vec<f64>> = machine
        .program()
        .system
        .robots
        .iter()
        .map(|r| r.home.iter().map(|q| q.to_radians()).collect())
        .collect();
    for (robot, home) in homes.iter().enumerate() {
        machine.place(robot, home);
    }
}

fn build(b: &mut Build<'_, '_>) -> Result<Interpreter, Fault> {
    let mut program = code_of(b.text("Code")).map_err(|why| b.parameter_fault("Code", why))?;
    let name = program.name.clone();
    let steps = b.number("Steps", 16..=STEPS_MAX)?;
    let joints: Box<[usize]> = program
        .system
        .robots
        .iter()
        .map(|r| r.joints.len())
        .collect();
    let total: usize = joints.iter().sum();
    let arms = arms(b, &mut program)?;
    let observed = observed(b, &program)?;
    let channels = |direction, kind| channels(&program, direction, kind);
    let [digital_in, analog_in, binary_in] =
        [SignalKind::Digital, SignalKind::Analog, SignalKind::Binary]
            .map(|kind| channels(Direction::In, kind));
    let [digital_out, analog_out, binary_out] =
        [SignalKind::Digital, SignalKind::Analog, SignalKind::Binary]
            .map(|kind| channels(Direction::Out, kind));
    let position = if b.is_linked("inPosition") {
        linked::<f64>(b, "inPosition", total)?
    } else {
        None
    };
    // One step of 50 ns counts as five elements of 10 ns.
    b.adds_elements(steps * STEP_COST_NS as usize / 10 + joints.len() * ROBOT_ELEMENTS / 10);
    let steps = u32::try_from(steps).unwrap_or(u32::MAX);
    let machine = Machine::new(Arc::new(program), &arms, b.period(), steps);
    let mut machine = machine.map_err(|error| b.parameter_fault("Code", error.to_string()))?;
    if position.is_none() {
        place_at_home(&mut machine);
    }
    Ok(Interpreter {
        machine,
        is_placed: false,
        position,
        speed: b.input("inOverride")?,
        pause: b.input("inPause")?,
        resume: Edge::new(b.input("inContinue")?),
        step: Edge::new(b.input("inStep")?),
        breakpoints: if b.is_linked("inBreakpoints") {
            Some(b.array_input("inBreakpoints")?)
        } else {
            None
        },
        stop: b.input("inStop")?,
        digital_in: Inputs::linked(b, ["inDigital", "inDigitalNull"], digital_in)?,
        analog_in: Inputs::linked(b, ["inAnalog", "inAnalogNull"], analog_in)?,
        binary_in: Inputs::linked(b, ["inBinary", "inBinaryNull"], binary_in)?,
        positions: b.array_output("outPosition", total)?,
        digital_out: (
            b.array_output("outDigital", width(&digital_out))?,
            digital_out,
        ),
        analog_out: (b.array_output("outAnalog", width(&analog_out))?, analog_out),
        binary_out: (b.array_output("outBinary", width(&binary_out))?, binary_out),
        values: b.array_output("outWatch", observed.len())?,
        observed,
        state: b.output("outState"),
        line: b.output("outLine"),
        column: b.output("outColumn"),
        error: b.output("outError"),
        done: b.output("outDone"),
        failure: b.failure(text_of_failure(name)),
        scratch: vec![0.0; total].into(),
        joints,
    })
}

/// Object code of a program that ends at once, so that the primitive can be built without parameters.
const NOTHING: &str = include_str!("nothing.hex");

fn definition() -> Definition {
    Definition::new(
        "Irl::Program",
        "Executes a compiled L-IRL program: a bounded number of steps in each cycle, motions of its robots, signals.",
        build,
    )
    .text_with_default("Code", NOTHING, "object code in hexadecimal digits")
    .text("Robots", "arms of the robots of the program, in its order, separated by commas; if not empty, the program moves within their limits and with their kinematics")
    .text("Watch", "global variables of the program at outWatch, separated by commas")
    .parameter::<i32>("Steps", "1000", "most steps in a cycle, 16 to 100000; a program that needs more goes on in the next one")
    .array_input::<f64>(port("inPosition", "joints of all robots at the beginning, rad; if not connected, their home"))
    .input::<f64>(port("inOverride", "part of the speed of motions, 0 to 1").or("Override", "1"))
    .input::<bool>(port("inPause", "true holds the motions on their paths, and the program"))
    .input::<bool>(port("inContinue", "a change to true goes on behind a `pause` statement, a breakpoint or a step"))
    .input::<bool>(port("inStep", "a change to true goes on, and waits again before the next line; motions are not held"))
    .array_input::<i32>(port("inBreakpoints", "lines, from 1, before which the program waits; 0 is none, the first 16 count"))
    .input::<bool>(port("inStop", "true ends the program; motions brake on their paths"))
    .array_input::<bool>(port("inDigital", "digital inputs by channel"))
    .array_input::<bool>(port("inDigitalNull", "which digital inputs have no value; none if not connected"))
    .array_input::<f64>(port("inAnalog", "analogue inputs by channel, any unit"))
    .array_input::<bool>(port("inAnalogNull", "which analogue inputs have no value; none if not connected"))
    .array_input::<i32>(port("inBinary", "inputs of whole numbers by channel"))
    .array_input::<bool>(port("inBinaryNull", "which inputs of whole numbers have no value; none if not connected"))
    .array_output::<f64>("outPosition", "joints of all robots, rad")
    .array_output::<bool>("outDigital", "digital outputs by channel")
    .array_output::<f64>("outAnalog", "analogue outputs by channel, any unit")
    .array_output::<i32>("outBinary", "outputs of whole numbers by channel")
    .array_output::<f64>("outWatch", "values of the watched variables, any unit")
    .output::<i32>("outState", "0 waits for inPosition, 1 runs, 2 pauses, 3 ends, 4 ended, 5 failed")
    .output::<i32>("outLine", "line of the statement that is executed, or failed; from 1")
    .output::<i32>("outColumn", "its column; from 1")
    .output::<i32>("outError", "0, or why the program failed, as in docs/irl.md")
    .output::<bool>("outDone", "the program has ended or failed, and its robots are at rest")
    .cost_ns(5_000)
    .active()
    .null(NullRule::Own(
        "While inPosition is connected and null, the program waits. An input that is null is a fault where the program reads it.",
    ))
}
