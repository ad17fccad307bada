//! `/ethercat/` of a controller with a bus that answers from memory.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use serde_json::{Value, json};
use takt_core::device::bus::{BusAccess, BusError, BusRead};
use takt_core::device::driver::{DeviceDriver, DriverEnds, DriverThread};

use super::resources::{body, controller, get, holds};

/// A bus that answers from memory.
#[derive(Debug)]
struct FakeBus;

impl BusAccess for FakeBus {
    fn kind(&self) -> &'static str {
        "ethercat"
    }

    fn name(&self) -> &str {
        "line"
    }

    fn is_at(&self, interface: &str) -> bool {
        interface == "eth7"
    }

    fn report(&self) -> Result<Value, BusError> {
        Ok(json!({ "segment": "line", "operational": true }))
    }

    fn read(&self, station: &str, what: BusRead) -> Result<Vec<u8>, BusError> {
        match (station, what) {
            ("drive", BusRead::Object { index, sub }) => Ok(vec![index.to_le_bytes()[0], sub]),
            ("drive", BusRead::Register { len, .. }) => Ok(vec![7; len.into()]),
            ("7", _) => Err(BusError::Failed("slave 7: no answer".to_owned())),
            _ => Err(BusError::NoSuch("there is no such slave".to_owned())),
        }
    }
}

/// A driver whose only purpose is its bus.
#[derive(Debug)]
struct BusDriver(DriverThread);

impl DeviceDriver for BusDriver {
    fn thread(&self) -> &DriverThread {
        &self.0
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.0
    }

    fn bus(&self) -> Option<Arc<dyn BusAccess>> {
        Some(Arc::new(FakeBus))
    }
}

#[test]
fn ethercat_resource_shows_segments_and_reads() {
    let controller = controller();
    assert!(body(&get(&controller, "/ethercat/")).contains(r#""segments":[]"#));
    let start = |ends: DriverEnds| {
        let thread = DriverThread::start("line", None, &[], move |stop| {
            while !stop.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
            }
            ends.clock
        })?;
        Ok(Box::new(BusDriver(thread)) as Box<dyn DeviceDriver>)
    };
    controller
        .add_driver("line", Vec::new(), None, start)
        .unwrap();
    holds(
        &get(&controller, "/ethercat/"),
        &[r#""segment":"line""#, "application/json"],
    );
    holds(
        &get(&controller, "/ethercat/eth7"),
        &[r#""operational":true"#],
    );
    holds(
        &get(&controller, "/ethercat/line/drive/sdo/6041/2"),
        &[r#""bytes":[65,2]"#],
    );
    holds(
        &get(&controller, "/ethercat/line/drive/reg/0130?len=3"),
        &[r#""bytes":[7,7,7]"#],
    );
    for (path, status) in [
        ("/ethercat/other", "404"),
        ("/ethercat/line/drive/foe/x", "404"),
        ("/ethercat/line/none/reg/0130", "404"),
        ("/ethercat/line/drive/reg/xyz", "400"),
        ("/ethercat/line/drive/reg/0130?len=500", "400"),
        ("/ethercat/line/7/sdo/6041", "409"),
    ] {
        let response = get(&controller, path);
        assert!(
            response.starts_with(&format!("HTTP/1.1 {status}")),
            "{path}: {response}"
        );
    }
}
