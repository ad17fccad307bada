//! `/nets/` and below: lists, loads, shows and controls nets.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_core::controller::{LoadRequest, NetFigures, NetInfo, RejectedInfo, RuleInfo};
use takt_core::net::picture::Graph;
use takt_core::net::{Limits, text, xml};
use takt_core::{Error, NetId, SessionId};

use super::super::Response;
use super::super::element::{Element, Millis};
use super::{Handler, Outcome};
use crate::dio::DESCRIPTION_BYTES_MAX;

/// Most faults shown per net.
const FAULTS_MAX: usize = 20;
/// Most primitives of a net that is drawn.
const DRAWN_MAX: usize = 4000;

impl Handler<'_> {
    pub(super) fn nets(&self) -> Response {
        let controller = self.controller;
        let infos = controller
            .nets()
            .into_iter()
            .filter_map(|n| controller.net(n));
        let rejected = controller.rejected(None);
        let nets = infos.map(|info| {
            let own = rejected.iter().filter(|it| it.net == Some(info.id));
            summary(&info).containing(own.map(rejected_element))
        });
        self.show(&Element::new("nets").containing(nets))
    }

    pub(super) fn load_net(&self) -> Outcome {
        self.load(SessionId::NONE)
    }

    /// Loads the net of a form. A rejected net exists too and shows its faults.
    pub(super) fn load(&self, session: SessionId) -> Outcome {
        let request = LoadRequest {
            text: self.net_text()?,
            session,
            description: self.description()?,
            period: self.period()?,
        };
        let net = self.controller.load(request).map_err(Response::conflict)?;
        Ok(Response::redirect("302 Found", &format!("/nets/{net}/")))
    }

    /// The field `desc`.
    pub(super) fn description(&self) -> Result<String, Response> {
        let text = self.field("desc").unwrap_or_default();
        if text.len() > DESCRIPTION_BYTES_MAX {
            let bound = DESCRIPTION_BYTES_MAX;
            return Err(Response::bad_request(format!(
                "desc has at most {bound} bytes"
            )));
        }
        Ok(text.to_owned())
    }

    /// The field `frequency`, if `useparams` enables it: in Hz, or below 1 the period in s, as in the original. 0 is
    /// the controller's own.
    fn period(&self) -> Result<Option<Duration>, Response> {
        let enabled = self.field("useparams") == Some("1");
        let Some(text) = self.field("frequency").filter(|_| enabled) else {
            return Ok(None);
        };
        let wrong = || Response::bad_request("frequency: a number of Hz is expected, such as 1000");
        let number: f64 = text.trim().parse().map_err(|_| wrong())?;
        let seconds = if number < 1.0 { number } else { 1.0 / number };
        let period = Duration::try_from_secs_f64(seconds).map_err(|_| wrong())?;
        Ok((!period.is_zero()).then_some(period))
    }

    pub(super) fn net(&self, name: &str) -> Outcome {
        let (id, info) = self.find_net(name)?;
        let controller = self.controller;
        let mut net = summary(&info).with("session", info.session);
        if controller.last_values_of_net(id).is_some() {
            net = net.with("last", format!("/nets/{id}/last"));
        }
        let values = controller
            .out_values(id)
            .into_iter()
            .chain(controller.in_values(id));
        let values = values.map(|(key, text)| Element::new("data").with("key", key).value(text));
        let rules = controller.rules_of(id).into_iter().map(|r| rule(&r));
        let rejected = controller.rejected(Some(id)).into_iter();
        let rejected = rejected.map(|it| rejected_element(&it));
        Ok(self.show(
            &net.containing(values)
                .containing(rejected)
                .containing(faults(&info))
                .containing(rules),
        ))
    }

    /// The text of a net, its XML, its statistics or its debug records.
    pub(super) fn net_part(&self, name: &str, part: &str) -> Outcome {
        let (id, info) = self.find_net(name)?;
        match part {
            "dio" => Ok(Response::text("200 OK", &*info.text)),
            "xml" => xml::to_xml(&info.text, &Limits::default())
                .map(Response::xml)
                .map_err(|r| Response::conflict(r.lines(&info.text).join("\n"))),
            "graph" => graph(&info.text),
            "stats" => self.stats(id),
            "debug" => self.debug(name),
            "last" => self.last_of_net(id),
            _ => Err(Response::not_found(
                "a net has dio, xml, graph, stats, last, debug and debugstream",
            )),
        }
    }

    /// The rules of all nets, in the order of their numbers.
    pub(super) fn rules(&self) -> Response {
        let nets = self.controller.nets().into_iter();
        let rules = nets.flat_map(|net| self.controller.rules_of(net));
        let rules: BTreeMap<_, _> = rules.map(|info| (info.id, rule(&info))).collect();
        self.show(&Element::new("rules").containing(rules.into_values()))
    }

    /// The last second of values of a net that failed, and of its devices.
    fn last_of_net(&self, id: NetId) -> Outcome {
        let values = self.controller.last_values_of_net(id);
        let values = values.ok_or_else(|| {
            Response::not_found("last values are kept of the last nets that failed")
        })?;
        Ok(Response::of_kind("text/csv; charset=utf-8", values.csv()))
    }

    /// Writes the values of the form, then executes its action.
    pub(super) fn control_net(&self, name: &str) -> Outcome {
        let (id, _) = self.find_net(name)?;
        for (key, text) in self
            .request
            .form
            .iter()
            .filter(|(k, _)| k.starts_with("in"))
        {
            let known = self.controller.write_in(id, key, text);
            if !known.map_err(Response::bad_request)? {
                return Err(Response::bad_request(format!(
                    "{id} has no input value {key}"
                )));
            }
        }
        let done = match self.field("action") {
            None => Ok(()),
            Some("START") => self.controller.start_net(id),
            Some("CANCEL") => self.controller.cancel(id),
            Some("ABORT") => self.controller.abort(id),
            Some("UNLOAD") => self.controller.unload(id),
            Some(_) => {
                let text = "action: START, CANCEL, ABORT or UNLOAD is expected";
                return Err(Response::bad_request(text));
            }
        };
        done.map_err(error_response)?;
        let location = match self.controller.net(id) {
            Some(_) => format!("/nets/{id}/"),
            None => "/nets/".to_owned(),
        };
        Ok(Response::redirect("303 See Other", &location))
    }

    pub(super) fn find_net(&self, name: &str) -> Result<(NetId, NetInfo), Response> {
        let id = name.parse().ok();
        let found = id.and_then(|id| Some((id, self.controller.net(id)?)));
        found.ok_or_else(|| Response::not_found("there is no such net"))
    }

    /// Evaluation statistics of a net and of its thread, in ms. As in the original, the first number is the shortest
    /// evaluation of the whole net, its root module.
    fn stats(&self, id: NetId) -> Outcome {
        let figures = self.controller.net_figures(id);
        let figures = figures.ok_or_else(|| Response::conflict("the net was never ready"))?;
        let threads = super::metrics::threads(self.controller);
        let thread = threads.iter().find(|t| t.period == figures.thread_period);
        let counts = &figures.counts;
        let total = counts
            .mean
            .saturating_mul(u32::try_from(counts.cycles).unwrap_or(u32::MAX));
        let exec = times("exec", counts.min, counts.mean, counts.max).with("total", ms(total));
        let late = |thread: &super::metrics::Thread| {
            let late = &thread.stats.latency;
            times("latency", late.min, late.mean, late.max)
        };
        let root = module("ROOT")
            .containing([exec])
            .containing(thread.map(late));
        let thread = thread.map(|thread| {
            let exec = &thread.stats.execution;
            module(&thread.name)
                .containing([times("exec", exec.min, exec.mean, exec.max), late(thread)])
        });
        let net = figures_of(Element::new("figures"), &figures);
        Ok(self.show(
            &Element::new("stats")
                .containing([root])
                .containing(thread)
                .containing([net]),
        ))
    }

    /// Statistics of all net threads and of all nets.
    pub(super) fn all_stats(&self) -> Response {
        let controller = self.controller;
        let threads = super::metrics::threads(controller);
        let threads = threads.iter().map(|thread| {
            let stats = &thread.stats;
            let (exec, late) = (&stats.execution, &stats.latency);
            Element::new("thread")
                .with("name", &thread.name)
                .with("period", ms(thread.period))
                .with("cycles", stats.cycles)
                .with("overruns", stats.overruns)
                .containing([
                    times("exec", exec.min, exec.mean, exec.max),
                    times("latency", late.min, late.mean, late.max),
                ])
        });
        let nets = controller.nets().into_iter();
        let nets = nets.filter_map(|id| Some((id, controller.net_figures(id)?)));
        let nets = nets.map(|(id, figures)| {
            let net = Element::new("net").with("uri", format!("/nets/{id}/"));
            let counts = &figures.counts;
            let exec = times("exec", counts.min, counts.mean, counts.max);
            net.containing([figures_of(Element::new("stats"), &figures).containing([exec])])
        });
        self.show(&Element::new("stats").containing(threads).containing(nets))
    }
}

