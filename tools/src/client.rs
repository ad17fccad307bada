//! Requests of subcommands to a running controller, over `takt_client`.

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::Context as _;
use takt_client::{Message, Token, Value};

/// A connection to a controller.
#[derive(Debug)]
pub(crate) struct Client {
    inner: takt_client::Client,
    session: String,
}

impl Client {
    /// Connects to an address or Unix socket, or to the controller of this host, giving the token if there is
    /// one.
    pub(crate) fn connect(address: Option<&str>, token: Option<&Token>) -> anyhow::Result<Self> {
        Ok(Self {
            inner: match address {
                Some(address) => takt_client::Client::connect_with(address, token)?,
                None => takt_client::Client::connect_here(token)?,
            },
            session: "s0".to_owned(),
        })
    }

    /// Opens a session, to which nets loaded from now on belong.
    pub(crate) fn open_session(&mut self, description: &str) -> anyhow::Result<()> {
        let reply = self.inner.call("nse", [description])?;
        reply
            .text()
            .context("the controller gave no session")?
            .clone_into(&mut self.session);
        Ok(())
    }

    /// The session to which it loads.
    pub(crate) fn session(&self) -> &str {
        &self.session
    }

    /// Ends the session and all its nets.
    pub(crate) fn end_session(&mut self) -> anyhow::Result<()> {
        self.inner.call("ase", [self.session.as_str()])?;
        Ok(())
    }

    /// Loads a net; returns its identifier, also if it was rejected.
    pub(crate) fn load(&mut self, text: &str, description: &str) -> anyhow::Result<String> {
        let session = self.session.as_str();
        let reply = self.inner.call("nene", [text, session, description])?;
        Ok(reply
            .text()
            .context("the controller gave no net")?
            .to_owned())
    }

    /// What is wrong with a net, a line each; none if it was taken.
    pub(crate) fn faults(&mut self, net: &str) -> anyhow::Result<Vec<String>> {
        let nets = self.describe([net])?;
        let faults = nets
            .into_iter()
            .next()
            .and_then(|(_, mut net)| net.remove("rejection"));
        let Some(Value::List(lines)) = faults else {
            return Ok(Vec::new());
        };
        Ok(lines
            .iter()
            .filter_map(Value::as_str)
            .map(str::to_owned)
            .collect())
    }

    /// Why a net ended, if not by itself.
    pub(crate) fn end_of(&mut self, net: &str) -> anyhow::Result<Option<NetEnd>> {
        let nets = self.describe([net])?;
        Ok(nets.into_iter().next().and_then(|(_, net)| {
            let why = text(&net, "end");
            let successors = net.get("successors").and_then(Value::as_list);
            let successors = successors.unwrap_or_default().iter();
            let successors = successors.filter_map(Value::as_str).map(str::to_owned);
            let successors = successors.collect();
            (!why.is_empty()).then_some(NetEnd { why, successors })
        }))
    }

    /// In values and out values of a net, by their keys on the wire, `in…` and `out…`.
    pub(crate) fn values(&mut self, net: &str) -> anyhow::Result<[BTreeMap<String, String>; 2]> {
        let mut reply = self.call("nva", [net], &[net])?.values.into_iter();
        let mut map = || {
            let Some(Value::Map(values)) = reply.next() else {
                return BTreeMap::new();
            };
            let text = |(key, value): (String, Value)| Some((key, value.as_str()?.to_owned()));
            values.into_iter().filter_map(text).collect()
        };
        Ok([map(), map()])
    }

    /// Writes in values of a net.
    pub(crate) fn write(
        &mut self,
        net: &str,
        values: BTreeMap<String, String>,
    ) -> anyhow::Result<()> {
        let values = Value::map_of([(net, Value::map_of(values))]);
        self.call("snc", [values], &[net])?;
        Ok(())
    }

    /// Records of a net's debug taps from a number on, oldest first. The first call begins the recording.
    pub(crate) fn taps(&mut self, net: &str, from: f64) -> anyhow::Result<TapRecords> {
        let reply = self.call("nta", [Value::from(net), Value::from(from)], &[net])?;
        let taps = TapRecords::of(reply.values);
        taps.context("the controller's records of taps are damaged")
    }

    /// Whether a net has ended for good.
    pub(crate) fn has_ended(&mut self, net: &str) -> anyhow::Result<bool> {
        let nets = self.describe([net])?;
        let state = nets.first().map(|(_, net)| text(net, "state"));
        Ok(state.is_none_or(|state| ["TERMINATED", "UNLOADED"].contains(&state.as_str())))
    }

