//! A robust line through few samples, by medians: the first line of a servo, and the proof that outliers
//! are a step.
//!
//! Not least squares: one late datagram among sixteen would turn that line by more than the noise of all
//! others. The median of all pairwise slopes tolerates four.

/// Samples in a window.
pub(super) const WINDOW: usize = 16;
const PAIRS: usize = WINDOW * (WINDOW - 1) / 2;

/// Samples of an incomplete window, as (ns since some instant, error in ns).
#[derive(Debug, Default, Clone)]
pub(super) struct Window {
    samples: [(f64, f64); WINDOW],
    len: usize,
}

/// The line through a full window.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// Slope of the line.
    pub(super) slope: f64,
    /// Value of the line at the newest sample.
    pub(super) last: f64,
    /// Median of the errors, ns.
    pub(super) median: f64,
    /// Mean deviation of the errors from the line, estimated by the median, ns.
    pub(super) deviation: f64,
    /// From the oldest to the newest sample, ns.
    span: f64,
}

impl Fit {
    /// Mean deviation of a slope due to noise.
    pub(super) fn slope_deviation(&self) -> f64 {
        let samples = WINDOW as f64;
        self.deviation * (12.0 / samples).sqrt() / self.span
    }
}

impl Window {
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// Adds a sample, later than all before. Returns the line if the window is full.
    pub(super) fn push(&mut self, at: f64, error: f64) -> Option<Fit> {
        let slot = self.samples.get_mut(self.len)?;
        *slot = (at, error);
        self.len += 1;
        (self.len == WINDOW).then(|| self.fit())
    }

    fn fit(&self) -> Fit {
        let mut slopes = [0.0; PAIRS];
        let pairs = (1..WINDOW).flat_map(|later| (0..later).map(move |earlier| (earlier, later)));
        for (slope, (earlier, later)) in slopes.iter_mut().zip(pairs) {
            let ((x0, y0), (x1, y1)) = (self.samples[earlier], self.samples[later]);
            *slope = (y1 - y0) / (x1 - x0).max(1.0);
        }
        let slope = median(&mut slopes);
        let newest = self.samples[WINDOW - 1].0;
        let mut heights = self.samples.map(|(x, y)| y + slope * (newest - x));
        let last = median(&mut heights);
        // For white noise, the mean of the deviations is 1.18 times their median.
        let deviation = 1.18 * median(&mut heights.map(|height| (height - last).abs()));
        Fit {
            slope,
            last,
            median: median(&mut self.samples.map(|(_, y)| y)),
            deviation,
            span: (newest - self.samples[0].0).max(1.0),
        }
    }
}

/// Median of an even number of values.
fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    f64::midpoint(values[middle - 1], values[middle])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(error: impl Fn(usize) -> f64) -> Fit {
        let mut window = Window::default();
        let mut fit = None;
        for i in 0..WINDOW {
            assert!(fit.is_none());
            fit = window.push(f64::from(u32::try_from(i).unwrap()) * 1e6, error(i));
        }
        fit.unwrap()
    }

    fn ramp(i: usize) -> f64 {
        50.0 + 100.0 * i as f64
    }

    #[test]
    fn fit_finds_line() {
        let fit = fit(ramp);
        assert!((fit.slope - 1e-4).abs() < 1e-12, "{fit:?}");
        assert!((fit.last - 1550.0).abs() < 1e-6 && (fit.median - 800.0).abs() < 1e-6);
        assert!(fit.deviation < 1e-6);
    }

    #[test]
    fn fit_tolerates_four_outliers() {
        let fit = fit(|i| ramp(i) - if i % 4 == 3 { 5e6 } else { 0.0 });
        assert!((fit.slope - 1e-4).abs() < 1e-9, "{fit:?}");
        assert!((fit.last - 1550.0).abs() < 1.0, "{fit:?}");
    }

    #[test]
    fn window_full_ignores_samples() {
        let mut window = Window::default();
        for _ in 0..WINDOW {
            window.push(1.0, 1e300);
        }
        assert!(window.push(2.0, 0.0).is_none());
        window.clear();
        assert!(window.push(2.0, 0.0).is_none());
        assert_eq!(window.len, 1);
    }
}
