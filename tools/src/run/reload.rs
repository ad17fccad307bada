//! Reload of a changed `cell.toml` in a running controller: changes applied at once, and changes that need a restart.
//! A device that a running net uses stays as it is.

use std::sync::Arc;

use takt_core::cell::{ControllerConfig, DriverKind, Section};
use takt_core::device::driver::DriverConfig;
use takt_core::{CellConfig, Controller};
use takt_devices::DRIVERS;

/// The difference of two cells.
#[derive(Debug, Default, PartialEq)]
struct Changes {
    /// Names of devices that are removed or changed; changed ones are added again.
    removed: Vec<String>,
    /// Devices to add.
    new: Vec<Arc<dyn DriverConfig>>,
    /// Whether what is logged changes.
    log: bool,
    /// Settings that only a restart changes.
    restart: Vec<&'static str>,
}

impl Changes {
    fn between(old: &CellConfig, new: &CellConfig) -> Self {
        let missing =
            |from: &CellConfig, device: &&Arc<dyn DriverConfig>| !from.devices.contains(device);
        let removed = old.devices.iter().filter(|device| missing(new, device));
        let added = new.devices.iter().filter(|device| missing(old, device));
        Self {
            removed: removed.map(|device| device.name().to_owned()).collect(),
            new: added.cloned().collect(),
            log: old.controller.log != new.controller.log,
            restart: for_restart(old, new),
        }
    }
}

/// Settings of the controller that differ and cannot change while it runs.
fn for_restart(old: &CellConfig, new: &CellConfig) -> Vec<&'static str> {
    let mut names = Vec::new();
    let mut same = |name, same: bool| {
        if !same {
            names.push(name);
        }
    };
    for kind in DRIVERS {
        if let Section::Bus(name) = kind.section() {
            same(name, buses(old, kind).eq(buses(new, kind)));
        }
    }
    same("[live]", old.live == new.live);
    same("[fleet]", old.fleet == new.fleet);
    let (old, new) = (&old.controller, &new.controller);
    same("period", old.period == new.period);
    same("priority", old.priority == new.priority);
    same("cpus", old.cpus == new.cpus);
    same("websocket", old.websocket == new.websocket);
    same("tcp", old.tcp == new.tcp);
    // All other settings.
    let rest = ControllerConfig {
        log: old.log.clone(),
        ..new.clone()
    };
    if names.is_empty() && rest != *old {
        names.push("[controller]");
    }
    names
}

/// The buses of a kind.
fn buses<'a>(
    cell: &'a CellConfig,
    kind: &DriverKind,
) -> impl Iterator<Item = &'a Arc<dyn DriverConfig>> {
    cell.buses.iter().filter(|bus| kind.configures(&***bus))
}

/// Result of a reload.
#[derive(Debug, Default)]
pub(super) struct Reloaded {
    /// What was done, one line each.
    pub(super) applied: Vec<String>,
    /// What was not, and why.
    pub(super) refused: Vec<String>,
}

impl Reloaded {
    /// For the service manager.
    pub(super) fn status(&self) -> String {
        let refused = self.refused.join("; ");
        match (self.applied.len(), self.refused.len()) {
            (0, 0) => "reloaded: nothing changed".to_owned(),
            (applied, 0) => format!("reloaded: {applied} changes applied"),
            (applied, _) => format!("reloaded: {applied} changes applied; not applied: {refused}"),
        }
    }
}

