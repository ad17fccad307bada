//! Subscription of one client to all devices: tracks what was pushed and finds the changes. It does not call the
//! controller.

use std::collections::BTreeMap;

use takt_client::wire::{Message, Value};
use takt_core::controller::DeviceInfo;

use super::push;

/// A subscription to all devices.
#[derive(Debug)]
pub(super) struct DeviceWatch {
    tag: String,
    reported: BTreeMap<String, Reported>,
}

#[derive(Debug, PartialEq)]
struct Reported {
    /// Type and interfaces, as sent.
    description: Value,
    status: &'static str,
}

impl DeviceWatch {
    /// A new subscription.
    pub(super) const fn new(tag: String) -> Self {
        Self {
            tag,
            reported: BTreeMap::new(),
        }
    }

    /// Pushes for what changed, given all present devices: first those that are new or have other interfaces, then
    /// those that were removed, then those in another state.
    pub(super) fn handle_devices(&mut self, devices: Vec<DeviceInfo>) -> Vec<Message> {
        let now: BTreeMap<_, _> = devices.into_iter().map(describe).collect();
        let described = self.differing(&now, |a, b| a.description == b.description);
        let added = described.map(|(n, t)| (n.clone(), t.description.clone()));
        let added: BTreeMap<_, _> = added.collect();
        let removed: Vec<_> = self
            .reported
            .keys()
            .filter(|n| !now.contains_key(*n))
            .cloned()
            .collect();
        let changed = self.differing(&now, |a, b| a.status == b.status);
        let changed: BTreeMap<_, _> = changed.map(|(n, t)| (n.clone(), t.status.into())).collect();
        let mut out = Vec::new();
        if !added.is_empty() {
            out.push(push(&self.tag, "da", added));
        }
        if !removed.is_empty() {
            out.push(push(&self.tag, "dr", Value::list_of(removed)));
        }
        if !changed.is_empty() {
            out.push(push(&self.tag, "ds", changed));
        }
        self.reported = now;
        out
    }

    /// The devices that are new or differ from what was pushed.
    fn differing<'a>(
        &'a self,
        now: &'a BTreeMap<String, Reported>,
        same: impl Fn(&Reported, &Reported) -> bool + 'a,
    ) -> impl Iterator<Item = (&'a String, &'a Reported)> {
        now.iter()
            .filter(move |(name, new)| !self.reported.get(*name).is_some_and(|t| same(t, new)))
    }
}

fn describe(device: DeviceInfo) -> (String, Reported) {
    let status = device.status.word();
    let interfaces = device
        .interfaces
        .into_iter()
        .map(|(k, v)| (k, Value::map_of(v)));
    let description = Value::map_of([
        ("type", device.kind.into()),
        ("interfaces", Value::map_of(interfaces)),
    ]);
    (
        device.name,
        Reported {
            description,
            status,
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_core::device::DeviceStatus;

    fn arm(joints: u32, status: DeviceStatus) -> DeviceInfo {
        let joints = BTreeMap::from([("jointcount".to_owned(), joints.to_string())]);
        DeviceInfo {
            name: "lwr1".to_owned(),
            kind: "kuka_lwr_sim".to_owned(),
            interfaces: BTreeMap::from([("robotarm".to_owned(), joints)]),
            status,
        }
    }

    fn pushes(watch: &mut DeviceWatch, devices: &[DeviceInfo]) -> Vec<String> {
        watch
            .handle_devices(devices.to_vec())
            .iter()
            .map(Message::to_string)
            .collect()
    }

    #[test]
    fn device_changes_are_pushed_once() {
        use DeviceStatus::{Offline, Operational, SafeOperational};
        let mut watch = DeviceWatch::new("t".to_owned());
        let added = |joints| {
            let interfaces = format!("interfaces:{{robotarm:{{jointcount:\"{joints}\"}}}}");
            format!("t=da({{lwr1:{{{interfaces},type:\"kuka_lwr_sim\"}}}})")
        };
        let state = |word| format!("t=ds({{lwr1:\"{word}\"}})");
        assert_eq!(pushes(&mut watch, &[]), Vec::<String>::new());
        assert_eq!(
            pushes(&mut watch, &[arm(7, Offline)]),
            [added(7), state("off")]
        );
        assert_eq!(pushes(&mut watch, &[arm(7, Operational)]), [state("op")]);
        assert_eq!(
            pushes(&mut watch, &[arm(7, SafeOperational)]),
            [state("safeop")]
        );
        assert_eq!(pushes(&mut watch, &[arm(6, SafeOperational)]), [added(6)]);
        assert_eq!(pushes(&mut watch, &[]), [r#"t=dr(["lwr1"])"#]);
        assert_eq!(
            pushes(&mut watch, &[arm(7, Operational)]),
            [added(7), state("op")]
        );
    }
}
