//! The time of a step: of a machine of 50 states, and of programs of one kind of operation, each beside the bound that is declared
//! for it. Components answer from memory; what they cost in a controller is in the bound besides. Judges no figure. `cargo bench -p
//! takt-machine --bench step`.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::unwrap_used, reason = "a benchmark that cannot go on ends")]

use std::fmt::Write as _;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use takt_machine::machine::{Machine, Refused, Ticket};
use takt_machine::{Control, Peers, Phase, Program, Request, Value};

/// Steps that are measured, one by one.
const STEPS: usize = 200_000;
/// Statements of a program of one kind.
const COPIES: usize = 100;

const COMPONENT: &str = "component C {
  property gain: int range 0 .. 9 default 1 live;
  in x: int; in y: double;
  out flag: bool; out level: double;
  operation log(n: int);
}
{ g=Core::IntNetcommIn(Key='gain'), x=Core::IntNetcommIn(Key='x'), y=Core::DoubleNetcommIn(Key='y'),
  l=Core::IntNetcommIn(Key='log'), n=Core::IntNetcommIn(Key='log_n'),
  b=Core::BooleanValue(), flag=Core::BooleanNetcommOut(inValue=b.outValue, Key='flag'),
  level=Core::DoubleNetcommOut(inValue=y.outValue, Key='level'), outTerminate=b.outValue }";

/// A component that fulfils everything at once.
#[derive(Default)]
struct Peer {
    flag: bool,
    level: f64,
    written: Option<Value>,
    calls: u32,
    phase: Phase,
}

impl Peers for Peer {
    fn phase(&self, _: usize) -> Phase {
        self.phase
    }

    fn read(&self, _: usize, port: usize, _: usize) -> Option<Value> {
        Some(if port == 2 {
            Value::Bool(self.flag)
        } else {
            Value::Double(self.level)
        })
    }

    fn write(&mut self, _: usize, _: usize, value: Value) -> Result<(), Refused> {
        self.written = Some(value);
        Ok(())
    }

    fn set(&mut self, _: usize, values: &[(usize, Value)]) -> Result<(), Refused> {
        self.written = values.first().map(|(_, value)| *value);
        Ok(())
    }

    fn request(&mut self, _: usize, request: Request) -> Result<(), Refused> {
        self.phase = self.phase.after(request)?;
        Ok(())
    }

    fn is_settled(&self, _: usize) -> Result<bool, Refused> {
        Ok(true)
    }

    fn call(&mut self, component: usize, operation: usize, _: &[Value]) -> Result<Ticket, Refused> {
        self.calls = self.calls.wrapping_add(1);
        let number = self.calls;
        Ok(Ticket {
            component,
            operation,
            number,
        })
    }

    fn is_done(&self, _: Ticket) -> Result<bool, Refused> {
        Ok(true)
    }
}

/// A ring of 50 states; each has four programs and five transitions, and is left after a few steps.
fn fifty() -> String {
    let mut text =
        "machine Fifty { component c from \"c\" started; event abort; var n: int; var x: double; "
            .to_owned();
    for n in 0..50 {
        let kind = ["initial ", ""][usize::from(n > 0)];
        let (next, far) = ((n + 1) % 50, (n + 7) % 50);
        let _ = write!(
            text,
            "{kind}state S{n} {{ entry {{ n := n + 1; c.gain := n % 9; }}
               run {{ x := c.level * 0.5 + x * 0.5; if x > 100.0 {{ c.x := n; }} else {{ c.y := x; }} }}
               handle {{ n := n % 1000; }} exit {{ call c.log(n); }}
               transition on abort to Last; transition on error to Last;
               transition if c.level > 1000.0 and not c.flag to S{far};
               transition if c.flag and n > 0 to S{next} {{ x := 0.0; }}
               transition if n < 0 to Last; }} "
        );
    }
    text + "final state Last { entry { stop c; } } }"
}

