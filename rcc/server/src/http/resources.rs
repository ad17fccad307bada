//! The resources and the routing of requests to them. Handlers may block.

pub(super) mod debug;
mod devices;
mod ethercat;
mod eval;
mod flights;
mod geometry;
mod host;
mod interfaces;
mod machines;
mod metrics;
mod modules;
mod nets;
mod probes;
mod sessions;
mod status;
mod stop;

use takt_core::Controller;
use takt_core::net::{Limits, xml};

use super::element::Element;
use super::{Request, Response};
use crate::site::Site;

/// List of the resources, sent with status 404.
const MAP: &str = "Resources: / /status/ /metrics /stats/ /host/ /fleet/ /probes/ /nets/ /rules/ /machines/ /eval/ /sessions/ /types/ \
    /modules/ /modulesdetails/ /devices/ /geometry/ /ethercat/ /extensions/ /flights/ /log/ /stop/ and, for WebSocket, /DirectIO/ and /scope.";

/// A response, or an error response.
type Outcome = Result<Response, Response>;

/// Handles one request.
pub(super) struct Handler<'a> {
    site: &'a Site,
    controller: &'a Controller,
    request: &'a Request,
}

/// Executes a request.
pub(crate) fn respond(site: &Site, request: &Request) -> Response {
    let handler = Handler {
        site,
        controller: &site.controller,
        request,
    };
    let response = handler.route().unwrap_or_else(|response| response);
    if request.is_head {
        response.without_body()
    } else {
        response
    }
}

impl Handler<'_> {
    fn route(&self) -> Outcome {
        let path: Vec<_> = self.request.path.iter().map(String::as_str).collect();
        let (first, rest) = path.split_first().unwrap_or((&"", &[]));
        match (*first, rest, self.request.post) {
            ("", [], false) => Ok(self.page()),
            ("page", path, false) => Self::page_file(path),
            ("stop", [], false) => Ok(self.stop_state()),
            ("stop", [], true) => Ok(self.stop_all()),
            ("stop", ["release"], true) => Ok(self.release_stop()),
            ("status", [], false) => Ok(self.status()),
            ("metrics", [], false) => Ok(self.metrics()),
            ("stats", [], false) => Ok(self.all_stats()),
            ("log", [], false) => Ok(self.log()),
            ("flights", [], false) => Ok(self.flights()),
            ("flights", [], true) => self.request_flight(),
            ("flights", [name], false) => self.flight(name),
            ("extensions", [], false) => Ok(self.show(&Element::new("extensions"))),
            ("extensions", _, true) => Err(Response::text(
                "403 Forbidden",
                "No code is loaded from the network; drivers are part of the controller.\n",
            )),
            (_, [.., "source.java"], false) => Err(Response::not_found(
                "Java sources are not generated; ?format=json describes types and primitives",
            )),
            ("probes", [], false) => Ok(self.probes()),
            ("nets", [], false) => Ok(self.nets()),
            ("nets", [], true) => self.load_net(),
            ("nets", [net], false) => self.net(net),
            ("nets", [net], true) => self.control_net(net),
            ("nets", [net, part], false) => self.net_part(net, part),
            ("machines", [], false) => Ok(self.machines()),
            ("machines", [], true) => self.load_machine(),
            ("machines", [machine], false) => self.machine(machine),
            ("machines", [machine], true) => self.control_machine(machine),
            ("machines", [machine, part @ ..], false) => self.machine_part(machine, part),
            ("ethercat", [], false) => Ok(self.segments()),
            ("ethercat", [segment], false) => self.segment(segment),
            ("ethercat", [segment, slave, kind, rest @ ..], false) => {
                self.slave_part(segment, slave, kind, rest)
            }
            ("geometry", path, false) => self.geometry_part(path),
            ("eval", [], true) => self.evaluate(),
            ("rules", [], false) => Ok(self.rules()),
            (part @ ("host" | "fleet"), [], false) => self.of_host_program(part),
            ("sessions", [], false) => Ok(self.sessions()),
            ("sessions", [], true) => self.open_session(),
            ("sessions", [session], false) => self.session(session),
            ("sessions", [session], true) => self.control_session(session),
            ("types", [], false) => Ok(self.types()),
            ("types", [ty], false) => self.type_named(ty),
            ("modules", [], false) => Ok(self.modules()),
            ("modules", [module], false) => self.module(module),
            ("modulesdetails", [], false) => Ok(self.modules_in_detail()),
            ("devices", [], false) => Ok(self.devices()),
            ("devices", [], true) => self.change_devices(),
            ("devices", [device], false) => self.device(device),
            ("devices", [device, "last"], false) => self.last_of_device(device),
            ("devices", [device, "jog"], false) => self.jog_net(device),
            ("devices", [device, interface], post) => self.interface(device, interface, post),
            ("eval", [], false)
            | (
                "" | "page" | "host" | "fleet" | "rules" | "types" | "modules" | "modulesdetails"
                | "status" | "metrics" | "log" | "probes" | "ethercat" | "geometry",
                _,
                true,
            ) => Err(Response::text(
                "405 Method Not Allowed",
                "This resource does not support this method; use the other of GET and POST.\n",
            )),
            _ => Err(Response::not_found(MAP)),
        }
    }

    fn show(&self, element: &Element) -> Response {
        Response::element(element, self.request.json)
    }

    /// The value of a query field.
    fn query(&self, key: &str) -> Option<&str> {
        let field = self.request.query.iter().find(|(k, _)| k == key);
        field.map(|(_, value)| value.as_str())
    }

    /// The last lines of the log: from number `start` on, those that contain `filter`.
    fn log(&self) -> Response {
        let start = self.query("start").and_then(|n| n.parse().ok());
        let filter = self.query("filter").unwrap_or_default();
        let (lines, next) = self.site.log.lines(start.unwrap_or(0), filter);
        let line =
            |(number, text): (u64, String)| Element::new("line").with("number", number).text(text);
        let log = Element::new("log").with("next", next);
        self.show(&log.containing(lines.into_iter().map(line)))
    }

    /// The value of a form field.
    fn field(&self, key: &str) -> Option<&str> {
        let field = self.request.form.iter().find(|(k, _)| k == key);
        field.map(|(_, value)| value.as_str())
    }

    /// The net of a form, as text or XML.
    fn net_text(&self) -> Result<String, Response> {
        if let Some(text) = self.field("dionet") {
            return Ok(text.to_owned());
        }
        let xml = self.field("rpinet").ok_or_else(|| {
            Response::bad_request("a net is required: dionet=<text> or rpinet=<XML>")
        })?;
        xml::from_xml(xml, &Limits::default()).map_err(Response::bad_request)
    }
}
