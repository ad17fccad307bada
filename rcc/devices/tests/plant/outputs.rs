//! Outputs after the end of the net that wrote them: held, or at the value configured in the cell, for every ending.

use takt_net::device::Layout;

use super::*;
use takt_core::device::parts;

/// What a net writes.
const CHILDREN: &str = "b=IO::OutBool(IO='true',DeviceID='x'),r=IO::OutReal(IO='2',DeviceID='x')";
/// Endings after which a device with outputs stays connected.
const OF_OUTPUTS: [Ending; 9] = [
    Ending::Itself,
    Ending::Cancel,
    Ending::Abort,
    Ending::Rule,
    Ending::LostClient,
    Ending::Unload,
    Ending::EmergencyStop,
    Ending::Overrun,
    Ending::Shutdown,
];

/// The first truth value and the first number among the outputs of `description` are as `expected` once the net ended that
/// wrote `true` and 2 to them, at most so many milliseconds later, and stay so.
pub(crate) fn outputs_follow_their_policy<P: Plant>(
    description: &DeviceDescription,
    expected: (bool, f64),
    latency: usize,
    plant: P,
) {
    let row = Row {
        name: "outputs",
        description: description.clone(),
        children: [CHILDREN, CHILDREN].map(str::to_owned),
        runs: 0,
        wire: Wire::Positions,
        acceleration: 1.0,
        resolution: 1.0,
        latency: Duration::ZERO,
        creep: 1.0,
        without: |_, _| None,
    };
    let mut layout = Layout::default();
    let has = parts::lay(&description.parts, description.limits.len(), &mut layout);
    let io = has.io.unwrap();
    let shown = |state: &DeviceState| {
        let truth = io.bool_out[0].state.read(&state.signals);
        (truth, io.real_out[0].state.read(&state.signals))
    };
    let mut bench = Bench::new(&row, plant);
    for (id, ending) in (1..).zip(OF_OUTPUTS) {
        let what = format!("{}, {ending:?}", description.kind);
        bench.await_operational(&what);
        let text = net(CHILDREN, 10, (ending == Ending::Itself).then_some(5));
        bench.fixture.try_start(id, &text, 10).unwrap();
        bench.steps(25 + latency);
        if ending != Ending::Itself {
            assert_eq!(
                shown(&bench.state),
                (Some(true), Some(2.0)),
                "{what}: written"
            );
        }
        bench.end(id, ending);
        bench.await_end(id, 200, &what);
        bench.steps(latency);
        let expected = (Some(expected.0), Some(expected.1));
        for _ in 0..20 {
            assert_eq!(shown(&bench.state), expected, "{what}");
            bench.step();
        }
        if ending == Ending::EmergencyStop {
            bench.fixture.set_stop(false);
            bench.steps(20);
            assert_eq!(shown(&bench.state), expected, "{what}: released");
        }
    }
}
