//! A net under test: loads children, runs cycles of 1 ms and reads one value as a program would. No
//! device is driven.

use std::time::Duration;

use takt_net::netcomm::OutStatus;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, NoDevices, Plan, Registry, load};

fn try_load(text: &str) -> Result<Plan, Vec<String>> {
    let mut registry = Registry::core();
    registry.add(crate::all());
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    load(text, &context).map_err(|rejection| rejection.lines(text))
}

fn watching(children: &str, ty: &str, value: &str) -> String {
    format!(
        "{{{children},watch={ty}NetcommOut(inValue={value},Key='v'),\
         never=Core::BooleanValue(),outTerminate=never.outValue}}"
    )
}

/// The faults of a net with these children.
pub(crate) fn faults(children: &str, ty: &str, value: &str) -> Vec<String> {
    try_load(&watching(children, ty, value)).expect_err("the net has no faults")
}

/// The texts of out port `value`, of type `ty`, in the first `cycles` cycles.
pub(crate) fn series(children: &str, ty: &str, value: &str, cycles: u64) -> Vec<String> {
    let text = watching(children, ty, value);
    let mut plan = try_load(&text).unwrap_or_else(|faults| panic!("{}", faults.join("\n")));
    let image = Image::default();
    let mut words = vec![0; plan.outbox().words()];
    let mut one = |cycle: u64| {
        let time = Nanos(i64::try_from(cycle).expect("few cycles") * 1_000_000);
        let moment = Moment {
            cycle,
            time,
            wall: time,
            ..Moment::default()
        };
        plan.evaluate(&image, moment);
        plan.export(&mut words);
        let entry = plan.outbox().find("outv").expect("watching made it");
        let mut text = String::new();
        match entry.status(&words) {
            OutStatus::Current => entry.format(&words, &mut text),
            OutStatus::Held | OutStatus::Never => text.push_str("null"),
        }
        text
    };
    (1..=cycles).map(&mut one).collect()
}
