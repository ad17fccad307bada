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
    pub(crate) fn end_of(&mut self, net: &str) -> anyhow::Result<Option<String>> {
        let nets = self.describe([net])?;
        let end = nets.first().map(|(_, net)| text(net, "end"));
        Ok(end.filter(|end| !end.is_empty()))
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
        let reply = self.inner.call("nin", nets)?;
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
        let reply = self.inner.call("nst", net)?;
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
        self.inner
            .call(command, [net])
            .with_context(|| format!("cannot {action} {net}"))?;
        Ok(())
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
        let reply = self.inner.call("nesc", args)?;
        Ok(reply
            .text()
            .context("the controller gave no rule")?
            .to_owned())
    }

    /// Subscribes to every state of a net, and to its values.
    pub(crate) fn subscribe(&mut self, net: &str, refresh: Duration) -> anyhow::Result<()> {
        let refresh = Value::from(refresh.as_secs_f64());
        let args = [Value::from(net), refresh, Value::from("every")];
        self.inner.call("gne", args)?;
        Ok(())
    }

    /// The next push, or `None` if none comes in time.
    pub(crate) fn next_push(&mut self, within: Duration) -> anyhow::Result<Option<Message>> {
        Ok(self.inner.next_push(within)?)
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
    match value {
        Value::Float(number) => Some((name, number)),
        Value::Integer(number) => Some((name, number.into())),
        Value::String(_) | Value::List(_) | Value::Map(_) => None,
    }
}

fn text(net: &BTreeMap<String, Value>, key: &str) -> String {
    net.get(key)
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned()
}