    /// Calls a command about these nets; that one does not exist is an error with a remedy.
    fn call<V: Into<Value>>(
        &mut self,
        command: &str,
        args: impl IntoIterator<Item = V>,
        nets: &[&str],
    ) -> anyhow::Result<takt_client::Reply> {
        match self.inner.call(command, args) {
            Err(takt_client::Error::Refused { text, .. }) if NO_NET.contains(&text.as_str()) => {
                let known = self.describe([])?;
                let is_missing = |net: &&&str| known.iter().all(|(known, _)| known != **net);
                let missing = nets.iter().find(is_missing).or_else(|| nets.first());
                Err(NoNet(missing.map_or_else(String::new, |net| (*net).to_owned())).into())
            }
            done => Ok(done?),
        }
    }

    /// The last values of a net that failed and of its devices, as a table; empty if it did not fail.
    pub(crate) fn last_values(&mut self, net: &str) -> anyhow::Result<String> {
        let nets = self.describe([net])?;
        let table = nets.first().map(|(_, net)| text(net, "last"));
        Ok(table.unwrap_or_default())
    }

    /// Its set-points that devices rejected, a text each.
    pub(crate) fn rejected(&mut self, net: &str) -> anyhow::Result<Vec<String>> {
        let net = self.describe([net])?.into_iter().next();
        let rejected = net.and_then(|(_, mut net)| net.remove("rejected"));
        let Some(Value::List(lines)) = rejected else {
            return Ok(Vec::new());
        };
        let lines = lines.iter().filter_map(Value::as_str);
        Ok(lines.map(str::to_owned).collect())
    }

    /// The controller's report on nets, or on all of them.
    fn describe<'a>(
        &mut self,
        nets: impl IntoIterator<Item = &'a str>,
    ) -> anyhow::Result<Vec<(String, BTreeMap<String, Value>)>> {
        let nets: Vec<&str> = nets.into_iter().collect();
        let reply = if nets.is_empty() {
            self.inner.call("nin", nets)?
        } else {
            self.call("nin", nets.iter().copied(), &nets)?
        };
        let Some(Value::Map(nets)) = reply.values.into_iter().next() else {
            return Ok(Vec::new());
        };
        let members = |(id, net)| {
            let Value::Map(members) = net else {
                return (id, BTreeMap::new());
            };
            (id, members)
        };
        Ok(nets.into_iter().map(members).collect())
    }

    /// Figures of a net, or of all, in the order in which they were loaded. Those that were never
    /// ready have none.
    pub(crate) fn figures(&mut self, net: Option<&str>) -> anyhow::Result<Vec<NetFigures>> {
        let reply = self.call("nst", net, net.as_slice())?;
        let Some(Value::Map(nets)) = reply.values.into_iter().next() else {
            return Ok(Vec::new());
        };
        let figures = |(id, members)| {
            let figures = match members {
                Value::Map(members) => members.into_iter().filter_map(figure).collect(),
                Value::String(_) | Value::Integer(_) | Value::Float(_) | Value::List(_) => {
                    BTreeMap::new()
                }
            };
            NetFigures { id, figures }
        };
        let mut nets: Vec<_> = nets.into_iter().map(figures).collect();
        nets.sort_by_key(|net| (net.id.len(), net.id.clone()));
        Ok(nets)
    }

    /// Does something with a net.
    pub(crate) fn command(&mut self, command: &str, net: &str) -> anyhow::Result<()> {
        let action = match command {
            "nest" => "start",
            "neca" => "cancel",
            "neab" => "abort",
            "neun" => "unload",
            other => other,
        };
        match self.call(command, [net], &[net]) {
            Err(error) if !error.is::<NoNet>() => {
                Err(error.context(format!("cannot {action} {net}")))
            }
            done => done.map(drop),
        }
    }

    /// Once `condition` holds, ends `stop` and starts `start`; returns the rule's identifier.
    pub(crate) fn schedule(
        &mut self,
        condition: &str,
        stop: Option<&str>,
        start: &str,
    ) -> anyhow::Result<String> {
        let nets = |nets: Option<&str>| Value::list_of(nets.map(Value::from));
        let args = [
            Value::from(condition),
            nets(stop),
            nets(None),
            nets(Some(start)),
            Value::from("takt net schedule"),
        ];
        let named: Vec<&str> = stop.into_iter().chain([start]).collect();
        let reply = self.call("nesc", args, &named)?;
        Ok(reply
            .text()
            .context("the controller gave no rule")?
            .to_owned())
    }

    /// Subscribes to every state of a net, and to its values.
    pub(crate) fn subscribe(&mut self, net: &str, refresh: Duration) -> anyhow::Result<()> {
        let refresh = Value::from(refresh.as_secs_f64());
        let args = [Value::from(net), refresh, Value::from("every")];
        self.call("gne", args, &[net])?;
        Ok(())
    }

    /// The next push, or `None` if none comes in time.
    pub(crate) fn next_push(&mut self, within: Duration) -> anyhow::Result<Option<Message>> {
        Ok(self.inner.next_push(within)?)
    }

    /// A request about machines; returns the values of the reply.
    pub(crate) fn machine(
        &mut self,
        command: &str,
        args: impl IntoIterator<Item = Value>,
    ) -> anyhow::Result<Vec<Value>> {
        Ok(self.inner.call(command, args)?.values)
    }

    /// All nets, in the order in which they were loaded.
    pub(crate) fn nets(&mut self) -> anyhow::Result<Vec<NetInfo>> {
        let nets = self.describe([])?.into_iter();
        let mut nets: Vec<_> = nets
            .map(|(id, net)| NetInfo {
                id,
                state: text(&net, "state"),
                description: text(&net, "description"),
                end: text(&net, "end"),
            })
            .collect();
        nets.sort_by_key(|net| (net.id.len(), net.id.clone()));
        Ok(nets)
    }
}

