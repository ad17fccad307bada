//! The life of a net as the registry sees it, from text to end, as one table. While a net waits or runs, its plan is held
//! by the registry or by its net thread; the thread's own view is `executor::life`.
//!
//! ```text
//! Loading ─▶ Waiting: Registry ─start──▶ Starting ─▶ Running ─▶ (Cancelling) ─▶ Terminated
//!    │                │    ▲─rejected─────┘              ▲
//!    ▼                ▼    └─returned──┐                 │
//! Rejected     handed to rules ──────▶ Rules ─start──▶ StartingFromRules
//! ```

use std::sync::Arc;

use takt_net::Rejection;

use crate::executor::Running;
use crate::ids::NetState;

/// Who holds a net that waits for its start.
#[derive(Debug)]
pub(in crate::controller) enum Holder {
    /// The registry.
    Registry(Box<Running>),
    /// Its thread: a start was requested and is not answered.
    Starting,
    /// Its thread, for rules to start.
    Rules,
    /// Its thread, for rules to start; a start was requested besides and is not answered.
    StartingFromRules,
}

/// State of a net in the registry.
#[derive(Debug)]
pub(in crate::controller) enum Life {
    /// Its text is compiled.
    Loading {
        /// Bytes reserved for it meanwhile.
        reserved: usize,
    },
    /// It has faults.
    Rejected(Arc<Rejection>),
    /// It can be started.
    Waiting {
        holder: Holder,
        /// Whether a rule was to start it.
        is_scheduled: bool,
    },
    /// Its thread evaluates it.
    Running,
    /// Its thread evaluates it, and its cancel was requested.
    Cancelling,
    /// It has ended; `why` unless by itself.
    Terminated { why: Option<String> },
}

/// A change of that state.
#[derive(Debug)]
pub(in crate::controller) enum Change {
    /// Its plan is ready.
    Load(Box<Running>),
    /// It has faults.
    Reject(Rejection),
    /// A client starts it.
    Start,
    /// A rule is to start it.
    HandToRules,
    /// That rule waits in its threads.
    Schedule,
    /// It runs.
    Run,
    /// Its thread rejected its start and returns it.
    RejectStart(Box<Running>),
    /// Rules no longer hold it: its thread returns it.
    Return(Box<Running>),
    /// Its thread received its cancel.
    Cancel,
    /// It ran and has ended.
    End(Option<String>),
    /// It ends without having run, unless its thread holds it.
    GiveUp(&'static str),
}

/// What a change hands to the thread.
#[derive(Debug)]
pub(in crate::controller) enum HandOver {
    /// The net, to be started.
    Start(Box<Running>),
    /// The request to start the net, which it holds.
    StartScheduled,
    /// The net, to be held for rules.
    Schedule(Box<Running>),
}

impl Life {
    /// The state after a change, and what it hands to the thread. A change that does not concern a state has no
    /// effect; a net that comes with it is dropped.
    pub(in crate::controller) fn after(self, change: Change) -> (Self, Option<HandOver>) {
        match self {
            Self::Loading { reserved } => (Self::after_loading(reserved, change), None),
            Self::Waiting {
                holder,
                is_scheduled,
            } => Self::after_waiting(holder, is_scheduled, change),
            Self::Running if matches!(change, Change::Cancel) => (Self::Cancelling, None),
            Self::Running | Self::Cancelling => {
                let Change::End(why) = change else {
                    return (self, None);
                };
                (Self::Terminated { why }, None)
            }
            over @ (Self::Rejected(_) | Self::Terminated { .. }) => (over, None),
        }
    }

    fn after_loading(reserved: usize, change: Change) -> Self {
        if let Change::Load(running) = change {
            let holder = Holder::Registry(running);
            return Self::Waiting {
                holder,
                is_scheduled: false,
            };
        }
        let Change::Reject(rejection) = change else {
            return Self::Loading { reserved };
        };
        Self::Rejected(Arc::new(rejection))
    }

    fn after_waiting(
        holder: Holder,
        is_scheduled: bool,
        change: Change,
    ) -> (Self, Option<HandOver>) {
        let (holder, hand_over) = match (holder, change) {
            (_, Change::Run) => return (Self::Running, None),
            (_, Change::End(why)) => return (Self::Terminated { why }, None),
            (Holder::Registry(_), Change::GiveUp(why)) => {
                let why = Some(why.to_owned());
                return (Self::Terminated { why }, None);
            }
            (holder, Change::Schedule) => {
                let is_scheduled = true;
                let waiting = Self::Waiting {
                    holder,
                    is_scheduled,
                };
                return (waiting, None);
            }
            (Holder::Registry(running), Change::Start) => {
                (Holder::Starting, Some(HandOver::Start(running)))
            }
            (Holder::Rules, Change::Start) => {
                (Holder::StartingFromRules, Some(HandOver::StartScheduled))
            }
            (Holder::Registry(running), Change::HandToRules) => {
                (Holder::Rules, Some(HandOver::Schedule(running)))
            }
            (_, Change::RejectStart(running)) | (Holder::Rules, Change::Return(running)) => {
                (Holder::Registry(running), None)
            }
            // The start that was requested besides follows.
            (Holder::Starting | Holder::StartingFromRules, Change::Return(running)) => {
                (Holder::Starting, Some(HandOver::Start(running)))
            }
            (holder, _) => (holder, None),
        };
        let waiting = Self::Waiting {
            holder,
            is_scheduled,
        };
        (waiting, hand_over)
    }

