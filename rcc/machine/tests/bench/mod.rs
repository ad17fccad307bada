//! Runs a machine and the nets of its components in one thread: what a controller does in a cycle, without threads, devices
//! and clocks.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use takt_machine::component::Data;
use takt_machine::machine::{Machine, Refused, Ticket};
use takt_machine::{Configuration, Peers, Phase, Program, Request, Value};
use takt_net::netcomm::OutStatus;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, NoDevices, Plan, Registry};

const PERIOD: Duration = Duration::from_millis(1);

pub(crate) struct Member {
    pub(crate) phase: Phase,
    configuration: Configuration,
    plan: Option<Plan>,
    inbox: Vec<u64>,
    outbox: Vec<u64>,
    cycles: u64,
    calls: Vec<i32>,
}

pub(crate) struct Bench {
    pub(crate) machine: Machine,
    pub(crate) members: Vec<Member>,
    pub(crate) refuses_calls: bool,
    registry: Registry,
    cycle: i64,
}

/// The components as the machine sees them.
struct Components<'b> {
    program: &'b Program,
    members: &'b mut [Member],
    registry: &'b Registry,
    refuses_calls: bool,
}

impl Member {
    fn write(&mut self, key: &str, text: &str) {
        let plan = self.plan.as_ref().unwrap();
        let entry = plan.inbox().find(&format!("in{key}")).unwrap();
        entry.write(text, &mut self.inbox).unwrap();
    }

    fn value(&self, key: &str) -> Option<&[u64]> {
        let entry = self.plan.as_ref()?.outbox().find(&format!("out{key}"))?;
        let is_known = entry.status(&self.outbox) == OutStatus::Current;
        is_known.then(|| entry.value(&self.outbox))
    }

    fn configure(&mut self, component: &takt_machine::Component, registry: &Registry) {
        let context = LoadContext {
            registry,
            devices: &NoDevices,
            period: PERIOD * component.every,
            limits: Limits::default(),
        };
        let plan = component.load(&self.configuration, &context);
        let plan = plan.map_err(|e| e.to_string()).unwrap();
        self.inbox = plan.inbox_words().collect();
        self.outbox = plan.outbox_words().collect();
        self.plan = Some(plan);
        (self.cycles, self.calls) = (0, vec![0; component.operations.len()]);
    }
}

impl Bench {
    pub(crate) fn lola() -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/machine");
        let text = std::fs::read_to_string(folder.join("lola.machine")).unwrap();
        let library =
            |name: &str| std::fs::read_to_string(folder.join(name)).map_err(|e| e.to_string());
        let compiled =
            Program::compile(&text, &library).map_err(|e| e.render("lola.machine", &text));
        let (program, found) = compiled.unwrap();
        assert!(
            found.all().is_empty(),
            "{}",
            found.render("lola.machine", &text)
        );
        let registry = Registry::core();
        let members = program.members().iter().map(|declared| {
            let mut member = Member {
                phase: Phase::PreOperational,
                configuration: Configuration::of(&declared.component),
                plan: None,
                inbox: Vec::new(),
                outbox: Vec::new(),
                cycles: 0,
                calls: Vec::new(),
            };
            if declared.is_configured {
                member.configure(&declared.component, &registry);
                member.phase = if declared.is_started {
                    Phase::Running
                } else {
                    Phase::Stopped
                };
            }
            member
        });
        Self {
            members: members.collect(),
            machine: Machine::new(Arc::new(program)),
            refuses_calls: false,
            registry,
            cycle: 0,
        }
    }

    pub(crate) fn run(&mut self, cycles: usize) -> Vec<String> {
        use takt_machine::Control;
        self.machine.control(0, Control::Activate).unwrap();
        self.machine.control(0, Control::Start).unwrap();
        let mut visited: Vec<String> = Vec::new();
        for _ in 0..cycles {
            self.cycle();
            let state = self.machine.state(0).unwrap_or_default();
            if visited.last().is_none_or(|last| last != state) {
                visited.push(state.to_owned());
            }
        }
        visited
    }

    /// A cycle: the machine between two cycles, then the components in their order.
    pub(crate) fn cycle(&mut self) {
        let program = Arc::clone(self.machine.program());
        let mut components = Components {
            program: &program,
            members: &mut self.members,
            registry: &self.registry,
            refuses_calls: self.refuses_calls,
        };
        let outcome = self.machine.step(&mut components, self.cycle * 1_000_000);
        assert!(outcome.operations <= program.worst_step(), "{outcome:?}");
        for &index in program.order() {
            for connection in program.connections().iter().filter(|c| c.to.0 == index) {
                self.carry(&program, connection.from, connection.to);
            }
            let every = i64::from(program.members()[index].component.every);
            let member = &mut self.members[index];
            if member.phase != Phase::Running || self.cycle % every != 0 {
                continue;
            }
            let time = Nanos(i64::try_from(member.cycles).unwrap() * every * 1_000_000);
            member.cycles += 1;
            let moment = Moment {
                cycle: member.cycles,
                time,
                wall: time,
                ..Moment::default()
            };
            let plan = member.plan.as_mut().unwrap();
            plan.import(&member.inbox);
            plan.evaluate(&Image::default(), moment);
            plan.export(&mut member.outbox);
        }
        self.cycle += 1;
    }

    fn carry(&mut self, program: &Program, from: (usize, usize), to: (usize, usize)) {
        let name = |(component, port): (usize, usize)| {
            program.members()[component].component.ports[port]
                .declared
                .name
                .clone()
        };
        let Some(words) = self.members[from.0].value(&name(from)) else {
            return;
        };
        let numbers: Vec<String> = words
            .iter()
            .map(|word| format!("{:?}", f64::from_bits(*word)))
            .collect();
        if self.members[to.0].plan.is_some() {
            self.members[to.0].write(&name(to), &format!("[{}]", numbers.join(",")));
        }
    }

    pub(crate) fn number(&self, component: &str, port: &str, element: usize) -> f64 {
        let members = self.machine.program().members();
        let index = members
            .iter()
            .position(|member| member.name == component)
            .unwrap();
        let words = self.members[index].value(port);
        words.map_or(0.0, |words| f64::from_bits(words[element]))
    }
}

