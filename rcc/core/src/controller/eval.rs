//! One cycle of a net outside the net thread: what programs use to read devices and to compute
//! kinematics. It starts no net, holds no resource and commands no device.

use std::time::Duration;

use takt_net::netcomm::OutStatus;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, Plan, Rejection, load};

use crate::controller::Controller;
use crate::device::{DeviceTable, Surroundings};

impl Controller {
    /// Checks a net, evaluates its first cycle with the devices as they are now, and returns the
    /// non-null out ports of its root and its out values, as key and text.
    ///
    /// # Errors
    /// If the net has faults.
    pub fn evaluate(&self, text: &str) -> Result<Vec<(String, String)>, Rejection> {
        let devices = self.inner.lock().devices.table.clone();
        let context = LoadContext {
            registry: &self.inner.primitives,
            devices: &Surroundings {
                devices: &devices,
                boxes: |id| self.inner.lock().nets.get(id)?.boxes(),
            },
            period: self.inner.period,
            limits: eval_limits(),
        };
        let mut plan = load(text, &context)?;
        let now = Nanos(takt_rt::monotonic().0);
        let moment = Moment {
            cycle: 1,
            time: now,
            wall: now,
            ..Moment::default()
        };
        self.inner.lock().nets.copy_inter_values(&plan);
        // The image belongs to this call: its commands reach no driver.
        plan.evaluate(&image(&devices), moment);
        let mut values = plan.root_values();
        values.extend(out_values(&plan));
        Ok(values)
    }

    /// The primitives that nets can use.
    #[must_use]
    pub fn registry(&self) -> &takt_net::Registry {
        &self.inner.primitives
    }
}

/// Maximum number of primitives of a net that is evaluated once.
pub const EVAL_PRIMITIVES_MAX: usize = 20_000;

/// Maximum cost bound of a net that is evaluated once.
pub const EVAL_COST_MAX: Duration = Duration::from_millis(50);

/// Limits for a net that is evaluated once, by any client at any time.
fn eval_limits() -> Limits {
    Limits {
        text_bytes: 4 << 20,
        primitives: EVAL_PRIMITIVES_MAX,
        cost: Some(EVAL_COST_MAX),
        memory_bytes: 32 << 20,
        terminate: false,
        ..Limits::default()
    }
}

/// The devices in the state that their drivers published last.
fn image(devices: &DeviceTable) -> Image {
    let image = Image::default();
    for (_, device) in devices.all() {
        device.state().show(&device.place, &image);
    }
    image
}

fn out_values(plan: &Plan) -> Vec<(String, String)> {
    let words: Vec<u64> = plan.outbox_words().collect();
    let entries = plan.outbox().entries().iter();
    let seen = entries.filter(|e| e.report && e.status(&words) != OutStatus::Never);
    seen.map(|entry| {
        let mut text = String::new();
        entry.format(&words, &mut text);
        (entry.key.clone(), text)
    })
    .collect()
}
