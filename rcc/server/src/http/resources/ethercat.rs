//! `/ethercat/`: the segments of the controller while it runs, as JSON: states, working counters, lost frames, port errors,
//! clocks and history; objects and registers through the running master. It writes nothing.

use serde_json::{Value, json};
use takt_core::device::bus::{BusAccess, BusError, BusRead};

use super::super::Response;
use super::{Handler, Outcome};

use std::sync::Arc;

/// Bytes of a register access without `?len=`.
const REGISTER_LEN: u16 = 2;

impl Handler<'_> {
    fn buses(&self) -> Vec<Arc<dyn BusAccess>> {
        let mut buses = self.controller.buses();
        buses.retain(|bus| bus.kind() == "ethercat");
        buses
    }

    /// All segments; one that does not answer is listed with its error.
    pub(super) fn segments(&self) -> Response {
        let reported = |bus: &Arc<dyn BusAccess>| {
            bus.report().unwrap_or_else(
                |error| json!({ "segment": bus.name(), "error": error.to_string() }),
            )
        };
        let segments: Vec<Value> = self.buses().iter().map(reported).collect();
        shown(&json!({ "version": 1, "segments": segments }))
    }

    /// A segment by its name or an interface.
    pub(super) fn segment(&self, name: &str) -> Outcome {
        let report = self.find_bus(name)?.report().map_err(failed)?;
        Ok(shown(&report))
    }

    fn find_bus(&self, name: &str) -> Result<Arc<dyn BusAccess>, Response> {
        let buses = self.buses();
        let known: Vec<&str> = buses.iter().map(|bus| bus.name()).collect();
        let known = known.join(", ");
        let at = |bus: &&Arc<dyn BusAccess>| bus.name() == name || bus.is_at(name);
        buses.iter().find(at).cloned().ok_or_else(|| {
            Response::not_found(format!("there is no segment `{name}`; segments: {known}"))
        })
    }

    /// `sdo/INDEX/SUB` or `reg/ADDRESS?len=N` of a slave.
    pub(super) fn slave_part(
        &self,
        segment: &str,
        slave: &str,
        kind: &str,
        rest: &[&str],
    ) -> Outcome {
        let bus = self.find_bus(segment)?;
        let what = match (kind, rest) {
            ("sdo", [index]) => BusRead::Object {
                index: hexadecimal(index)?,
                sub: 0,
            },
            ("sdo", [index, sub]) => BusRead::Object {
                index: hexadecimal(index)?,
                sub: u8::try_from(hexadecimal(sub)?).map_err(Response::bad_request)?,
            },
            ("reg", [at]) => BusRead::Register {
                at: hexadecimal(at)?,
                len: self.register_len()?,
            },
            _ => {
                let paths = "sdo/INDEX/SUB and reg/ADDRESS?len=N, hexadecimal";
                return Err(Response::not_found(format!("of a slave there are {paths}")));
            }
        };
        let bytes = bus.read(slave, what).map_err(failed)?;
        Ok(shown(
            &json!({ "version": 1, "slave": slave, "bytes": bytes }),
        ))
    }

    fn register_len(&self) -> Result<u16, Response> {
        let Some(len) = self.query("len") else {
            return Ok(REGISTER_LEN);
        };
        let len = len.parse().ok().filter(|len| (1..=128).contains(len));
        len.ok_or_else(|| Response::bad_request("len: 1 to 128 bytes"))
    }
}

fn hexadecimal(text: &str) -> Result<u16, Response> {
    let digits = text.trim_start_matches("0x").trim_end_matches('h');
    u16::from_str_radix(digits, 16)
        .map_err(|_| Response::bad_request(format!("`{text}` is not a hexadecimal number")))
}

fn failed(error: BusError) -> Response {
    match error {
        BusError::NoSuch(why) => Response::not_found(why),
        BusError::Failed(why) => Response::conflict(why),
    }
}

fn shown(value: &Value) -> Response {
    Response::of_kind("application/json", value.to_string())
}
