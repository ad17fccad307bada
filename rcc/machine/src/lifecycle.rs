//! The life cycle of a component, with the states and operations of Orocos. One function holds every transition;
//! loading and unloading of nets happen elsewhere.

use std::fmt;

/// State of a component's life cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Known, not loaded.
    #[default]
    PreOperational,
    /// Loaded and checked; its net does not run.
    Stopped,
    /// Its net is evaluated each period.
    Running,
    /// Its net reported an error and is not evaluated until it recovers or stops.
    RunTimeError,
    /// It cannot continue; only `cleanup` leads out.
    FatalError,
}

impl Phase {
    /// All states.
    pub const ALL: [Self; 5] = [
        Self::PreOperational,
        Self::Stopped,
        Self::Running,
        Self::RunTimeError,
        Self::FatalError,
    ];

    /// The name used in machines: `running`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::PreOperational => "pre_operational",
            Self::Stopped => "stopped",
            Self::Running => "running",
            Self::RunTimeError => "run_time_error",
            Self::FatalError => "fatal_error",
        }
    }

    /// The state after a request.
    ///
    /// | | configure | start | stop | cleanup | recover | error | fatal |
    /// |---|---|---|---|---|---|---|---|
    /// | `PreOperational` | `Stopped` | - | - | - | - | - | `FatalError` |
    /// | `Stopped` | `Stopped` | `Running` | - | `PreOperational` | - | - | `FatalError` |
    /// | `Running` | - | - | `Stopped` | - | - | `RunTimeError` | `FatalError` |
    /// | `RunTimeError` | - | - | `Stopped` | - | `Running` | `RunTimeError` | `FatalError` |
    /// | `FatalError` | - | - | - | `PreOperational` | - | - | `FatalError` |
    ///
    /// `configure` of a stopped component reads its properties again.
    ///
    /// # Errors
    /// If the component is in a state that does not allow the request; it stays there.
    pub const fn after(self, request: Request) -> Result<Self, Unsuitable> {
        match (self, request) {
            (_, Request::Fatal) => Ok(Self::FatalError),
            (Self::PreOperational | Self::Stopped, Request::Configure)
            | (Self::Running | Self::RunTimeError, Request::Stop) => Ok(Self::Stopped),
            (Self::Stopped, Request::Start) | (Self::RunTimeError, Request::Recover) => {
                Ok(Self::Running)
            }
            (Self::Stopped | Self::FatalError, Request::Cleanup) => Ok(Self::PreOperational),
            (Self::Running | Self::RunTimeError, Request::Error) => Ok(Self::RunTimeError),
            (
                phase,
                Request::Configure
                | Request::Start
                | Request::Stop
                | Request::Cleanup
                | Request::Recover
                | Request::Error,
            ) => Err(Unsuitable { phase, request }),
        }
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// What may change the state of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Request {
    /// Load and check its net with its properties.
    Configure,
    /// Begin to evaluate its net, in the next cycle.
    Start,
    /// End the evaluation of its net.
    Stop,
    /// Unload its net.
    Cleanup,
    /// Continue after an error.
    Recover,
    /// Its net reported an error.
    Error,
    /// Its net, or a device of it, cannot continue.
    Fatal,
}

impl Request {
    /// All requests.
    pub const ALL: [Self; 7] = [
        Self::Configure,
        Self::Start,
        Self::Stop,
        Self::Cleanup,
        Self::Recover,
        Self::Error,
        Self::Fatal,
    ];

    /// The name used in machines: `start`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Start => "start",
            Self::Stop => "stop",
            Self::Cleanup => "cleanup",
            Self::Recover => "recover",
            Self::Error => "error",
            Self::Fatal => "fatal",
        }
    }
}

/// A request that the state of the component does not allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{}` is not allowed while the component is {phase}\nhint: {}", .request.word(), self.remedy())]
pub struct Unsuitable {
    /// The state of the component.
    pub phase: Phase,
    /// The request.
    pub request: Request,
}

impl Unsuitable {
    /// What leads from that state to one that allows the request.
    const fn remedy(self) -> &'static str {
        match (self.phase, self.request) {
            (Phase::FatalError, _) => "unload it with `cleanup`, then configure and start it",
            (Phase::PreOperational, Request::Cleanup) => "it is unloaded already",
            (Phase::PreOperational, _) => "configure it first",
            (Phase::RunTimeError, Request::Start) => "continue with `recover`, or stop it first",
            (Phase::Running, Request::Start | Request::Recover) => "it runs already",
            (Phase::Stopped, Request::Stop) => "it is stopped already",
            (Phase::Stopped, _) => "start it first",
            (Phase::Running | Phase::RunTimeError, _) => "stop it first",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Phase::{FatalError, PreOperational, RunTimeError, Running, Stopped};
    use super::{Phase, Request, Unsuitable};

    /// Rows by state, columns by request, as in the documentation.
    const TABLE: [[Option<Phase>; 7]; 5] = {
        const NO: Option<Phase> = None;
        const FATAL: Option<Phase> = Some(FatalError);
        [
            [Some(Stopped), NO, NO, NO, NO, NO, FATAL],
            [
                Some(Stopped),
                Some(Running),
                NO,
                Some(PreOperational),
                NO,
                NO,
                FATAL,
            ],
            [NO, NO, Some(Stopped), NO, NO, Some(RunTimeError), FATAL],
            [
                NO,
                NO,
                Some(Stopped),
                NO,
                Some(Running),
                Some(RunTimeError),
                FATAL,
            ],
            [NO, NO, NO, Some(PreOperational), NO, NO, FATAL],
        ]
    };

    #[test]
    fn life_cycle_every_cell_is_as_documented() {
        for (row, phase) in Phase::ALL.into_iter().enumerate() {
            for (column, request) in Request::ALL.into_iter().enumerate() {
                let expected = TABLE[row][column].ok_or(Unsuitable { phase, request });
                assert_eq!(phase.after(request), expected, "{phase} {request:?}");
            }
        }
    }

    #[test]
    fn life_cycle_refusal_names_state_and_remedy() {
        let text = PreOperational
            .after(Request::Start)
            .unwrap_err()
            .to_string();
        let expected = "`start` is not allowed while the component is pre_operational\n\
                        hint: configure it first";
        assert_eq!(text, expected);
        for phase in Phase::ALL {
            for request in Request::ALL {
                if let Err(refused) = phase.after(request) {
                    assert!(refused.to_string().contains("\nhint: "), "{refused}");
                }
            }
        }
    }
}
