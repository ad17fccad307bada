//! A machine is stepped without allocation.

use std::sync::Arc;

use takt_machine::machine::{Machine, Refused, Ticket};
use takt_machine::{Control, Peers, Phase, Program, Request, Value};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Fulfils everything at once; refuses each third call.
struct Peer(u32);

impl Peers for Peer {
    fn phase(&self, _: usize) -> Phase {
        Phase::Running
    }

    fn read(&self, _: usize, _: usize, _: usize) -> Option<Value> {
        Some(Value::Bool(self.0.is_multiple_of(7)))
    }

    fn write(&mut self, _: usize, _: usize, _: Value) -> Result<(), Refused> {
        Ok(())
    }

    fn set(&mut self, _: usize, _: &[(usize, Value)]) -> Result<(), Refused> {
        Ok(())
    }

    fn request(&mut self, _: usize, _: Request) -> Result<(), Refused> {
        Ok(())
    }

    fn is_settled(&self, _: usize) -> Result<bool, Refused> {
        Ok(true)
    }

    fn call(&mut self, component: usize, operation: usize, _: &[Value]) -> Result<Ticket, Refused> {
        self.0 += 1;
        if self.0.is_multiple_of(3) {
            return Err(Refused::NotRunning);
        }
        let number = self.0;
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

#[test]
fn machine_steps_do_not_allocate() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/machine");
    let text = std::fs::read_to_string(folder.join("lola.machine")).unwrap();
    let library =
        |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| e.to_string());
    let (program, _) = Program::compile(&text, &library).unwrap();
    let mut machine = Machine::new(Arc::new(program));
    let mut peer = Peer(0);
    let counted = Allocations::count();
    let (mut transitions, mut errors) = (0, 0);
    for cycle in 0..10_000 {
        if machine.control(0, Control::Activate).is_ok() {
            machine.control(0, Control::Start).unwrap();
        }
        transitions += machine.step(&mut peer, cycle * 1_000_000).transitions;
        errors += u32::from(machine.failure(0).is_some());
    }
    assert_eq!(counted.end(), 0);
    assert!(
        transitions > 100 && errors > 100,
        "{transitions} transitions, {errors} errors"
    );
}
