//! Joints over time, for the plot: as many samples as a picture can show, however long the demo takes.

use std::time::Duration;

use takt_core::Controller;
use takt_embedded::Machines;

use super::cell::{Arm, positions};

/// How often joints are noted for the plot.
pub(super) const SAMPLE_EVERY: Duration = Duration::from_millis(10);
/// Maximum number of samples. At that number every other one is dropped, and the sampling rate is halved.
const SAMPLES_MAX: usize = 4096;

/// Joints over time.
#[derive(Debug)]
pub(super) struct Samples {
    /// Seconds since the start of the motion.
    pub(super) time_s: Vec<f64>,
    /// By arm and joint: measured position, rad.
    pub(super) joints: Vec<Vec<Vec<f64>>>,
    /// By arm and joint: lowest and highest position of all that were offered.
    ranges: Vec<Vec<[f64; 2]>>,
    /// One of this many samples is kept.
    every: u64,
    offered: u64,
}

impl Samples {
    pub(super) fn of(arms: &[Arm]) -> Self {
        let of_joints = |arm: &Arm| vec![Vec::new(); arm.joints.len()];
        let none = |arm: &Arm| vec![[f64::MAX, f64::MIN]; arm.joints.len()];
        Self {
            time_s: Vec::new(),
            joints: arms.iter().map(of_joints).collect(),
            ranges: arms.iter().map(none).collect(),
            every: 1,
            offered: 0,
        }
    }

    pub(super) fn take(
        &mut self,
        controller: &Controller,
        machines: &Machines,
        arms: &[Arm],
        at: Duration,
    ) {
        let positions = arms.iter().map(|arm| positions(machines, controller, *arm));
        let positions: Vec<_> = positions.collect();
        self.offer(at.as_secs_f64(), &positions);
    }

    fn offer(&mut self, time_s: f64, positions: &[Vec<f64>]) {
        for (ranges, arm) in self.ranges.iter_mut().zip(positions) {
            for ([low, high], position) in ranges.iter_mut().zip(arm) {
                // An unknown position is NaN and changes neither.
                (*low, *high) = (low.min(*position), high.max(*position));
            }
        }
        self.offered += 1;
        if !(self.offered - 1).is_multiple_of(self.every) {
            return;
        }
        if self.time_s.len() >= SAMPLES_MAX {
            self.thin();
        }
        self.time_s.push(time_s);
        for (joints, arm) in self.joints.iter_mut().zip(positions) {
            for (joint, position) in joints.iter_mut().zip(arm) {
                joint.push(*position);
            }
        }
    }

    fn thin(&mut self) {
        self.every *= 2;
        let columns = self.joints.iter_mut().flatten();
        for column in columns.chain([&mut self.time_s]) {
            let mut kept = 0_usize;
            column.retain(|_| {
                kept += 1;
                !kept.is_multiple_of(2)
            });
        }
    }

    /// By arm, how far its farthest joint went, rad.
    pub(super) fn moved(&self) -> Vec<f64> {
        let range = |[low, high]: &[f64; 2]| high - low;
        let farthest = |arm: &Vec<[f64; 2]>| arm.iter().map(range).fold(0.0, f64::max);
        self.ranges.iter().map(farthest).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::cell::Kind;

    #[test]
    fn samples_of_an_hour_stay_bounded() {
        let arms = Kind::Factory.moved();
        let mut samples = Samples::of(arms);
        let positions: Vec<Vec<f64>> = arms
            .iter()
            .map(|arm| vec![0.25; arm.joints.len()])
            .collect();
        // Every 10 ms.
        for number in 0..360_000 {
            samples.offer(f64::from(number) * 0.01, &positions);
        }
        samples.offer(3600.0, &[vec![1.25; 7]]);
        let count = samples.time_s.len();
        assert!((SAMPLES_MAX / 2..=SAMPLES_MAX).contains(&count), "{count}");
        let lengths = samples.joints.iter().flatten().map(Vec::len);
        assert!(
            lengths
                .collect::<Vec<_>>()
                .iter()
                .all(|length| *length == count)
        );
        let gaps = samples.time_s.windows(2).map(|pair| pair[1] - pair[0]);
        let (least, most) = gaps.fold((f64::MAX, 0.0_f64), |(a, b), gap| (a.min(gap), b.max(gap)));
        assert!(most - least < 1e-6, "evenly spaced: {least} to {most}");
        // Samples left out of the picture count, too.
        assert_eq!(samples.moved()[0].to_bits(), 1.0_f64.to_bits());
    }
}
