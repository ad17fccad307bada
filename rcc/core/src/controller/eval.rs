//! One cycle of a net outside the net thread: what programs use to read devices and to compute
//! kinematics. It starts nothing, holds nothing and commands nothing.

use takt_net::netcomm::OutStatus;
use takt_net::{Image, Limits, LoadContext, Moment, Nanos, Plan, Registry, Rejection, load};

use crate::controller::Controller;
use crate::device::DeviceTable;

impl Controller {
    /// Checks a net, evaluates its first cycle with the devices as they are now, and returns the
    /// non-null out ports of its root and the values it gives out, as key and text.
    ///
    /// # Errors
    /// If the net has faults.
    pub fn evaluate(&self, text: &str) -> Result<Vec<(String, String)>, Rejection> {
        let devices = self.inner.lock().devices.clone();
        let context = LoadContext {
            registry: &self.inner.registry,
            devices: &devices,
            period: self.inner.period,
            limits: Limits::default(),
        };
        let mut plan = load(text, &context)?;
        let now = Nanos(takt_rt::monotonic().0);
        let moment = Moment {
            cycle: 1,
            time: now,
            wall: now,
            ..Moment::default()
        };
        // The image is this call's own: what is commanded in it reaches no driver.
        plan.evaluate(&image(&devices), moment);
        let mut values = plan.root_values();
        values.extend(out_values(&plan));
        Ok(values)
    }

    /// The primitives that nets can use.
    #[must_use]
    pub fn registry(&self) -> &Registry {
        &self.inner.registry
    }
}

/// The devices as their drivers last told.
fn image(devices: &DeviceTable) -> Image {
    let image = Image::default();
    for (_, arm) in devices.arms() {
        let joints = image.joints.iter().skip(arm.first_joint);
        let told = arm.state().joints;
        for (joint, state) in joints.zip(told).take(arm.limits.len()) {
            joint.state.set(state);
        }
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