    /// The state that programs see.
    pub(in crate::controller) const fn state(&self) -> NetState {
        match self {
            Self::Loading { .. } => NetState::Loading,
            Self::Rejected(_) => NetState::Rejected,
            Self::Waiting {
                is_scheduled: false,
                ..
            } => NetState::Ready,
            Self::Waiting {
                is_scheduled: true, ..
            } => NetState::Scheduled,
            Self::Running => NetState::Running,
            Self::Cancelling => NetState::Cancelling,
            Self::Terminated { .. } => NetState::Terminated,
        }
    }

    /// Whether a start is requested and not answered.
    pub(in crate::controller) const fn is_starting(&self) -> bool {
        let Self::Waiting { holder, .. } = self else {
            return false;
        };
        matches!(holder, Holder::Starting | Holder::StartingFromRules)
    }

    /// Whether its thread holds it for rules.
    pub(in crate::controller) const fn is_with_rules(&self) -> bool {
        let Self::Waiting { holder, .. } = self else {
            return false;
        };
        matches!(holder, Holder::Rules | Holder::StartingFromRules)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::tests::net;

    const BRIEF: &str = "{yes=Core::BooleanValue(Value='true'),outTerminate=yes.outValue}";

    fn waiting(holder: Holder) -> Life {
        Life::Waiting {
            holder,
            is_scheduled: false,
        }
    }

    fn life(name: &str) -> Life {
        match name {
            "loading" => Life::Loading { reserved: 7 },
            "rejected" => Life::Rejected(Arc::new(Rejection { faults: Vec::new() })),
            "registry" => waiting(Holder::Registry(net(1, BRIEF))),
            "starting" => waiting(Holder::Starting),
            "rules" => waiting(Holder::Rules),
            "both" => waiting(Holder::StartingFromRules),
            "running" => Life::Running,
            "cancelling" => Life::Cancelling,
            "terminated" => Life::Terminated { why: None },
            name => panic!("{name}"),
        }
    }

    fn name(life: &Life) -> &'static str {
        match life {
            Life::Loading { reserved } => {
                ["lost its memory", "loading"][usize::from(*reserved == 7)]
            }
            Life::Rejected(_) => "rejected",
            Life::Waiting { holder, .. } => match holder {
                Holder::Registry(_) => "registry",
                Holder::Starting => "starting",
                Holder::Rules => "rules",
                Holder::StartingFromRules => "both",
            },
            Life::Running => "running",
            Life::Cancelling => "cancelling",
            Life::Terminated { .. } => "terminated",
        }
    }

    fn change(name: &str) -> Change {
        match name {
            "load" => Change::Load(net(1, BRIEF)),
            "reject" => Change::Reject(Rejection { faults: Vec::new() }),
            "start" => Change::Start,
            "hand-to-rules" => Change::HandToRules,
            "schedule" => Change::Schedule,
            "run" => Change::Run,
            "reject-start" => Change::RejectStart(net(1, BRIEF)),
            "return" => Change::Return(net(1, BRIEF)),
            "cancel" => Change::Cancel,
            "end" => Change::End(None),
            "give-up" => Change::GiveUp("it never ran"),
            name => panic!("{name}"),
        }
    }

    /// By change, the states after it, from each of the states above. `.` is no change, `+` hands the net over to be
    /// started, `*` the request to start it, `>` the net for rules.
    const TABLE: &str = "
                  loading  rejected registry   starting   rules      both       running    cancelling terminated
    load          registry .        .          .          .          .          .          .          .
    reject        rejected .        .          .          .          .          .          .          .
    start         .        .        starting+  .          both*      .          .          .          .
    hand-to-rules .        .        rules>     .          .          .          .          .          .
    schedule      .        .        .          .          .          .          .          .          .
    run           .        .        running    running    running    running    .          .          .
    reject-start  .        .        .          registry   registry   registry   .          .          .
    return        .        .        .          starting+  registry   starting+  .          .          .
    cancel        .        .        .          .          .          .          cancelling .          .
    end           .        .        terminated terminated terminated terminated terminated terminated .
    give-up       .        .        terminated .          .          .          .          .          .";

    #[test]
    fn net_life_in_registry_follows_its_table() {
        let mut lines = TABLE.lines().skip(1).map(str::split_whitespace);
        let states: Vec<_> = lines.next().unwrap().collect();
        let mut cells = 0;
        for mut line in lines {
            let by = line.next().unwrap();
            for (from, to) in states.iter().zip(line) {
                let (after, hand_over) = life(from).after(change(by));
                let sign = match hand_over {
                    None => "",
                    Some(HandOver::Start(_)) => "+",
                    Some(HandOver::StartScheduled) => "*",
                    Some(HandOver::Schedule(_)) => ">",
                };
                let to = if to == "." { *from } else { to };
                assert_eq!(format!("{}{sign}", name(&after)), to, "{from}, {by}");
                cells += 1;
            }
        }
        assert_eq!(cells, 9 * 11);
    }

    #[test]
    fn scheduled_net_stays_scheduled_when_returned() {
        let (ready, _) = life("rules").after(Change::Schedule);
        assert_eq!(ready.state(), NetState::Scheduled);
        let (returned, _) = ready.after(change("return"));
        assert_eq!(returned.state(), NetState::Scheduled);
        let (rejected, _) = returned
            .after(Change::Start)
            .0
            .after(change("reject-start"));
        assert_eq!(rejected.state(), NetState::Scheduled);
    }
}
