//! Starts that are prepared now and begin at an instant that is known later: a rule whose gate is opened by its holder. What a rule
//! promises holds: resources and cycle time are kept, and a fault, a position jump or a stop of the controller in between ends it.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use takt_rt::Nanos;

use crate::controller::Controller;
use crate::controller::rules::{RuleId, RuleRequest};
use crate::error::Error;
use crate::executor::rules::{Begun, Gate, RuleState};
use crate::ids::{NetId, NetState};

const ONE_PERIOD: &str = "nets that begin at one instant have one period and one net thread; give them the same period, or prepare each by itself";
const WAITS: &str = "it waits for another start already; end that one first";

/// How far a prepared start is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PreparedState {
    /// Resources are kept, and its nets wait.
    Waiting,
    /// Its nets began in this cycle.
    Begun(Begun),
    /// Its nets do not begin, and are free for another start; why.
    Failed(String),
}

/// Nets that wait for the instant of their start. Dropping it before they have begun releases them.
pub struct PreparedStart {
    controller: Controller,
    nets: Vec<NetId>,
    rule: RuleId,
    period: Duration,
    gate: Arc<Gate>,
}

impl fmt::Debug for PreparedStart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PreparedStart")
            .field("nets", &self.nets)
            .field("rule", &self.rule)
            .field("gate", &self.gate)
            .finish_non_exhaustive()
    }
}

impl Controller {
    /// Prepares the start of nets: keeps their resources and their cycle time until they begin at [`PreparedStart::begin_at`], or the
    /// result is dropped.
    ///
    /// # Errors
    /// As [`Self::schedule`]; if the nets have different periods, or there is none.
    pub fn prepare_start(&self, nets: &[NetId], description: &str) -> Result<PreparedStart, Error> {
        let (period, every) = self.inner.common_period(nets)?;
        let gate = Arc::new(Gate::new(period.into(), every));
        let request = RuleRequest {
            condition: "t".to_owned(),
            start: nets.to_vec(),
            description: description.to_owned(),
            ..RuleRequest::default()
        };
        let rule = self.schedule_behind(&request, Some(&gate))?;
        Ok(PreparedStart {
            controller: self.clone(),
            nets: nets.to_vec(),
            rule,
            period,
            gate,
        })
    }
}

impl super::Shared {
    /// The common period of nets, and that in cycles of their thread.
    fn common_period(&self, nets: &[NetId]) -> Result<(Duration, u64), Error> {
        let mut registry = self.lock();
        let mut common = None;
        for id in nets {
            let net = registry.nets.find(*id)?;
            let (thread, state) = (net.thread(), net.state());
            let period = net.counted().map(|counted| counted.period);
            let wrong = |hint| Error::WrongState {
                net: *id,
                state,
                hint,
            };
            let period = period.ok_or_else(|| wrong("only a net that is READY can be started"))?;
            if net.is_away() {
                return Err(wrong(WAITS));
            }
            if *common.get_or_insert((thread, period)) != (thread, period) {
                return Err(wrong(ONE_PERIOD));
            }
        }
        let (thread, period) = common.ok_or(Error::NoNet)?;
        let of_thread = registry.threads.period(thread).unwrap_or(period);
        let every = period.as_nanos() / of_thread.as_nanos().max(1);
        Ok((period, u64::try_from(every).unwrap_or(u64::MAX)))
    }
}

impl PreparedStart {
    /// Period of the nets.
    #[must_use]
    pub const fn period(&self) -> Duration {
        self.period
    }

    /// The nets.
    #[must_use]
    pub fn nets(&self) -> &[NetId] {
        &self.nets
    }

    /// Lets the nets begin in the cycle nearest to this instant of `CLOCK_MONOTONIC`, at most half a period away from it. The first
    /// instant is final. If the net thread misses that cycle, they do not begin.
    pub fn begin_at(&self, at: Nanos) {
        self.gate.open_at(at);
    }

    /// Releases the nets unless they have begun. Returns whether they had not; they then never begin by this.
    #[must_use]
    pub fn release(&self) -> bool {
        self.gate.release()
    }

    /// How far it is.
    #[must_use]
    pub fn state(&self) -> PreparedState {
        if let Some(begun) = self.gate.begun() {
            return PreparedState::Begun(begun);
        }
        let info = self.controller.rule(self.rule);
        match info.as_ref().map(|info| info.state) {
            Some(RuleState::Active | RuleState::Fired) => PreparedState::Waiting,
            Some(RuleState::FireFailed | RuleState::Inactive) | None => {
                let why = info.and_then(|info| info.why);
                let released = "its nets were released, started otherwise, or taken away";
                PreparedState::Failed(why.unwrap_or_else(|| released.to_owned()))
            }
        }
    }

    /// How its nets ended: by themselves, or why not; `None` while one of them has not. To be called once they have begun.
    #[must_use]
    pub fn end(&self) -> Option<Result<(), String>> {
        let mut end = Ok(());
        for id in &self.nets {
            let Some(net) = self.controller.net(*id) else {
                end = Err(format!("{id} was unloaded"));
                continue;
            };
            if net.state() != NetState::Terminated {
                return None;
            }
            if let Some(why) = net.end {
                end = Err(format!("{id}: {why}"));
            }
        }
        Some(end)
    }
}

impl Drop for PreparedStart {
    fn drop(&mut self) {
        // Of nets that have begun, nothing is left to be released.
        let _ = self.gate.release();
    }
}
