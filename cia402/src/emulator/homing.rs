//! Homing methods 1 to 14, 17 to 30, 33 to 35 and 37 (6098h): a search over switches and the encoder's index pulse.
//! Negative is left, as in the profile. It moves nothing itself, but requests a velocity.

use super::motor::Switches;

/// The switch that a method searches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SwitchKind {
    Negative,
    Positive,
    Home,
}

/// Definition of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Method {
    /// The switch to find; `None` if the index pulse alone counts.
    switch: Option<SwitchKind>,
    /// Direction in which the switch is searched: -1.0 left, 1.0 right.
    seek: i8,
    /// Whether a limit switch reverses the search.
    turns: bool,
    /// Direction in which the edge is finally crossed.
    last: i8,
    /// Whether the switch is on behind that edge.
    on: bool,
    /// Whether the first index pulse behind the edge counts, rather than the edge.
    index: bool,
    /// Whether the present position counts.
    here: bool,
}

impl Method {
    /// The method of that number; `None` for those reserved or of a manufacturer.
    pub const fn new(number: i8) -> Option<Self> {
        const L: i8 = -1;
        const R: i8 = 1;
        let (base, index) = match number {
            1..=14 => (number, true),
            17..=30 => (number - 16, false),
            33 => return Some(Self::index_alone(L)),
            34 => return Some(Self::index_alone(R)),
            35 | 37 => return Some(Self::HERE),
            _ => return None,
        };
        let (switch, seek, turns, last, on) = match base {
            1 => (SwitchKind::Negative, L, false, R, false),
            2 => (SwitchKind::Positive, R, false, L, false),
            3 => (SwitchKind::Home, R, false, L, false),
            4 => (SwitchKind::Home, R, false, R, true),
            5 => (SwitchKind::Home, L, false, R, false),
            6 => (SwitchKind::Home, L, false, L, true),
            7 => (SwitchKind::Home, R, true, L, false),
            8 => (SwitchKind::Home, R, true, R, true),
            9 => (SwitchKind::Home, R, true, L, true),
            10 => (SwitchKind::Home, R, true, R, false),
            11 => (SwitchKind::Home, L, true, R, false),
            12 => (SwitchKind::Home, L, true, L, true),
            13 => (SwitchKind::Home, L, true, R, true),
            _ => (SwitchKind::Home, L, true, L, false),
        };
        Some(Self {
            switch: Some(switch),
            seek,
            turns,
            last,
            on,
            index,
            here: false,
        })
    }

    const HERE: Self = Self {
        switch: None,
        seek: 0,
        turns: false,
        last: 0,
        on: false,
        index: false,
        here: true,
    };

    const fn index_alone(direction: i8) -> Self {
        Self {
            last: direction,
            index: true,
            here: false,
            ..Self::HERE
        }
    }

    fn is_on(&self, switches: Switches) -> bool {
        match self.switch {
            Some(SwitchKind::Negative) => switches.negative,
            Some(SwitchKind::Positive) => switches.positive,
            Some(SwitchKind::Home) => switches.home,
            None => false,
        }
    }
}

/// Inputs of a homing step, in user units and directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct HomingInput {
    pub(super) position: f64,
    pub(super) velocity: f64,
    pub(super) switches: Switches,
    /// Position of an index pulse met in the last step.
    pub(super) index: Option<f64>,
    /// The motor is at rest.
    pub(super) at_rest: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Phase {
    /// Not started, or interrupted.
    #[default]
    Idle,
    /// Fast, until the switch is on.
    Seek {
        direction: i8,
        turned: bool,
    },
    /// Away from the switch, to come back slowly. `seen` once it was on in this direction.
    Leave {
        direction: i8,
        seen: bool,
    },
    /// Slowly over the edge. `seen` once the switch had its state before the edge in this direction.
    Cross {
        seen: bool,
    },
    /// Slowly to the next index pulse.
    Index,
    /// Home is found; stopping.
    Rest {
        home: f64,
    },
    Done,
    Failed,
}

/// A homing run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Homing {
    phase: Phase,
    method: Option<Method>,
}

/// Motion that homing requests in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct HomingRequest {
    /// 6099h:1 rather than 6099h:2.
    pub(super) fast: bool,
    /// -1 left, 0 stop, 1 right.
    pub(super) direction: i8,
    /// Home position, user units, once the motor has stopped: the origin moves now.
    pub(super) home: Option<f64>,
}