/// Applies what can be applied. `running` becomes what the controller is made of from then on, so
/// that the next reload tries again what was refused now.
pub(super) fn apply(
    running: &mut CellConfig,
    new: &CellConfig,
    controller: &Controller,
    change_log: impl FnOnce(Option<&str>) -> anyhow::Result<()>,
) -> Reloaded {
    let changes = Changes::between(running, new);
    let mut reloaded = Reloaded::default();
    for removed in &changes.removed {
        match controller.remove_cell_device(removed) {
            Ok(()) => {
                running.devices.retain(|device| device.name() != removed);
                reloaded
                    .applied
                    .push(format!("device {removed} is removed"));
            }
            Err(error) => reloaded
                .refused
                .push(format!("device {removed} stays: {error}")),
        }
    }
    for device in changes.new {
        let name = device.name().to_owned();
        if running.devices.iter().any(|other| other.name() == name) {
            continue; // Its removal failed, which is reported already.
        }
        match controller.add_cell_device(&*device) {
            Ok(()) => {
                running.devices.push(device);
                reloaded.applied.push(format!("device {name} is new"));
            }
            Err(error) => reloaded
                .refused
                .push(format!("device {name} is not added: {error}")),
        }
    }
    if running.frames != new.frames {
        controller.set_frames(new.frames.clone());
        running.frames = new.frames.clone();
        reloaded
            .applied
            .push("frames, bases, tools and home positions are new".to_owned());
    }
    if changes.log {
        let log = new.controller.log.as_deref();
        match change_log(log) {
            Ok(()) => {
                running.controller.log = new.controller.log.clone();
                reloaded
                    .applied
                    .push(format!("log is {}", log.unwrap_or("as by default")));
            }
            Err(error) => reloaded.refused.push(format!("{error:#}")),
        }
    }
    let restart = changes.restart.iter();
    reloaded
        .refused
        .extend(restart.map(|name| format!("{name} needs a restart")));
    reloaded
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::SocketAddr;
    use std::time::Duration;
    use takt_devices::fri::LwrConfig;

    fn arm(name: &str, port: u16) -> Arc<dyn DriverConfig> {
        Arc::new(LwrConfig::new(
            name,
            SocketAddr::from(([127, 0, 0, 1], port)),
        ))
    }

    fn cell(devices: &[Arc<dyn DriverConfig>]) -> CellConfig {
        CellConfig {
            devices: devices.to_vec(),
            ..CellConfig::default()
        }
    }

    #[test]
    fn same_cell_changes_nothing() {
        let cell = cell(&[arm("left", 1)]);
        assert_eq!(Changes::between(&cell, &cell), Changes::default());
        assert_eq!(Reloaded::default().status(), "reloaded: nothing changed");
    }

    #[test]
    fn changes_list_added_removed_and_changed_devices() {
        let old = cell(&[arm("left", 1), arm("middle", 2), arm("right", 3)]);
        let new = cell(&[arm("right", 3), arm("left", 9), arm("top", 4)]);
        let changes = Changes::between(&old, &new);
        assert_eq!(changes.removed, ["left", "middle"]);
        assert_eq!(changes.new, [arm("left", 9), arm("top", 4)]);
    }

    #[test]
    fn changes_that_need_restart_are_named() {
        let old = CellConfig::default();
        let mut new = old.clone();
        new.controller.period = Duration::from_millis(2);
        new.controller.tcp = None;
        new.controller.log = Some("debug".to_owned());
        let changes = Changes::between(&old, &new);
        assert_eq!(changes.restart, ["period", "tcp"]);
        assert!(changes.log);
    }

    #[test]
    fn changes_of_other_settings_need_restart() {
        let old = CellConfig::default();
        let mut new = old.clone();
        new.controller.costs = Some("costs.toml".into());
        assert_eq!(Changes::between(&old, &new).restart, ["[controller]"]);
        new.fleet = Some(toml::Table::new());
        assert_eq!(Changes::between(&old, &new).restart, ["[fleet]"]);
    }

    /// A cell of ordinary threads that listens nowhere.
    fn quiet() -> CellConfig {
        let mut cell = CellConfig::default();
        cell.controller.priority = None;
        cell
    }

    fn quiet_arm(name: &str) -> Arc<dyn DriverConfig> {
        Arc::new(LwrConfig {
            priority: None,
            ..LwrConfig::new(name, SocketAddr::from(([127, 0, 0, 1], 0)))
        })
    }

    #[test]
    fn reload_adds_and_removes_devices() {
        let mut running = quiet();
        let controller = Controller::start(&running).unwrap();
        let names = || -> Vec<String> {
            controller
                .devices()
                .into_iter()
                .map(|device| device.name)
                .collect()
        };
        let mut new = running.clone();
        new.devices = vec![quiet_arm("left"), quiet_arm("right")];
        let reloaded = apply(&mut running, &new, &controller, |_| Ok(()));
        assert!(reloaded.refused.is_empty(), "{reloaded:?}");
        assert_eq!(
            (names(), &running),
            (vec!["left".into(), "right".into()], &new)
        );

        new.devices.remove(0);
        let reloaded = apply(&mut running, &new, &controller, |_| Ok(()));
        assert_eq!(reloaded.applied, ["device left is removed"]);
        assert_eq!(names(), ["right"]);
    }

    #[test]
    fn reload_device_of_loaded_net_stays_until_retry() {
        let mut running = quiet();
        running.devices = vec![quiet_arm("left")];
        let controller = Controller::start(&running).unwrap();
        let net = controller.load(takt_core::controller::LoadRequest {
            text: "{m=RobotArm::JointMonitor(Robot='left', Axis='0'), c=Cancel(), \
                   v=Core::DoubleNetcommOut(inValue=m.outMeasuredPosition, Key='v'), \
                   outTerminate=c.outCancel}"
                .to_owned(),
            session: takt_core::controller::SessionId(0),
            description: String::new(),
            period: None,
        });
        let net = net.unwrap();
        let empty = quiet();
        let reloaded = apply(&mut running, &empty, &controller, |_| Ok(()));
        assert!(reloaded.refused[0].contains("left"), "{reloaded:?}");
        assert_eq!((controller.devices().len(), running.devices.len()), (1, 1));
        controller.unload(net).unwrap();
        let reloaded = apply(&mut running, &empty, &controller, |_| Ok(()));
        assert_eq!(reloaded.applied, ["device left is removed"]);
        assert!(controller.devices().is_empty());
    }

    #[test]
    fn reload_device_that_fails_to_open_is_not_kept() {
        let taken = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut running = quiet();
        let controller = Controller::start(&running).unwrap();
        let mut new = quiet();
        let address = taken.local_addr().unwrap();
        new.devices = vec![Arc::new(LwrConfig::new("left", address))];
        let reloaded = apply(&mut running, &new, &controller, |_| Ok(()));
        assert!(reloaded.refused[0].contains("left"), "{reloaded:?}");
        assert!(controller.devices().is_empty() && running.devices.is_empty());
        drop(taken);
        let reloaded = apply(&mut running, &new, &controller, |_| Ok(()));
        assert_eq!(reloaded.applied, ["device left is new"]);
    }
}