/// Texts of the protocol for a net that does not exist.
const NO_NET: [&str; 3] = ["invalid net", "invalid netname", "invalidnetname"];

/// There is no such net.
#[derive(Debug, thiserror::Error)]
#[error("there is no net {0}\nhint: `takt net list` shows those that there are")]
pub(crate) struct NoNet(String);

/// How a net ended that did not end by itself.
#[derive(Debug)]
pub(crate) struct NetEnd {
    /// The cause.
    pub(crate) why: String,
    /// The nets that a rule started when it stopped this one.
    pub(crate) successors: Vec<String>,
}

/// Records of debug taps.
#[derive(Debug)]
pub(crate) struct TapRecords {
    /// Number of the record to ask for next.
    pub(crate) next: f64,
    /// Names of the taps, such as `target.inSecond`.
    pub(crate) names: Vec<String>,
    /// The records.
    pub(crate) records: Vec<TapRecord>,
}

/// What one cycle recorded.
#[derive(Debug)]
pub(crate) struct TapRecord {
    /// Its number; gaps are lost records.
    pub(crate) number: f64,
    /// Logical time of the cycle, ns.
    pub(crate) time_ns: i64,
    /// The value of each tap as text; `None` if it was null.
    pub(crate) values: Vec<Option<String>>,
}

impl TapRecords {
    fn of(reply: Vec<Value>) -> Option<Self> {
        let mut reply = reply.into_iter();
        let next = float(&reply.next()?)?;
        let names = reply.next()?;
        let names = names.as_list()?.iter();
        let names = names.map(|name| Some(name.as_str()?.to_owned()));
        let records = reply.nth(1)?;
        let records = records.as_list()?.iter().map(TapRecord::of);
        Some(Self {
            next,
            names: names.collect::<Option<_>>()?,
            records: records.collect::<Option<_>>()?,
        })
    }
}

impl TapRecord {
    fn of(record: &Value) -> Option<Self> {
        let [number, time, values @ ..] = record.as_list()? else {
            return None;
        };
        Some(Self {
            number: float(number)?,
            time_ns: time.as_str()?.parse().ok()?,
            values: values
                .iter()
                .map(|v| v.as_str().map(str::to_owned))
                .collect(),
        })
    }
}

fn float(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some((*number).into()),
        Value::String(_) | Value::List(_) | Value::Map(_) => None,
    }
}

/// An entry of a list of nets.
#[derive(Debug)]
pub(crate) struct NetInfo {
    /// Its identifier, such as rpinet0.
    pub(crate) id: String,
    /// Its last state.
    pub(crate) state: String,
    /// What its program called it.
    pub(crate) description: String,
    /// Why it ended; empty if by itself, or not yet.
    pub(crate) end: String,
}

/// What the evaluation of a net costs, by name: counts, and times in ms.
#[derive(Debug)]
pub(crate) struct NetFigures {
    /// Its identifier, such as rpinet0.
    pub(crate) id: String,
    /// The figures.
    pub(crate) figures: BTreeMap<String, f64>,
}

impl NetFigures {
    /// The figure of that name; not a number if the controller does not report it.
    pub(crate) fn get(&self, name: &str) -> f64 {
        self.figures.get(name).copied().unwrap_or(f64::NAN)
    }
}

fn figure((name, value): (String, Value)) -> Option<(String, f64)> {
    Some((name, float(&value)?))
}

fn text(net: &BTreeMap<String, Value>, key: &str) -> String {
    net.get(key)
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned()
}