impl Homing {
    /// Starts the method of that number; an unknown one fails.
    pub(super) fn start(&mut self, number: i8, input: &HomingInput) {
        self.method = Method::new(number);
        self.phase = match self.method {
            None => Phase::Failed,
            Some(Method { here: true, .. }) => Phase::Rest {
                home: input.position,
            },
            Some(Method { switch: None, .. }) => Phase::Index,
            Some(method) => match (method.is_on(input.switches), method.on) {
                (true, true) => Phase::Leave {
                    direction: -method.last,
                    seen: false,
                },
                (true, false) => Phase::Cross { seen: false },
                (false, _) => Phase::Seek {
                    direction: method.seek,
                    turned: false,
                },
            },
        };
    }

    /// Aborts a running search; a home that was found stays.
    pub(super) fn interrupt(&mut self) {
        if !matches!(self.phase, Phase::Done | Phase::Failed) {
            self.phase = Phase::Idle;
        }
    }

    /// Statusword bits 10, 12 and 13, at rest or moving.
    pub(super) fn bits(&self, at_rest: bool) -> (bool, bool, bool) {
        match self.phase {
            Phase::Idle => (at_rest, false, false),
            Phase::Seek { .. } | Phase::Leave { .. } | Phase::Cross { .. } | Phase::Index => {
                (false, false, false)
            }
            Phase::Rest { .. } => (false, false, false),
            Phase::Done => (true, true, false),
            Phase::Failed => (at_rest, false, true),
        }
    }

    /// One step.
    pub(super) fn step(&mut self, input: &HomingInput) -> HomingRequest {
        let Some(method) = self.method else {
            return HomingRequest::default();
        };
        self.advance(&method, input);
        let go = |fast, direction| HomingRequest {
            fast,
            direction,
            home: None,
        };
        match self.phase {
            Phase::Seek { direction, .. } => go(true, direction),
            Phase::Leave { direction, .. } => go(true, direction),
            Phase::Cross { .. } | Phase::Index => go(false, method.last),
            Phase::Rest { home } if input.at_rest => {
                self.phase = Phase::Done;
                HomingRequest {
                    home: Some(home),
                    ..HomingRequest::default()
                }
            }
            Phase::Idle | Phase::Rest { .. } | Phase::Done | Phase::Failed => {
                HomingRequest::default()
            }
        }
    }

    fn advance(&mut self, method: &Method, input: &HomingInput) {
        let on = method.is_on(input.switches);
        let moves = |direction: i8| input.velocity * f64::from(direction) > 0.0;
        let blocked = |direction: i8| {
            let limit = if direction < 0 {
                input.switches.negative
            } else {
                input.switches.positive
            };
            limit && moves(direction)
        };
        match &mut self.phase {
            Phase::Seek { direction, turned } => {
                if on {
                    self.phase = if method.on {
                        Phase::Leave {
                            direction: -method.last,
                            seen: false,
                        }
                    } else {
                        Phase::Cross { seen: false }
                    };
                } else if blocked(*direction) {
                    if *turned || !method.turns {
                        self.phase = Phase::Failed;
                    } else {
                        (*direction, *turned) = (-*direction, true);
                    }
                }
            }
            Phase::Leave { direction, seen } if moves(*direction) => {
                *seen |= on;
                if *seen && !on {
                    self.phase = Phase::Cross { seen: false };
                } else if blocked(*direction) {
                    self.phase = Phase::Failed;
                }
            }
            Phase::Cross { seen } if moves(method.last) => {
                *seen |= on != method.on;
                if *seen && on == method.on {
                    self.phase = if method.index {
                        Phase::Index
                    } else {
                        Phase::Rest {
                            home: input.position,
                        }
                    };
                } else if blocked(method.last) && method.switch == Some(SwitchKind::Home) {
                    self.phase = Phase::Failed;
                }
            }
            Phase::Index if moves(method.last) => {
                if let Some(home) = input.index {
                    self.phase = Phase::Rest { home };
                } else if blocked(method.last) {
                    self.phase = Phase::Failed;
                }
            }
            Phase::Leave { .. }
            | Phase::Cross { .. }
            | Phase::Index
            | Phase::Idle
            | Phase::Rest { .. }
            | Phase::Done
            | Phase::Failed => {}
        }
    }
}
