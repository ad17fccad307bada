//! A scope: groups of probes, read and searched for a trigger. It is made by the controller, which knows the names, and read by
//! anyone, without a lock.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use super::group::Group;
use super::trigger::{Condition, Engine, Found, GroupSize, Settings, Watch};
use super::{Column, ProbeError, ScopeError, ScopeRequest, TriggerKind, TriggerRequest};
use crate::ids::NetState;
use takt_rt::Nanos;

/// Probes that are sampled in the same cycles.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupInfo {
    /// The net thread that samples them.
    pub thread: String,
    /// Time between two samples.
    pub period: Duration,
    /// Its columns: name, unit, and for states their names by number.
    pub probes: Vec<(String, String, Arc<[String]>)>,
}

/// Rows of a group.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Number of the group.
    pub group: usize,
    /// Number of columns besides the time.
    pub columns: usize,
    /// Samples that were lost before the first row; in a capture, also those between its rows.
    pub lost: u64,
    /// A time, s since the controller's start, and the columns, row after row. Null is the NaN with the bits of
    /// [`NULL`](takt_net::ports::NULL).
    pub values: Vec<f64>,
}

impl Frame {
    /// Number of rows.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.values.len() / (self.columns + 1)
    }

    /// Its rows: the time, s, and the columns.
    pub fn iter(&self) -> impl Iterator<Item = (f64, &[f64])> {
        let rows = self.values.chunks_exact(self.columns + 1);
        rows.filter_map(|row| row.split_first().map(|(time, values)| (*time, values)))
    }
}

/// What a scope reports.
#[derive(Clone, Debug, PartialEq)]
pub enum ScopeEvent {
    /// Rows of a group: as they came, or all those of a capture.
    Frame(Frame),
    /// A trigger was found; its frames follow.
    Triggered {
        /// Time of its row, s.
        time_s: f64,
        /// What happened.
        cause: String,
    },
    /// A probe has no more values.
    Ended {
        /// Its name.
        probe: String,
        /// The cause.
        cause: String,
    },
    /// Samples were lost because the scope was read too late.
    Lost {
        /// Number of the group.
        group: usize,
        /// Number of samples.
        samples: u64,
    },
}

/// A group while a scope is made, with its columns.
#[derive(Debug)]
pub(crate) struct Member {
    pub(crate) thread: String,
    pub(crate) period: Duration,
    pub(crate) group: Group,
    pub(crate) columns: Vec<Column>,
}

/// A scope over some probes.
#[derive(Debug)]
pub struct Scope {
    infos: Vec<GroupInfo>,
    groups: Vec<Group>,
    /// Names of all columns, by group.
    names: Vec<Vec<String>>,
    rejected: Vec<ProbeError>,
    engine: Option<Engine>,
    /// By group, the number of columns that are shown: that of the trigger may come after them.
    shown: Vec<usize>,
    /// Group and column of the trigger's probe, if it is the state of a net.
    watched_net: Option<(usize, usize)>,
    /// Time of the last row, s.
    last_time: f64,
    events: VecDeque<ScopeEvent>,
}

