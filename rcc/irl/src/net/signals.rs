//! The part of the net for signals: inputs and outputs of devices, or values of the net, packed into the arrays of
//! `Irl::Program`. A binary signal of a device is its bits, the lowest one first.

use std::fmt::Write as _;

use super::{Binding, Text, signal_key};
use crate::code::Program;
use crate::spec::{Channel, Direction, Signal, SignalKind};

/// Part of the names of the ports of `Irl::Program`.
const fn port(kind: SignalKind) -> &'static str {
    match kind {
        SignalKind::Digital => "Digital",
        SignalKind::Analog => "Analog",
        SignalKind::Binary => "Binary",
    }
}

/// The family of primitives, and that of inputs and outputs of devices.
const fn families(kind: SignalKind) -> (&'static str, &'static str) {
    match kind {
        SignalKind::Digital => ("Core::Boolean", "Bool"),
        SignalKind::Analog => ("Core::Double", "Real"),
        SignalKind::Binary => ("Core::Int", "Bool"),
    }
}

/// The signals of a direction and kind with their numbers, and the elements of their array.
fn signals(
    program: &Program,
    direction: Direction,
    kind: SignalKind,
) -> (Vec<(usize, &Signal)>, u32) {
    let all = program.system.signals.iter().enumerate();
    let fitting = all.filter(|(_, s)| s.direction == direction && s.kind == kind);
    let fitting: Vec<_> = fitting.collect();
    let size = fitting.iter().map(|(_, s)| u32::from(s.channel) + 1).max();
    (fitting, size.unwrap_or(0))
}

/// Ports of a channel that a signal takes.
fn ports(signal: &Signal, channel: &Channel) -> impl Iterator<Item = (u16, u16)> {
    let first = channel.port;
    (0..signal.width()).map(move |bit| (bit, first.saturating_add(bit)))
}

/// The arrays of the inputs of a kind, and which of them have no value, as links of the program.
pub(super) fn inputs(
    net: &mut Text,
    links: &mut String,
    program: &Program,
    binding: &Binding,
    kind: SignalKind,
) {
    let (signals, size) = signals(program, Direction::In, kind);
    let (family, _) = families(kind);
    let name = port(kind);
    if signals.is_empty() {
        return;
    }
    net.line(&format!("in{name}0={family}Array(Size='{size}')"));
    net.line(&format!("no{name}0=Core::BooleanArray(Size='{size}')"));
    for (i, (number, signal)) in signals.iter().enumerate() {
        let next = i + 1;
        let at = signal.channel;
        let value = match binding.channels.get(*number).and_then(Option::as_ref) {
            Some(channel) => read(net, *number, signal, channel),
            None => taken(net, *number, signal, binding),
        };
        // An element of an array cannot be null: an input without a value does not hide the others.
        net.line(&format!("null{number}={family}IsNull(inValue={value})"));
        net.line(&format!(
            "known{number}={family}Conditional(inCondition=null{number}.outValue, inFalse={value})"
        ));
        net.line(&format!(
            "in{name}{next}={family}ArraySet(inArray=in{name}{i}.outArray, inValue=known{number}.outValue, Size='{size}', \
             Index='{at}')"
        ));
        net.line(&format!(
            "no{name}{next}=Core::BooleanArraySet(inArray=no{name}{i}.outArray, inValue=null{number}.outValue, Size='{size}', \
             Index='{at}')"
        ));
    }
    let last = signals.len();
    let _ = write!(
        links,
        "in{name}=in{name}{last}.outArray, in{name}Null=no{name}{last}.outArray, "
    );
}

/// An input of a device; returns its link.
fn read(net: &mut Text, number: usize, signal: &Signal, channel: &Channel) -> String {
    let (_, io) = families(signal.kind);
    let device = &channel.device;
    let from = format!("read{number}");
    if signal.kind != SignalKind::Binary {
        let port = channel.port;
        net.line(&format!(
            "{from}=IO::In{io}(DeviceID='{device}', Port='{port}')"
        ));
        return format!("{from}.outIO");
    }
    let bits = signal.bits;
    net.line(&format!("{from}_0=Core::BooleanArray(Size='{bits}')"));
    for (bit, port) in ports(signal, channel) {
        net.line(&format!(
            "{from}_bit{bit}=IO::In{io}(DeviceID='{device}', Port='{port}')"
        ));
        net.line(&format!(
            "{from}_{}=Core::BooleanArraySet(inArray={from}_{bit}.outArray, inValue={from}_bit{bit}.outIO, Size='{bits}', \
             Index='{bit}')",
            bit + 1
        ));
    }
    net.line(&format!(
        "{from}=Core::BinToDec(inArray={from}_{bits}.outArray, amountBits='{bits}')"
    ));
    format!("{from}.outValue")
}

/// An input that is a value of the net; returns its link.
fn taken(net: &mut Text, number: usize, signal: &Signal, binding: &Binding) -> String {
    let (family, _) = families(signal.kind);
    let key = signal_key(&signal.name);
    let default = if signal.kind == SignalKind::Digital {
        "false"
    } else {
        "0"
    };
    let value = binding.values.get(number).and_then(Option::as_deref);
    let value = value.unwrap_or(default);
    net.line(&format!(
        "read{number}={family}NetcommIn(Key='{key}', Value='{value}')"
    ));
    format!("read{number}.outValue")
}

/// The outputs of a kind: to their devices, and as values of the net.
pub(super) fn outputs(net: &mut Text, program: &Program, binding: &Binding, kind: SignalKind) {
    let (signals, size) = signals(program, Direction::Out, kind);
    let (family, _) = families(kind);
    for (number, signal) in signals {
        net.line(&format!(
            "written{number}={family}ArrayGet(inArray=program.out{}, Size='{size}', Index='{}')",
            port(kind),
            signal.channel
        ));
        if let Some(Some(channel)) = binding.channels.get(number) {
            write(net, number, signal, channel);
        }
        let key = signal_key(&signal.name);
        net.line(&format!(
            "shown{number}={family}NetcommOut(inValue=written{number}.outValue, Key='{key}')"
        ));
    }
}

/// An output of a device.
fn write(net: &mut Text, number: usize, signal: &Signal, channel: &Channel) {
    let (_, io) = families(signal.kind);
    let device = &channel.device;
    if signal.kind != SignalKind::Binary {
        let port = channel.port;
        net.line(&format!(
            "output{number}=IO::Out{io}(inIO=written{number}.outValue, DeviceID='{device}', Port='{port}')"
        ));
        return;
    }
    let bits = signal.bits;
    net.line(&format!(
        "bits{number}=Core::DecToBin(inValue=written{number}.outValue, amountBits='{bits}')"
    ));
    for (bit, port) in ports(signal, channel) {
        net.line(&format!(
            "bit{number}_{bit}=Core::BooleanArrayGet(inArray=bits{number}.outArray, Size='{bits}', Index='{bit}')"
        ));
        net.line(&format!(
            "output{number}_{bit}=IO::Out{io}(inIO=bit{number}_{bit}.outValue, DeviceID='{device}', Port='{port}')"
        ));
    }
}