/// A machine whose only state executes copies of a statement in each step.
fn of_statement(statement: &str) -> String {
    format!(
        "machine One {{ component c from \"c\" started; event e; var n: int; var x: double; var b: bool;
           initial state A {{ run {{ {} }} transition if false to Z; }} final state Z {{ entry {{ stop c; }} }}
           machine inner {{ initial final state U {{ transition if false to U; }} }} }}",
        statement.repeat(COPIES)
    )
}

struct Figures {
    median: f64,
    tail: f64,
    operations: usize,
    bound: f64,
}

/// Steps of a machine, in automatic mode; `before` prepares the components for each.
fn measure(text: &str, steps: usize, before: impl Fn(&mut Peer, usize)) -> Figures {
    let library = |_: &str| Ok(COMPONENT.to_owned());
    let compiled = Program::compile(text, &library);
    let (program, _) = compiled
        .map_err(|found| found.render("bench", text))
        .unwrap();
    let bound = program.worst_time().as_secs_f64() * 1e9;
    let mut machine = Machine::new(Arc::new(program));
    let mut peer = Peer {
        phase: Phase::Running,
        ..Peer::default()
    };
    for control in [Control::Activate, Control::Start] {
        machine.control(0, control).unwrap();
    }
    let (mut times, mut operations) = (Vec::with_capacity(steps), 0);
    for step in 0..steps {
        before(&mut peer, step);
        let now = i64::try_from(step).unwrap() * 1_000_000;
        let begin = Instant::now();
        let outcome = black_box(machine.step(black_box(&mut peer), now));
        times.push(begin.elapsed().as_secs_f64() * 1e9);
        operations = outcome.operations.max(operations);
    }
    assert_eq!(machine.failure(0), None);
    times.sort_by(f64::total_cmp);
    let at = |per_mille: usize| times[(times.len() - 1) * per_mille / 1_000];
    Figures {
        median: at(500),
        tail: at(999),
        operations,
        bound,
    }
}

fn main() {
    println!(
        "{:<34} {:>9} {:>9} {:>11} {:>9}",
        "step", "median ns", "99.9 % ns", "operations", "bound ns"
    );
    let show = |name: &str, found: &Figures| {
        println!(
            "{name:<34} {:>9.0} {:>9.0} {:>11} {:>9.0}",
            found.median, found.tail, found.operations, found.bound
        );
    };
    let text = fifty();
    let change = measure(&text, STEPS, |peer, _| peer.flag = true);
    show("50 states, a transition in each second", &change);
    let stay = measure(&text, STEPS, |peer, _| peer.level = 1.0);
    show("50 states, no transition", &stay);
    let empty = of_statement("");
    let empty = measure(&empty, STEPS, |_, _| {});
    show("no statement", &empty);
    println!("\n{:<34} {:>9} {:>9}", "operation", "ns", "bound ns");
    for (name, statement) in [
        (
            "arithmetic",
            "n := (n + 3) * 2 % 1000; x := x * 0.5 + 1.0; ",
        ),
        (
            "branch",
            "if b and x > 3.0 { b := not b; } else { b := n == 4; } ",
        ),
        ("read", "x := c.level; "),
        ("write", "c.y := 1.5; "),
        ("set", "set c { gain := 3; } "),
        ("call", "call c.log(4); "),
        ("request", "stop c; start c; "),
        ("state of the life cycle", "b := c is running; "),
        ("event", "raise e; "),
        ("machine inside", "b := inner is inactive; "),
    ] {
        let found = measure(&of_statement(statement), STEPS / 20, |_, _| {});
        #[expect(clippy::cast_precision_loss, reason = "a few hundred")]
        let operations = (found.operations - empty.operations) as f64;
        println!(
            "{name:<34} {:>9.1} {:>9.1}",
            (found.median - empty.median) / operations,
            (found.bound - empty.bound) / operations
        );
    }
}