impl Scope {
    /// A scope over these groups, of which `shown` columns are shown. `watched` is the column of the trigger.
    pub(crate) fn new(
        request: &ScopeRequest,
        members: Vec<Member>,
        shown: Vec<usize>,
        watched: Option<(usize, usize)>,
        rejected: Vec<ProbeError>,
    ) -> Result<Self, ScopeError> {
        let every = u32::try_from(request.every).unwrap_or(u32::MAX);
        let info = |(member, shown): (&Member, &usize)| GroupInfo {
            thread: member.thread.clone(),
            period: member.period.saturating_mul(every),
            probes: member
                .columns
                .iter()
                .take(*shown)
                .map(|it| (it.name.clone(), it.unit.clone(), Arc::clone(&it.states)))
                .collect(),
        };
        let infos: Vec<GroupInfo> = members.iter().zip(&shown).map(info).collect();
        let column = |(group, column): (usize, usize)| members.get(group)?.columns.get(column);
        let engine = match (&request.trigger, watched) {
            (Some(trigger), Some(at)) => {
                let settings = settings(request, trigger, at, column(at))?;
                let sizes = infos.iter().zip(&members).map(|(info, member)| GroupSize {
                    columns: member.columns.len(),
                    period_s: info.period.as_secs_f64(),
                });
                Some(Engine::new(settings, &sizes.collect::<Vec<_>>())?)
            }
            _ => None,
        };
        let is_state = |at| column(at).is_some_and(|it| it.name.starts_with("net:"));
        let watched_net = watched.filter(|at| is_state(*at) && engine.is_some());
        let names = members.iter().map(|member| {
            let names = member.columns.iter().map(|it| it.name.clone());
            names.collect()
        });
        let names = names.collect();
        let groups = members.into_iter().map(|member| {
            let mut group = member.group;
            group.begin();
            group
        });
        Ok(Self {
            groups: groups.collect(),
            infos,
            names,
            rejected,
            engine,
            shown,
            watched_net,
            last_time: 0.0,
            events: VecDeque::new(),
        })
    }

    /// Its groups, whose numbers are those of frames.
    #[must_use]
    pub fn groups(&self) -> &[GroupInfo] {
        &self.infos
    }

    /// When the times of a group are 0, on the host's monotonic clock.
    #[must_use]
    pub fn epoch(&self, group: usize) -> Option<Nanos> {
        self.groups.get(group).map(Group::base)
    }

    /// Requested probes that cannot be sampled.
    #[must_use]
    pub fn rejected(&self) -> &[ProbeError] {
        &self.rejected
    }

    /// Whether nothing more comes: mode single has its capture.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.engine.as_ref().is_some_and(Engine::is_done) && self.events.is_empty()
    }

    /// Reads new rows. `now` is a time that does not go back, such as the one since the scope was made. Events that were not
    /// taken are kept: take all of them by [`Self::poll_event`].
    pub fn read(&mut self, now: Duration) {
        let reads: Vec<_> = self.groups.iter_mut().map(Group::read).collect();
        for (group, read) in reads.iter().enumerate() {
            let width = self.groups.get(group).map_or(1, |it| it.columns() + 1);
            let last = read.values.rchunks_exact(width).next();
            if let Some(time) = last.and_then(|row| row.first()) {
                self.last_time = self.last_time.max(*time);
            }
        }
        match &mut self.engine {
            None => {
                for (group, read) in reads.iter().enumerate() {
                    let columns = self.groups.get(group).map_or(0, Group::columns);
                    if !read.values.is_empty() {
                        self.events.push_back(ScopeEvent::Frame(Frame {
                            group,
                            columns,
                            lost: read.lost,
                            values: read.values.clone(),
                        }));
                    } else if read.lost > 0 {
                        let samples = read.lost;
                        self.events.push_back(ScopeEvent::Lost { group, samples });
                    }
                }
            }
            Some(engine) => {
                for (group, read) in reads.iter().enumerate().filter(|(_, it)| it.lost > 0) {
                    let samples = read.lost;
                    self.events.push_back(ScopeEvent::Lost { group, samples });
                }
                let batches = reads.iter().map(|it| (it.lost, it.values.as_slice()));
                engine.handle_rows(&batches.collect::<Vec<_>>(), now.as_secs_f64());
            }
        }
        for (group, read) in reads.into_iter().enumerate() {
            for (source, cause) in read.ended {
                self.end(group, source, &cause, now);
            }
        }
        self.take_found();
    }

    /// Reports the end of a source: once for each of its probes.
    fn end(&mut self, group: usize, source: usize, cause: &str, now: Duration) {
        let Some(names) = self.names.get(group) else {
            return;
        };
        for (column, name) in names.iter().enumerate() {
            let of = self.groups.get(group).and_then(|it| it.source_of(column));
            if of != Some(source) {
                continue;
            }
            if let (true, Some(engine)) =
                (self.watched_net == Some((group, column)), &mut self.engine)
            {
                let over = f64::from(NetState::Terminated as u8);
                engine.handle_value(self.last_time, over, now.as_secs_f64());
                engine.poll(now.as_secs_f64());
            }
            if self.shown.get(group).is_some_and(|shown| column < *shown) {
                self.events.push_back(ScopeEvent::Ended {
                    probe: name.clone(),
                    cause: cause.to_owned(),
                });
            }
        }
    }

    fn take_found(&mut self) {
        let Some(engine) = &mut self.engine else {
            return;
        };
        while let Some(found) = engine.poll_found() {
            match found {
                Found::Trigger(trigger) => self.events.push_back(ScopeEvent::Triggered {
                    time_s: trigger.time_s,
                    cause: trigger.cause,
                }),
                Found::Capture(capture) => {
                    for (group, rows) in capture.groups.into_iter().enumerate() {
                        let columns = self.groups.get(group).map_or(0, Group::columns);
                        let shown = self.shown.get(group).copied().unwrap_or(columns);
                        self.events.push_back(ScopeEvent::Frame(Frame {
                            group,
                            columns: shown,
                            lost: rows.lost,
                            values: without_hidden(rows.values, columns, shown),
                        }));
                    }
                }
            }
        }
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<ScopeEvent> {
        self.events.pop_front()
    }
}