/// A part of a net of which statistics exist.
fn module(name: &str) -> Element {
    Element::new("module").with("name", name)
}

fn figures_of(element: Element, figures: &NetFigures) -> Element {
    let counts = &figures.counts;
    element
        .with("period", ms(figures.period))
        .with("thread", ms(figures.thread_period))
        .with("cycles", counts.cycles)
        .with("overruns", counts.overruns)
        .with("overbudget", counts.over_budget)
        .with("primitives", figures.primitives)
        .with("cost", ms(figures.cost))
        .with("budget", ms(figures.budget))
}

fn times<T: TryInto<Duration> + Copy>(name: &'static str, min: T, mean: T, max: T) -> Element {
    let element = Element::new(name).with("min", ms(min));
    element
        .with("average", ms(mean))
        .with("mean", ms(mean))
        .with("max", ms(max))
}

pub(super) fn ms(time: impl TryInto<Duration>) -> Millis {
    Millis(time.try_into().unwrap_or_default())
}

fn error_response(error: Error) -> Response {
    if matches!(error, Error::NoSuchNet(_)) {
        Response::not_found(error)
    } else {
        Response::conflict(error)
    }
}

pub(super) fn summary(info: &NetInfo) -> Element {
    let net = Element::new("net")
        .with("uri", format!("/nets/{}/", info.id))
        .with("status", info.state())
        .with("desc", &info.description);
    match &info.end {
        Some(end) => net.with("end", end),
        None => net,
    }
}

