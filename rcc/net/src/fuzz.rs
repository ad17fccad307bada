//! Properties that hold for any text from outside, as functions that a fuzzer can call with any
//! bytes and that panic if a property is violated. Inputs are generated elsewhere.

use std::sync::LazyLock;
use std::time::Duration;

use crate::slots::for_element;
use crate::value::Element;
use crate::value::text::{TextValue, format_array, parse_array};
use crate::{
    Image, Limits, LoadContext, Moment, Nanos, NoDevices, Plan, Registry, Rejection, load, xml,
};

/// Small enough that one text costs a fraction of a second at most.
const LIMITS: Limits = Limits {
    terminate: true,
    text_bytes: 1 << 16,
    primitives: 1000,
    depth: 32,
    array_size: 64,
    netcomm: 64,
    cost: None,
    history: 2000,
    memory_bytes: 1 << 20,
};

/// Number of cycles that an accepted net runs.
const CYCLES: u64 = 3;

/// A net text is either rejected with faults that can be rendered, or runs.
///
/// # Panics
/// If a fault lies outside the text, or loading or running panics.
pub fn net_text(data: &[u8]) {
    static REGISTRY: LazyLock<Registry> = LazyLock::new(Registry::core);
    let text = String::from_utf8_lossy(data);
    let context = LoadContext {
        registry: &REGISTRY,
        devices: &NoDevices,
        period: Duration::from_millis(1),
        limits: LIMITS,
    };
    match load(&text, &context) {
        Ok(plan) => run(plan),
        Err(rejection) => show(&rejection, &text),
    }
}

fn run(mut plan: Plan) {
    let image = Image::default();
    for cycle in 1..=CYCLES {
        let time = Nanos(1_000_000 * i64::try_from(cycle).unwrap_or(0));
        let moment = Moment {
            cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        plan.evaluate(&image, moment);
        let mut record = vec![0; plan.record_words()];
        plan.record(time, &mut record);
        for tap in plan.taps().iter() {
            let _ = tap.text(&record);
        }
    }
}

fn show(rejection: &Rejection, text: &str) {
    assert!(!rejection.faults.is_empty(), "rejected for no reason");
    for fault in &rejection.faults {
        let at = &fault.at;
        assert!(at.start <= at.end && at.end <= text.len(), "{fault:?}");
        let (line, column) = fault.location(text);
        assert!(line >= 1 && column >= 1, "{fault:?}");
    }
    assert_eq!(rejection.lines(text).len(), rejection.faults.len());
    assert!(rejection.render("net", text).contains("Error"));
}

/// The XML form of a net is either rejected, or becomes a net text; a text that can be written as
/// XML is read back from it.
///
/// # Panics
/// If that does not hold, or reading or writing panics.
pub fn net_xml(data: &[u8]) {
    let xml = String::from_utf8_lossy(data);
    let Ok(text) = xml::from_xml(&xml, &LIMITS) else {
        return;
    };
    net_text(text.as_bytes());
    if let Ok(written) = xml::to_xml(&text, &LIMITS) {
        let wide = Limits {
            text_bytes: usize::MAX,
            ..LIMITS
        };
        let again = xml::from_xml(&written, &wide);
        assert!(again.is_ok(), "{text} was written as {written}: {again:?}");
    }
}

/// A value that could be read is written in a form that reads back as the same value. The first
/// byte selects the type.
///
/// # Panics
/// If that does not hold, or reading panics.
pub fn value_text(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else {
        return;
    };
    let text = String::from_utf8_lossy(data);
    let element = Element::ALL[usize::from(*choice) % Element::ALL.len()];
    for_element!(element, T => {
        if let Ok(value) = T::parse(&text) {
            again(value, T::parse);
        }
        if let Ok(values) = parse_array::<T>(&text, LIMITS.array_size) {
            let mut written = String::new();
            format_array(values.iter().copied(), &mut written);
            let read = parse_array::<T>(&written, LIMITS.array_size);
            assert_eq!(read.map(|r| r.len()), Ok(values.len()), "{written}");
        }
    });
}

fn again<T: TextValue>(value: T, parse: fn(&str) -> Result<T, crate::value::text::ValueError>) {
    let written = |value: T| {
        let mut text = String::new();
        value.format(&mut text);
        text
    };
    let first = written(value);
    let read = parse(&first);
    assert!(read.is_ok(), "{first} cannot be read again: {read:?}");
    // Angles are recomputed from quaternions and may differ in their last digits.
    if let (Ok(read), false) = (read, has_angles(T::ELEMENT)) {
        assert_eq!(written(read), first);
    }
}

const fn has_angles(element: Element) -> bool {
    matches!(element, Element::Rotation | Element::Frame)
}
