//! The user-data conventions of PC and KRL program, from published scripts. FRI itself does not interpret them. Both
//! sides are here: [`super::Dialog`] is the PC's, the emulated KRC runs the scripts.

use super::wire::Control;
use std::fmt;

/// A convention for user data. Indices are those of KRL, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Protocol {
    /// Robot Control Core, `fri2.src`: parameters one by one in FRM_INT\[16\], FRM_INT\[15\] and FRM_REA\[15\] while
    /// FRM_BOOL\[16\], echoed in TO_INT\[16\]; the program stops FRI before and starts it after. Sets strategy, tool and load.
    Rcc,
    /// Stanford and LIRMM: FRM_INT\[16\] 10 starts, 20 stops, 30 or 40 closes; strategy in FRM_INT\[15\]; the state is
    /// returned in TO_INT\[16\] as 10 (MON), 20 (CMD), 30 (closed).
    Stanford,
    /// kuka-lwr: FRM_INT\[2\] 1 starts, 0 stops, echoed in TO_INT\[2\] (10 at the beginning); strategy in FRM_INT\[1\].
    KukaLwr,
    /// TUM and RCPRG: FRM_BOOL\[1\] requests, TO_BOOL\[1\] is busy; FRM_INT\[1\] 1 starts, 2 stops, 3 opens again with the
    /// period FRM_INT\[2\] in ms.
    Tum,
    /// KUKA's demonstration program: FRM_INT\[1\] 10 starts (1 while quality is below OK), FRM_REA\[1\] mirrors TO_REA\[2\];
    /// TO_INT\[1\] -1 when the program has ended.
    FirstApp,
}

impl Protocol {
    /// All conventions.
    pub const ALL: [Self; 5] = [
        Self::Rcc,
        Self::Stanford,
        Self::KukaLwr,
        Self::Tum,
        Self::FirstApp,
    ];
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Rcc => "rcc",
            Self::Stanford => "stanford",
            Self::KukaLwr => "kuka-lwr",
            Self::Tum => "tum",
            Self::FirstApp => "first-app",
        })
    }
}

/// Number of a parameter in [`Protocol::Rcc`].
pub(crate) mod parameter {
    pub(crate) const STRATEGY: i32 = 1;
    /// X, Y, Z, A, B, C.
    pub(crate) const TOOL: i32 = 2;
    pub(crate) const MASS: i32 = 8;
    /// X, Y, Z, A, B, C.
    pub(crate) const CENTRE: i32 = 9;
    /// X, Y, Z.
    pub(crate) const INERTIA: i32 = 15;
    pub(crate) const LAST: i32 = 17;
}

/// `$STIFFNESS.STRATEGY` of a control strategy; `None` for an unspecified one.
pub(crate) fn strategy_number(control: Control) -> Option<i32> {
    match control {
        Control::Position => Some(10),
        Control::CartesianImpedance => Some(20),
        Control::JointImpedance => Some(30),
        Control::Unspecified | Control::Other(_) => None,
    }
}

/// The control strategy of a `$STIFFNESS.STRATEGY`.
#[cfg(feature = "emulator")]
pub(crate) fn strategy_of(number: i32) -> Option<Control> {
    match number {
        10 => Some(Control::Position),
        20 => Some(Control::CartesianImpedance),
        30 => Some(Control::JointImpedance),
        _ => None,
    }
}

/// What the robot carries, `$LOAD`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Load {
    /// kg, from 0.
    pub mass_kg: f32,
    /// Centre of mass X, Y, Z in mm, then the axes of inertia A, B, C in degrees, in the flange frame.
    pub centre: [f32; 6],
    /// Inertia about these axes, kg m2.
    pub inertia: [f32; 3],
}
