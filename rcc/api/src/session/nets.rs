//! The nets of a session on its controller, and what it pushes about them.

use std::sync::Arc;
use std::time::Duration;

use takt_client::{Message, Reply, Value};

use super::subjects::{Subject, Subjects};
use super::{Session, lock};
use crate::cost::Cost;
use crate::engine::GroupId;
use crate::error::ErrorKind;
use crate::slot::Shared;

/// Least time between two reports of one value of a net. Results are reported with the end of the net in any case.
const REFRESH: f64 = 0.05;

/// The same for what a program listens to.
const LISTENER_REFRESH: f64 = 0.01;

/// Nets have the period of the controller's first net thread.
const CONTROLLER_PERIOD: f64 = 0.0;

/// Most pushes that wait for the reply to their subscription: a few of each one in progress.
const EARLY_MAX: usize = 4096;

impl Session {
    /// Loads the net of an activity that is not begun yet.
    pub(crate) fn load_ahead(&self, text: &str) -> Result<String, ErrorKind> {
        if let Some(lost) = self.engine().lost() {
            return Err(lost);
        }
        let net = self.load(text)?;
        let speed = lock(&self.speed);
        self.slow_down(&net, *speed);
        lock(&self.ahead).insert(net.clone(), None);
        Ok(net)
    }

    /// Why a net that was loaded beforehand cannot be begun.
    pub(crate) fn why_unusable(&self, net: &str) -> Option<String> {
        let known = lock(&self.ahead).get(net).cloned();
        known.unwrap_or_else(|| Some("its net was unloaded".to_owned()))
    }

    /// The engine has nets that were loaded beforehand.
    pub(crate) fn hand_over(&self, nets: &[String]) {
        let mut ahead = lock(&self.ahead);
        nets.iter().for_each(|net| drop(ahead.remove(net)));
    }

    /// Unloads nets that were loaded beforehand.
    pub(crate) fn unload(&self, nets: &[String]) {
        self.hand_over(nets);
        if self.engine().lost().is_some() {
            return;
        }
        // Fails only for a net that is already gone, or with the connection, which the receiver reports.
        nets.iter()
            .for_each(|net| drop(self.client.call("neun", [net.as_str()])));
    }

    /// Loads and starts a net whose values go to a listener.
    pub(crate) fn listen(&self, text: &str, shared: &Arc<Shared>) -> Result<String, ErrorKind> {
        if let Some(lost) = self.engine().lost() {
            return Err(lost);
        }
        let subject = |net| Subject::Listener(net, Arc::clone(shared));
        let net = self.load_for(text, LISTENER_REFRESH, subject)?;
        let started = self.client.call("nest", [net.as_str()]);
        if let Err(error) = started {
            self.unload(std::slice::from_ref(&net));
            return Err(error.into());
        }
        Ok(net)
    }

    /// Ends and unloads the net of a listener.
    pub(crate) fn unlisten(&self, net: &str) {
        if self.engine().lost().is_none() {
            // Fails only for a net that is already gone, or with the connection.
            drop(self.client.call("neab", [net]));
            drop(self.client.call("neun", [net]));
        }
    }

    /// Loads a net of an activity and subscribes to it.
    pub(super) fn load(&self, text: &str) -> Result<String, ErrorKind> {
        self.load_for(text, REFRESH, Subject::Net)
    }

    /// Loads a net and subscribes to it.
    fn load_for(
        &self,
        text: &str,
        refresh: f64,
        subject: impl FnOnce(String) -> Subject,
    ) -> Result<String, ErrorKind> {
        let arguments = [
            Value::from(text),
            self.id.as_str().into(),
            self.program.as_str().into(),
            CONTROLLER_PERIOD.into(),
            Value::Integer(1),
            refresh.into(),
            "every".into(),
        ];
        let reply = self.client.call("nene", arguments)?;
        let net = reply.text().unwrap_or_default().to_owned();
        if reply.values.get(1).and_then(Value::as_str) == Some("REJECTED") {
            let (_, faults) = self.inspect(&net)?;
            self.subscribe(reply.tag, Subject::Rejected);
            self.client.call("neun", [net.as_str()])?;
            return Err(ErrorKind::Rejected(faults));
        }
        self.subscribe(reply.tag, subject(net.clone()));
        Ok(net)
    }