/// Set-points that are or were rejected.
fn rejected_element(rejected: &RejectedInfo) -> Element {
    let (cause, hint) = rejected
        .text
        .split_once("\nhint: ")
        .unwrap_or((&rejected.text, ""));
    let element = Element::new("rejected")
        .with("device", &rejected.device)
        .with("part", &rejected.part)
        .with("reason", rejected.reason.word())
        .with("ago", ms(takt_core::monotonic() - rejected.since))
        .with("cause", cause)
        .with("hint", hint);
    match rejected.lasted {
        Some(lasted) => element.with("lasted", ms(lasted)),
        None => element,
    }
}

/// The picture of a net.
fn graph(text: &str) -> Outcome {
    let mut faults = Vec::new();
    let graph = Graph::of(&text::parse(text, &Limits::default(), &mut faults));
    if let Some(fault) = faults.first() {
        return Err(Response::conflict(format!("{}", fault.kind)));
    }
    if graph.len() > DRAWN_MAX {
        return Err(Response::conflict(format!(
            "the net has {} primitives; at most {DRAWN_MAX} are drawn\nhint: its text is /nets/<n>/dio",
            graph.len()
        )));
    }
    Ok(Response::of_kind("image/svg+xml", graph.svg()))
}

fn faults(info: &NetInfo) -> Vec<Element> {
    let faults = info.rejection.iter().flat_map(|r| &r.faults);
    let fault = |fault: &takt_core::net::Fault| {
        let (line, column) = fault.location(&info.text);
        Element::new("errorState")
            .with("major", 1)
            .with("minor", fault.kind.minor())
            .with("block", "")
            .text(format!("{line}:{column}: {}", fault.kind))
    };
    faults.take(FAULTS_MAX).map(fault).collect()
}

fn rule(rule: &RuleInfo) -> Element {
    let nets = |name: &'static str, nets: &[NetId]| -> Vec<Element> {
        let net = |id: &NetId| Element::new(name).with("net", id);
        nets.iter().map(net).collect()
    };
    let request = &rule.request;
    let element = Element::new("rule")
        .with("id", rule.id)
        .with("condition", &request.condition)
        .with("state", rule.state.word())
        .with("desc", &request.description);
    let element = match &rule.why {
        Some(why) => element.with("why", why),
        None => element,
    };
    element
        .containing(nets("stop", &request.stop))
        .containing(nets("start", &request.start))
        .containing(nets("cancel", &request.cancel))
}
