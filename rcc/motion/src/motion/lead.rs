//! How a motion that starts beside its path, or not along it, comes onto the path: what separates the two is a deviation
//! of several coordinates, each of which comes to rest at zero with bounded jerk. The motion along the path goes on
//! meanwhile, so that nothing stops. The limits of both together are checked by the owner of the path.

use super::bounds::{Bounds, State};
use super::profile::Profile;

/// Instants of a lead at which the speed of the whole is checked.
pub(super) const SAMPLES: usize = 32;

/// A deviation on its way to zero.
pub(super) struct Lead {
    axes: Box<[Profile]>,
    /// Velocities at the checked instants, axis by axis.
    rates: Box<[f64]>,
    /// s.
    duration: f64,
}

impl Lead {
    /// Without deviation.
    pub(super) fn new(axes: usize, period_s: f64) -> Self {
        let none = Bounds {
            velocity: 1.0,
            acceleration: 1.0,
            jerk: 1.0,
        };
        Self {
            axes: (0..axes)
                .map(|_| Profile::new(0.0, none, period_s))
                .collect(),
            rates: vec![0.0; axes * SAMPLES].into(),
            duration: 0.0,
        }
    }

    /// Begins with the deviation `off`, within the bounds of each axis, and those of what brakes. Returns whether there is a plan for all axes; an
    /// axis without one has no deviation from now on.
    pub(super) fn begin(&mut self, off: &[State], bounds: impl Fn(usize) -> [Bounds; 2]) -> bool {
        let mut is_planned = true;
        for (i, (axis, off)) in self.axes.iter_mut().zip(off).enumerate() {
            axis.reset(0.0);
            axis.set_bounds(bounds(i));
            is_planned &= *off == State::default() || axis.begin(*off, 0.0, 1.0);
        }
        let durations = self.axes.iter().map(Profile::duration);
        self.duration = durations.fold(0.0, f64::max);
        for (i, axis) in self.axes.iter().enumerate() {
            for sample in 0..SAMPLES {
                self.rates[sample * self.axes.len() + i] = axis.peek(self.time(sample)).velocity;
            }
        }
        is_planned
    }

    /// Brings the deviation to zero as fast as a stop may, not faster than it was to be.
    pub(super) fn hurry(&mut self) {
        for axis in &mut self.axes {
            axis.hurry();
        }
    }

    /// Ends the deviation at once.
    pub(super) fn reset(&mut self) {
        self.axes.iter_mut().for_each(|axis| axis.reset(0.0));
        self.duration = 0.0;
    }

    /// The time of a checked instant, s.
    pub(super) fn time(&self, sample: usize) -> f64 {
        let share = u32::try_from(sample).map_or(1.0, f64::from) / (SAMPLES - 1) as f64;
        self.duration * share
    }

    /// The velocities of all axes at a checked instant.
    pub(super) fn rates(&self, sample: usize) -> &[f64] {
        let axes = self.axes.len();
        &self.rates[sample * axes..(sample + 1) * axes]
    }

    /// Time until the deviation is zero, at its beginning, s.
    pub(super) const fn duration(&self) -> f64 {
        self.duration
    }

    pub(super) fn advance(&mut self) {
        for axis in &mut self.axes {
            axis.advance();
            // An axis without a plan to zero has braked.
            if axis.is_at_rest() && axis.now().position != 0.0 {
                axis.go_to(0.0, 1.0);
            }
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.axes.iter().all(Profile::is_at_rest)
    }

    /// The deviation of one axis.
    pub(super) fn now(&self, axis: usize) -> State {
        self.axes[axis].now()
    }
}