impl Peers for Components<'_> {
    fn phase(&self, component: usize) -> Phase {
        self.members[component].phase
    }

    fn read(&self, component: usize, port: usize, element: usize) -> Option<Value> {
        let declared = &self.program.members()[component].component.ports[port].declared;
        let word = *self.members[component]
            .value(&declared.name)?
            .get(element)?;
        Some(match declared.shape.kind {
            takt_machine::Kind::Bool => Value::Bool(word != 0),
            takt_machine::Kind::Int => Value::Int(i32::try_from(word.cast_signed()).unwrap()),
            takt_machine::Kind::Double | takt_machine::Kind::Text => {
                Value::Double(f64::from_bits(word))
            }
        })
    }

    fn write(&mut self, component: usize, port: usize, value: Value) -> Result<(), Refused> {
        let name = &self.program.members()[component].component.ports[port]
            .declared
            .name;
        self.members[component].write(name, &value.to_string());
        Ok(())
    }

    fn set(&mut self, component: usize, values: &[(usize, Value)]) -> Result<(), Refused> {
        let declared = &self.program.members()[component].component;
        let member = &mut self.members[component];
        let changes = values.iter().map(|(index, value)| {
            let data = match value {
                Value::Bool(value) => Data::Bool(*value),
                Value::Int(value) => Data::Int(*value),
                Value::Double(value) => Data::Double(*value),
            };
            (declared.properties[*index].declared.name.clone(), data)
        });
        let set = member.configuration.set(declared, member.phase, changes);
        set.map_err(|_| Refused::Value)?;
        for (index, value) in values {
            let property = &declared.properties[*index];
            if property.live && member.plan.is_some() {
                member.write(&property.declared.name, &value.to_string());
            }
        }
        Ok(())
    }

    fn request(&mut self, component: usize, request: Request) -> Result<(), Refused> {
        let member = &mut self.members[component];
        member.phase = member.phase.after(request)?;
        if request == Request::Configure {
            member.configure(&self.program.members()[component].component, self.registry);
        }
        Ok(())
    }

    fn is_settled(&self, _: usize) -> Result<bool, Refused> {
        Ok(true)
    }

    fn call(
        &mut self,
        component: usize,
        operation: usize,
        arguments: &[Value],
    ) -> Result<Ticket, Refused> {
        let member = &mut self.members[component];
        if member.phase != Phase::Running || self.refuses_calls {
            return Err(Refused::NotRunning);
        }
        let declared = &self.program.members()[component].component.operations[operation];
        for (argument, value) in declared.arguments.iter().zip(arguments) {
            member.write(
                &format!("{}_{}", declared.name, argument.name),
                &value.to_string(),
            );
        }
        member.calls[operation] += 1;
        let number = member.calls[operation];
        member.write(&declared.name, &number.to_string());
        Ok(Ticket {
            component,
            operation,
            number: number.unsigned_abs(),
        })
    }

    fn is_done(&self, ticket: Ticket) -> Result<bool, Refused> {
        let declared = &self.program.members()[ticket.component]
            .component
            .operations[ticket.operation];
        let done = declared.done.as_ref();
        let flag = |name: &String| {
            self.members[ticket.component]
                .value(name)
                .is_some_and(|words| words[0] != 0)
        };
        Ok(done.is_none_or(flag))
    }
}