    /// Worst-case cost of a net, which is loaded and unloaded for that.
    pub(crate) fn cost(&self, text: &str) -> Result<Cost, ErrorKind> {
        let reply = self.client.call("nene", [text, &self.id, &self.program])?;
        let net = reply.text().unwrap_or_default().to_owned();
        let cost = self.cost_of(&net);
        self.client.call("neun", [net.as_str()])?;
        cost
    }

    fn cost_of(&self, net: &str) -> Result<Cost, ErrorKind> {
        let (state, faults) = self.inspect(net)?;
        if state == "REJECTED" {
            return Err(ErrorKind::Rejected(faults));
        }
        let reply = self.client.call("nst", [net])?;
        let of_net = reply
            .values
            .first()
            .and_then(|nets| nets.as_map()?.get(net)?.as_map());
        let number = |key: &str| match of_net.and_then(|figures| figures.get(key)) {
            Some(Value::Float(number)) if number.is_finite() && *number >= 0.0 => *number,
            _ => 0.0,
        };
        let ms = |key: &str| Duration::from_secs_f64(number(key).min(1e9) / 1e3);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at least 0; casts saturate"
        )]
        Ok(Cost {
            cycle: ms("cost"),
            period: ms("period"),
            budget: ms("budget"),
            primitives: number("primitives") as u32,
        })
    }

    /// State of a net, and its faults or the reason of its end.
    fn inspect(&self, net: &str) -> Result<(String, Vec<String>), ErrorKind> {
        let reply = self.client.call("nin", [net])?;
        let info = reply
            .values
            .first()
            .and_then(Value::as_map)
            .and_then(|nets| nets.get(net));
        let Some(info) = info.and_then(Value::as_map) else {
            return Ok((String::new(), Vec::new()));
        };
        let text = |key: &str| {
            info.get(key)
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned()
        };
        let faults = info
            .get("rejection")
            .and_then(Value::as_list)
            .unwrap_or_default();
        let mut lines: Vec<_> = faults
            .iter()
            .filter_map(Value::as_str)
            .map(str::to_owned)
            .collect();
        lines.extend(Some(text("end")).filter(|end| !end.is_empty()));
        Ok((text("state"), lines))
    }

    pub(super) fn schedule(
        &self,
        group: GroupId,
        condition: &str,
        stop: &[String],
        start: &[String],
    ) {
        let nets = |nets: &[String]| Value::list_of(nets.iter().map(String::as_str));
        let arguments = [
            Value::from(condition),
            nets(stop),
            nets(&[]),
            nets(start),
            Value::from(self.program.as_str()),
            // Subscribes to the rule.
            Value::Integer(1),
        ];
        let reply = self.client.call("nesc", arguments).map_err(ErrorKind::from);
        let reply = reply.map_err(|error| {
            let is_known = matches!(error, ErrorKind::Conflict { .. });
            let cause = (!is_known).then(|| self.obstacle(start)).flatten();
            cause.unwrap_or(error)
        });
        let rule = |reply: &Reply| reply.text().unwrap_or_default().to_owned();
        let rules = reply.as_ref().map(rule).map_err(Clone::clone);
        self.engine().scheduled(group, rules);
        if let Ok(reply) = reply {
            let rule = Subject::Rule(rule(&reply));
            self.subscribe(reply.tag, rule);
        }
    }

    /// Why nets could not start, as far as the controller knows: another net holds what they need, or the cause.
    fn obstacle(&self, nets: &[String]) -> Option<ErrorKind> {
        nets.iter().find_map(|net| {
            let reply = self.client.call("nin", [net.as_str()]).ok()?;
            let info = reply.values.first()?.as_map()?.get(net)?.as_map()?;
            let holders = info.get("holders").and_then(Value::as_list);
            if let Some(holder) = holders.and_then(|holders| holders.first()?.as_map()) {
                let text = |key: &str| holder.get(key).and_then(Value::as_str).unwrap_or_default();
                let [net, session, program] = ["net", "session", "description"].map(text);
                let mut name = format!("net {net} of session {session}");
                if !program.is_empty() {
                    name.push_str(&format!(" ({program})"));
                }
                return Some(ErrorKind::conflict(text("resource"), Some(name)));
            }
            let cause = info.get("failure").and_then(Value::as_str)?;
            (!cause.is_empty()).then(|| ErrorKind::refused(cause))
        })
    }

    /// Handles the pushes of a subscription from now on, those first that came before its reply.
    fn subscribe(&self, tag: String, subject: Subject) {
        let mut subjects = lock(&self.subjects);
        let early = std::mem::take(&mut subjects.early);
        let (mine, others): (Vec<_>, Vec<_>) = early.into_iter().partition(|push| push.tag == tag);
        subjects.early = others;
        subjects.known.insert(tag, subject);
        for push in mine {
            self.handle_in(&mut subjects, push);
        }
    }

    /// Handles a push, and requests what follows from it.
    pub(super) fn handle(&self, push: Message) {
        self.handle_in(&mut lock(&self.subjects), push);
        self.perform();
    }

    fn handle_in(&self, subjects: &mut Subjects, push: Message) {
        let Some(subject) = subjects.known.get(&push.tag).cloned() else {
            if subjects.early.len() == EARLY_MAX {
                let text = "notifications of no subscription".to_owned();
                return self.engine().lose(&ErrorKind::Lost(text));
            }
            subjects.early.push(push);
            return;
        };
        match (subject, push.command.as_str(), push.args.first()) {
            (Subject::Net(net), "ns", Some(Value::String(state))) => {
                self.note_ahead(&net, state);
                let ended = state == "TERMINATED";
                let reason = if ended {
                    self.inspect(&net).map(|(_, lines)| lines.join("; "))
                } else {
                    Ok(String::new())
                };
                if ended && self.engine().is_in_conflict(&net) {
                    let cause = self.obstacle(std::slice::from_ref(&net));
                    self.engine().name_conflict(&net, cause);
                }
                self.engine()
                    .net_state(&net, state, &reason.unwrap_or_default());
                if state == "UNLOADED" {
                    subjects.known.remove(&push.tag);
                }
            }
            (Subject::Listener(net, shared), "ns", Some(Value::String(state))) => {
                if matches!(state.as_str(), "TERMINATED" | "UNLOADED") {
                    let reason = self.inspect(&net).map(|(_, lines)| lines.join("; "));
                    shared.end(&reason.unwrap_or_default());
                }
                if state == "UNLOADED" {
                    subjects.known.remove(&push.tag);
                }
            }
            (Subject::Listener(_, shared), "nc", Some(Value::Map(values))) => {
                let text = |(key, value): (&String, &Value)| {
                    Some((key.clone(), value.as_str()?.to_owned()))
                };
                shared.update(values.iter().filter_map(text));
            }
            (Subject::Rejected, "ns", Some(Value::String(state))) if state == "UNLOADED" => {
                subjects.known.remove(&push.tag);
            }
            (Subject::Net(net), "nc", Some(Value::Map(values))) => {
                let mut engine = self.engine();
                for (key, text) in values {
                    let key = key.strip_prefix("out").unwrap_or(key);
                    engine.value(&net, key, text.as_str().unwrap_or_default());
                }
            }
            (Subject::Rule(rule), "rs", Some(Value::String(state))) => {
                if state == "FIREFAILED" {
                    let nets = self.engine().nets_of_rule(&rule);
                    let cause = self.obstacle(&nets);
                    self.engine().rule_failed(&rule, cause);
                } else {
                    self.engine().rule_state(&rule, state);
                }
                if state != "ACTIVE" {
                    subjects.known.remove(&push.tag);
                }
            }
            _ => {}
        }
    }

    /// Records that a net that was loaded beforehand is no longer ready.
    fn note_ahead(&self, net: &str, state: &str) {
        if matches!(state, "READY" | "LOADING") {
            return;
        }
        if let Some(why) = lock(&self.ahead).get_mut(net) {
            why.get_or_insert_with(|| format!("its net is {state}"));
        }
    }
}
