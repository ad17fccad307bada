//! CAN interfaces: state of the controller, bit rate, recovery, queue.
//!
//! Nodes and frames on the bus are shown by `takt can`.

use super::condition::{Condition, Finding, advice, command};
use super::host::Host;
use super::nic::{CAN, kind};
use super::text::entry;

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::can(
        "can-state",
        state,
        "A controller that is down or off the bus sends nothing; a passive one has met many errors.",
    ),
    Condition::can(
        "can-bitrate",
        bitrate,
        "At another bit rate or sample point than the nodes' every frame is an error.",
    ),
    Condition::can(
        "can-restart",
        restart,
        "A controller in bus-off stays off the bus until it is restarted.",
    ),
    Condition::can(
        "can-queue",
        queue,
        "Set-points of one cycle must fit the queue; the kernel refuses the rest (ENOBUFS).",
    ),
    Condition::can(
        "can-errors",
        errors,
        "The controller counts disturbed and unacknowledged frames.",
    ),
    Condition::can(
        "can-error-reports",
        error_reports,
        "With bus error reports `takt can` shows what disturbs the bus.",
    ),
];

/// The ones that were named and are CAN; if none was named, all.
pub(super) fn interfaces(host: &Host) -> Vec<String> {
    let named = &host.subject.interfaces;
    let candidates = match named.is_empty() {
        true => host.names("/sys/class/net"),
        false => named.clone(),
    };
    candidates
        .into_iter()
        .filter(|interface| kind(host, interface) == Some(CAN))
        .collect()
}

fn facts(host: &Host, interface: &str) -> String {
    host.fact(&format!("can/{interface}")).unwrap_or_default()
}

const VIRTUAL: &str = "virtual, or not reported by its driver";

/// Parameters can be set only while the interface is down.
fn reconfigure(interface: &str, parameters: &str) -> String {
    format!(
        "ip link set {interface} down; ip link set {interface} type can {parameters}; \
         ip link set {interface} up"
    )
}

fn state(host: &Host, interface: &str) -> Finding {
    let facts = facts(host, interface);
    if facts.is_empty() {
        return Finding::skip("the interface was not probed");
    }
    if entry(&facts, "up") != Some("yes") {
        let remedy = match entry(&facts, "state") {
            None => command(format!("ip link set {interface} up")),
            Some(_) => advice(format!(
                "set it up with the bit rate of the nodes: \
                 ip link set {interface} up type can bitrate RATE restart-ms 100"
            )),
        };
        return Finding::fail("down", remedy);
    }
    let wires = "check bit rates, wires and the two terminating resistors (60 ohms between CAN_H \
                 and CAN_L); a lone node gets no acknowledgement";
    match entry(&facts, "state") {
        None => Finding::ok("up, virtual"),
        Some("error-active") => Finding::ok("up, error-active"),
        Some(state @ "bus-off") => Finding::fail(
            state,
            command(format!("ip link set {interface} type can restart")),
        ),
        Some(state @ ("error-warning" | "error-passive")) => Finding::warn(state, advice(wires)),
        Some(state) => Finding::fail(state, command(format!("ip link set {interface} up"))),
    }
}

fn bitrate(host: &Host, interface: &str) -> Finding {
    /// In bit/s; those of CiA 301.
    const RATES: &[u32] = &[
        10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000,
    ];
    let facts = facts(host, interface);
    let number = |key| entry(&facts, key).and_then(|value| value.parse::<u32>().ok());
    let Some(rate) = number("bitrate") else {
        return Finding::skip(match entry(&facts, "state") {
            Some(_) => "none is set",
            None => VIRTUAL,
        });
    };
    let point = number("sample-point");
    let shown = point.map_or_else(
        || "unknown".to_owned(),
        |p| format!("{}.{} %", p / 10, p % 10),
    );
    let read = format!("{} kbit/s, sample point {shown}", rate / 1000);
    let good_point = point.is_none_or(|point| (750..=900).contains(&point));
    if RATES.contains(&rate) && good_point {
        return Finding::ok(read);
    }
    if good_point {
        let remedy = advice(format!(
            "set the bit rate that the nodes have: {}",
            reconfigure(interface, "bitrate RATE")
        ));
        return Finding::warn(read, remedy);
    }
    let parameters = format!("bitrate {rate} sample-point 0.875");
    Finding::warn(read, command(reconfigure(interface, &parameters)))
}

fn restart(host: &Host, interface: &str) -> Finding {
    match entry(&facts(host, interface), "restart-ms") {
        None => Finding::skip(VIRTUAL),
        Some("0") => Finding::warn(
            "not by itself",
            command(reconfigure(interface, "restart-ms 100")),
        ),
        Some(ms) => Finding::ok(format!("after {ms} ms")),
    }
}

/// Set-points and SYNC of a cycle for eight drives of four PDOs each, and a margin.
const QUEUE_MIN: i64 = 64;

fn queue(host: &Host, interface: &str) -> Finding {
    let path = format!("/sys/class/net/{interface}/tx_queue_len");
    match host.number(&path) {
        None => Finding::skip(format!("no {path}")),
        Some(frames) if frames < QUEUE_MIN && is_virtual(host, interface) => {
            Finding::ok(format!("{frames} frames; a virtual bus never fills it"))
        }
        Some(frames) if frames < QUEUE_MIN => {
            let remedy = command(format!("ip link set {interface} txqueuelen 1000"));
            Finding::warn(format!("{frames} frames"), remedy)
                .with_changes(vec![super::condition::change(path, "1000")])
        }
        Some(frames) => Finding::ok(format!("{frames} frames")),
    }
}

fn is_virtual(host: &Host, interface: &str) -> bool {
    let facts = facts(host, interface);
    !facts.is_empty() && entry(&facts, "state").is_none()
}

fn errors(host: &Host, interface: &str) -> Finding {
    let facts = facts(host, interface);
    let number = |key| entry(&facts, key).and_then(|value| value.parse::<u32>().ok());
    let (Some(sent), Some(received)) = (number("tx-errors"), number("rx-errors")) else {
        return Finding::skip(VIRTUAL);
    };
    let read = format!("{sent} sending, {received} receiving");
    if sent == 0 && received == 0 {
        return Finding::ok(read);
    }
    let remedy = command(format!(
        "takt can dump {interface}    # check error frames, then wires"
    ));
    Finding::warn(read, remedy)
}

fn error_reports(host: &Host, interface: &str) -> Finding {
    match entry(&facts(host, interface), "berr-reporting") {
        None => Finding::skip(VIRTUAL),
        Some("on") => Finding::ok("on"),
        Some(_) => Finding::warn("off", command(reconfigure(interface, "berr-reporting on"))),
    }
}
