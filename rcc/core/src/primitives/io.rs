//! `IO::*`: digital and analogue inputs and outputs of any device.

use takt_net::definition::port;
use takt_net::device::{Io, Output, Signal, Words};
use takt_net::value::text::TextValue;
use takt_net::{Build, Cycle, Definition, Fault, In, NullRule, Out, Primitive, Value};

const DEVICE: &str = "name of the device";
const PORT: &str = "which one, from 0";
const UNKNOWN: NullRule = NullRule::Own("Null while the driver does not know the value.");

/// One of the lists of an I/O device, by the number in parameter `Port`.
fn numbered<T: Copy>(
    b: &mut Build<'_, '_>,
    kind: &'static str,
    list: impl Fn(&Io) -> Vec<T>,
) -> Result<T, Fault> {
    let all = b.interface("DeviceID", kind, |has| {
        let all = list(has.io.as_ref()?);
        (!all.is_empty()).then_some(all)
    })?;
    let number = b.number("Port", 0..=all.len() - 1)?;
    Ok(all[number])
}

struct Read<T> {
    signal: Signal<T>,
    out: Out<T>,
}

impl<T: Value> Primitive for Read<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        self.out.set(cycle, self.signal.get(cycle.image));
    }
}

struct Write<T> {
    value: In<T>,
    output: Output<T>,
}

impl<T: Value + Words> Primitive for Write<T> {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if let Some(value) = self.value.get(cycle)
            && !self.output.command.is_taken(cycle)
        {
            self.output.command.give(cycle, value);
        }
    }
}

/// An output belongs to one running net.
fn write<T: TextValue + Words>(
    b: &mut Build<'_, '_>,
    kind: &'static str,
    resource: &'static str,
    list: fn(&Io) -> Vec<Output<T>>,
) -> Result<Write<T>, Fault> {
    let output = numbered(b, kind, list)?;
    let device = b.text("DeviceID").to_owned();
    let port: i32 = b.value("Port")?;
    b.claim(&device, format!("{device}_{resource}_{port}"));
    b.commands(output.command.target());
    Ok(Write {
        value: b.input("inIO")?,
        output,
    })
}

fn monitor<T: Value>(
    name: &'static str,
    doc: &'static str,
    unit: &'static str,
    kind: &'static str,
    list: fn(&Io) -> Vec<Signal<T>>,
) -> Definition {
    let build = move |b: &mut Build<'_, '_>| -> Result<Read<T>, Fault> {
        Ok(Read {
            signal: numbered(b, kind, list)?,
            out: b.output("outIO"),
        })
    };
    Definition::new(name, doc, build)
        .text("DeviceID", DEVICE)
        .parameter::<i32>("Port", "0", PORT)
        .output::<T>("outIO", unit)
        .null(UNKNOWN)
}

const STAYS: NullRule = NullRule::Own("A null value leaves the output as it is.");

pub(super) fn table() -> Vec<Definition> {
    vec![
        monitor::<bool>(
            "IO::InBool",
            "The state of a digital input.",
            "its state",
            "device with digital inputs",
            |io| io.bool_in.to_vec(),
        ),
        monitor::<f64>(
            "IO::InReal",
            "The value of an analogue input.",
            "its value, in the unit of the device",
            "device with analogue inputs",
            |io| io.real_in.to_vec(),
        ),
        monitor::<bool>(
            "IO::OutBoolSensor",
            "The present state of a digital output, whichever client set it.",
            "its state",
            "device with digital outputs",
            |io| io.bool_out.iter().map(|o| o.state).collect(),
        ),
        monitor::<f64>(
            "IO::OutRealSensor",
            "The present value of an analogue output, whichever client set it.",
            "its value, in the unit of the device",
            "device with analogue outputs",
            |io| io.real_out.iter().map(|o| o.state).collect(),
        ),
        Definition::new(
            "IO::OutBool",
            "Sets a digital output. It stays so when the net ends; of two primitives of a net that \
             set it in one cycle, the first one counts.",
            |b: &mut Build<'_, '_>| {
                write(b, "device with digital outputs", "OutBool", |io| {
                    io.bool_out.to_vec()
                })
            },
        )
        .active()
        .input::<bool>(port("inIO", "state to set").or("IO", "false"))
        .text("DeviceID", DEVICE)
        .parameter::<i32>("Port", "0", PORT)
        .null(STAYS),
        Definition::new(
            "IO::OutReal",
            "Sets an analogue output. It stays so when the net ends; of two primitives of a net \
             that set it in one cycle, the first one counts.",
            |b: &mut Build<'_, '_>| {
                write(b, "device with analogue outputs", "OutReal", |io| {
                    io.real_out.to_vec()
                })
            },
        )
        .active()
        .input::<f64>(port("inIO", "value to set, in the unit of the device").or("IO", "0"))
        .text("DeviceID", DEVICE)
        .parameter::<i32>("Port", "0", PORT)
        .null(STAYS),
    ]
}
