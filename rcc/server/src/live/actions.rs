//! Parameters and services of the Foxglove WebSocket. Whether a client is admitted was decided before.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::{Value, json};
use takt_core::stop_channel::Origin;
use takt_core::{Controller, NetId};

use crate::live::hub::Hub;
use crate::live::wire::{self, Call};
use crate::site::Counters;

/// Services by number, from 1 on: name, and whether the request names a net.
const SERVICES: [(&str, bool); 4] = [
    ("/takt/net/start", true),
    ("/takt/net/cancel", true),
    ("/takt/net/abort", true),
    ("/takt/stop", false),
];

/// What clients of the Foxglove WebSocket can request.
#[derive(Clone, Debug)]
pub(crate) struct Actions {
    controller: Controller,
    /// Whether services are offered.
    pub(crate) services: bool,
    every: u64,
    hub: Arc<Hub>,
    /// By which clients see that the controller was restarted.
    session: String,
}

impl Actions {
    pub(crate) fn new(controller: Controller, services: bool, every: u64, hub: Arc<Hub>) -> Self {
        let session = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            controller,
            services,
            every,
            hub,
            session: session.map_or(0, |it| it.as_millis()).to_string(),
        }
    }

    /// The first message to a client.
    pub(crate) fn server_info(&self) -> Value {
        wire::server_info(self.services, &self.session)
    }

    pub(crate) const fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// The announcement of the services.
    pub(crate) fn advertise(&self) -> Option<Value> {
        let schema = |properties: Value| {
            let schema = json!({"type": "object", "properties": properties});
            json!({"encoding": "json", "schemaName": "", "schemaEncoding": "jsonschema",
                "schema": schema.to_string()})
        };
        let service = |(number, (name, of_net)): (usize, (&str, bool))| {
            let request = if of_net {
                schema(json!({"net": {"type": "string"}}))
            } else {
                schema(json!({}))
            };
            let response = schema(json!({"ok": {"type": "boolean"}}));
            json!({"id": number + 1, "name": name, "type": name.trim_start_matches('/'),
                "request": request, "response": response, "requestSchema": "", "responseSchema": ""})
        };
        let services = SERVICES.into_iter().enumerate().map(service);
        let services: Vec<_> = services.collect();
        self.services
            .then(|| json!({"op": "advertiseServices", "services": services}))
    }

    /// Executes a call; returns the payload of its response. It may block for some cycles.
    pub(crate) fn call(&self, call: &Call) -> Result<Value, String> {
        if !self.services {
            return Err(
                "services are off\nhint: services = true under [live] of cell.toml".to_owned(),
            );
        }
        let number = usize::try_from(call.service).unwrap_or(0);
        let service = number.checked_sub(1).and_then(|at| SERVICES.get(at));
        let Some((name, of_net)) = service else {
            return Err(format!("there is no service {}", call.service));
        };
        if call.encoding != "json" {
            return Err(format!("{name}: the encoding of requests is json"));
        }
        tracing::info!("{name} is called by a client of live data");
        if !of_net {
            self.controller.stop_switch().stop(Origin::Server);
            return Ok(json!({"ok": true}));
        }
        let request: Value = serde_json::from_slice(&call.payload).unwrap_or_default();
        let net = request.get("net").and_then(Value::as_str);
        let net = net.and_then(|net| net.parse::<NetId>().ok());
        let Some(net) = net else {
            return Err(format!(
                "{name}: the request is such as {{\"net\": \"rpinet0\"}}"
            ));
        };
        let done = match number {
            1 => self.controller.start_net(net),
            2 => self.controller.cancel(net),
            _ => self.controller.abort(net),
        };
        done.map(|()| json!({"ok": true}))
            .map_err(|error| error.to_string())
    }

    /// The parameters of these names; of none, all.
    pub(crate) fn parameters(&self, names: &[String]) -> Vec<Value> {
        let number =
            |name: &str, value: f64| json!({"name": name, "type": "float64", "value": value});
        let count = |name: &str, value: u64| json!({"name": name, "value": value});
        let periods: Vec<_> = self
            .controller
            .threads()
            .iter()
            .map(|it| it.period.as_secs_f64())
            .collect();
        let devices = self.controller.device_details();
        let counters = &self.hub.counters;
        let mut all = vec![
            json!({"name": "takt.version", "value": env!("CARGO_PKG_VERSION")}),
            number("takt.period_s", self.controller.period().as_secs_f64()),
            json!({"name": "takt.thread_periods_s", "type": "float64_array", "value": periods}),
            json!({"name": "takt.stopped", "value": self.controller.is_stopped()}),
            count("takt.live.every", self.every),
            count("takt.live.clients", self.hub.clients() as u64),
            count("takt.live.dropped", Counters::read(&counters.live_dropped)),
            count("takt.live.lost", Counters::read(&counters.live_lost)),
        ];
        for device in devices {
            let name = |what: &str| format!("takt.device.{}.{what}", device.info.name);
            all.push(json!({"name": name("type"), "value": device.info.kind}));
            all.push(count(&name("joints"), device.joints.len() as u64));
            all.push(number(&name("period_s"), device.period.as_secs_f64()));
        }
        all.retain(|it| {
            let name = it.get("name").and_then(Value::as_str);
            names.is_empty() || names.iter().any(|wanted| Some(wanted.as_str()) == name)
        });
        all
    }

    /// Answers an attempt to set parameters: with their values, which stay, and a status.
    pub(crate) fn set_parameters(&self, names: &[String], id: Option<&str>) -> Vec<Value> {
        let text = "parameters are read-only; the cell file has the settings";
        let mut answers = vec![wire::status(wire::Level::Error, text, "takt.parameters")];
        if !names.is_empty() {
            answers.push(wire::parameter_values(&self.parameters(names), id));
        }
        answers
    }
}