/// The rows without the columns after the shown ones.
fn without_hidden(values: Vec<f64>, columns: usize, shown: usize) -> Vec<f64> {
    if shown == columns {
        return values;
    }
    let rows = values.chunks_exact(columns + 1);
    rows.flat_map(|row| row.iter().take(shown + 1).copied())
        .collect()
}

/// The settings of the engine for a trigger.
fn settings(
    request: &ScopeRequest,
    trigger: &TriggerRequest,
    (group, column): (usize, usize),
    watched: Option<&Column>,
) -> Result<Settings, ScopeError> {
    let (name, states) = watched.map_or((String::new(), Vec::new()), |it| {
        (it.name.clone(), it.states.to_vec())
    });
    let condition = match trigger.on {
        TriggerKind::Above => Condition::Above(trigger.edge()?.0),
        TriggerKind::Below => Condition::Below(trigger.edge()?.0),
        TriggerKind::Rising => {
            let (level, hysteresis) = trigger.edge()?;
            Condition::Rising { level, hysteresis }
        }
        TriggerKind::Falling => {
            let (level, hysteresis) = trigger.edge()?;
            Condition::Falling { level, hysteresis }
        }
        TriggerKind::Inside => {
            let (low, high) = trigger.window()?;
            Condition::Inside { low, high }
        }
        TriggerKind::Outside => {
            let (low, high) = trigger.window()?;
            Condition::Outside { low, high }
        }
        TriggerKind::State => {
            let state = trigger.equals.clone().unwrap_or_default();
            Condition::Becomes(state_number(&name, &states, state)?)
        }
        TriggerKind::Fault => Condition::Increases,
        TriggerKind::Event => Condition::Changes,
        TriggerKind::Overrun => Condition::Positive,
    };
    Ok(Settings {
        watch: Watch {
            group,
            column,
            name,
            states,
            condition,
        },
        mode: request.mode,
        pre_s: request.pre_s,
        post_s: request.post_s,
    })
}

/// The number of a state by its name, or as a number.
#[expect(clippy::cast_precision_loss, reason = "numbers of states")]
fn state_number(probe: &str, states: &[String], state: String) -> Result<f64, ScopeError> {
    let by_name = states.iter().position(|name| *name == state);
    let number: Option<f64> = state.parse().ok().filter(|number: &f64| !number.is_nan());
    by_name
        .map(|number| number as f64)
        .or(number)
        .ok_or_else(|| ScopeError::State {
            probe: probe.to_owned(),
            state,
            known: if states.is_empty() {
                "numbers only".to_owned()
            } else {
                states.join(", ")
            },
        })
}
