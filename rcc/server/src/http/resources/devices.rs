//! `/devices/`: lists, creates and removes devices. Known clients create theirs here and then wait for the push
//! over DirectIO.

use std::collections::BTreeMap;

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use takt_core::controller::{DeviceDetails, DeviceInfo};
use takt_core::device::driver::BusLoad;
use takt_core::ids::check_device_name;
use takt_core::net::Frame;
use takt_core::net::value::text::TextValue as _;
use takt_core::{Error, Nanos};

use super::super::Response;
use super::super::element::{Element, NetValue};
use super::nets::ms;
use super::{Handler, Outcome};
use crate::dio::all_devices;

impl Handler<'_> {
    pub(super) fn devices(&self) -> Response {
        let devices = all_devices(self.controller).into_iter();
        let details = self.controller.device_details();
        let devices = devices.map(|d| {
            let details = details.iter().find(|other| other.info.name == d.name);
            let details = details.into_iter().flat_map(details_of);
            self.describe_device(&d)
                .containing(details)
                .containing(self.figures_of_driver(&d.name))
                .containing(self.reports(&d.name))
        });
        let buses = self.controller.bus_loads();
        let buses = buses.iter().map(bus);
        self.show(
            &Element::new("devices")
                .containing(devices)
                .containing(buses),
        )
    }

    pub(super) fn device(&self, name: &str) -> Outcome {
        let device = self.describe_device(&self.find_device(name)?);
        let details = self.controller.device_details();
        let details = details.iter().filter(|details| details.info.name == name);
        let device = device.containing(details.flat_map(details_of));
        let device = device.containing(self.figures_of_driver(name));
        Ok(self.show(&device.containing(self.reports(name))))
    }

    /// What its driver reports of itself, such as the quality of an FRI session.
    fn figures_of_driver(&self, name: &str) -> impl Iterator<Item = Element> + use<> {
        let figures = self.controller.driver_figures(name).into_iter();
        figures.map(|(name, value)| {
            Element::new("figure")
                .with("name", name)
                .with("value", value)
        })
    }

    /// The last second of values before the last fault of a device, or before now.
    pub(super) fn last_of_device(&self, name: &str) -> Outcome {
        self.find_device(name)?;
        let values = self.controller.last_values(name);
        let values = values.ok_or_else(|| Response::not_found("no values are recorded of it"))?;
        Ok(Response::of_kind("text/csv; charset=utf-8", values.csv()))
    }

    /// The last events of a device and its driver, oldest first.
    fn reports(&self, name: &str) -> impl Iterator<Item = Element> + use<> {
        let now = takt_core::monotonic();
        let reports = self.controller.device_reports(name).into_iter();
        reports.map(move |report| {
            let event = &report.event;
            let element = Element::new("event")
                .with("severity", event.severity.word())
                .with("ago", ms(now - report.at))
                .with("times", report.times)
                .with("cause", event.cause());
            match event.hint() {
                Some(hint) => element.with("hint", hint),
                None => element,
            }
        })
    }

    /// The latest joint state of an arm, rad and rad/s.
    pub(super) fn robot_arm(&self, name: &str) -> Outcome {
        let info = self.find_device(name)?;
        let joints = info
            .interfaces
            .get("robotarm")
            .and_then(|p| p.get("jointcount"));
        let joints = joints.and_then(|count| count.parse().ok());
        let (Some(count), Some(state)) = (joints, self.controller.arm_state(name)) else {
            return Err(Response::not_found(format!("{name} is not a robot arm")));
        };
        let reported = state.joints.iter().take(count).enumerate();
        let joints = reported.map(|(number, joint)| {
            let values = [
                ("commanded", joint.commanded_position),
                ("measured", joint.measured_position),
                ("velocity", joint.measured_velocity),
            ];
            let element = Element::new("joint")
                .with("axis", number)
                .with("error", joint.error);
            let known = values.into_iter().filter_map(|(key, v)| Some((key, v?)));
            known.fold(element, |element, (key, value)| element.with(key, value))
        });
        let arm = Element::new("robotarm").with("name", name);
        Ok(self.show(&arm.with("state", info.status.word()).containing(joints)))
    }

    /// Creates or removes the device of the form.
    pub(super) fn change_devices(&self) -> Outcome {
        let name = self.field("name").filter(|name| !name.is_empty());
        let name = name.ok_or_else(|| Response::bad_request("name is missing"))?;
        match self.field("action") {
            None => {}
            Some("remove") => {
                self.controller
                    .remove_device(name)
                    .map_err(error_response)?;
                return Ok(Response::redirect("303 See Other", "/devices/"));
            }
            Some(_) => return Err(Response::bad_request("action: remove is expected, or none")),
        }
        check_device_name(name).map_err(Response::bad_request)?;
        let kind = self.field("type");
        let kind = kind.ok_or_else(|| Response::bad_request("type is missing"))?;
        let own = |key: &str| matches!(key, "name" | "type" | "action");
        let fields = self.request.form.iter().filter(|(key, _)| !own(key));
        // Parameter names are lower case, but the known client's forms are not.
        let mut parameters: BTreeMap<_, _> = fields
            .map(|(key, value)| (key.to_ascii_lowercase(), value.clone()))
            .collect();
        // Known clients plan by Cartesian limits, and rely on simulations that check the range only.
        let limits = parameters.entry("limits".to_owned());
        limits.or_insert_with(|| "range".to_owned());
        let added = self.controller.add_device(name, kind, &parameters);
        added.map_err(Response::bad_request)?;
        Ok(Response::text("201 Created", format!("{name} is there\n")))
    }

    /// What a device is and how it is: its state, the age of its last measurement in ms, its faults.
    fn describe_device(&self, device: &DeviceInfo) -> Element {
        let interfaces = device.interfaces.iter().map(|(name, parameters)| {
            let parameters = parameters.iter().map(|(key, value)| {
                Element::new("parameter")
                    .with("name", key)
                    .with("value", NetValue(value.clone()))
            });
            Element::new("interface")
                .with("name", name)
                .containing(parameters)
        });
        let element = Element::new("device")
            .with("uri", uri(&device.name))
            .with("name", &device.name)
            .with("type", &device.kind)
            .with("state", device.status.word());
        let measured = self.controller.arm_state(&device.name);
        let measured = measured.filter(|state| state.stamp > Nanos(0));
        let element = match measured {
            Some(state) => element.with("age", ms(takt_core::monotonic() - state.stamp)),
            None => element,
        };
        let counts = self.controller.fault_counts();
        let counts = counts.get(&device.name).copied().unwrap_or_default();
        element
            .with("faults", counts.faults)
            .with("recovered", counts.recovered)
            .containing(interfaces)
    }

    pub(super) fn find_device(&self, name: &str) -> Result<DeviceInfo, Response> {
        let mut devices = all_devices(self.controller).into_iter();
        let found = devices.find(|d| d.name == name);
        found.ok_or_else(|| Response::not_found("there is no such device"))
    }
}

/// The load of a bus within the last second, and the most of any second, as a part of its bit rate, 0 to 1.
fn bus(load: &BusLoad) -> Element {
    let element = Element::new("bus")
        .with("name", &load.bus)
        .with("bits", load.bits_per_s)
        .with("bitsmax", load.bits_per_s_max);
    let element = match load.bit_rate {
        Some(rate) => element.with("bitrate", rate),
        None => element,
    };
    let known = [("load", load.load()), ("loadmax", load.load_max())];
    let known = known.into_iter().filter_map(|(key, v)| Some((key, v?)));
    known.fold(element, |element, (key, value)| element.with(key, value))
}

/// All but the unreserved characters (RFC 3986, section 2.3).
pub(super) const RESERVED: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b'_')
    .remove(b'-')
    .remove(b'.')
    .remove(b'~');

/// The path of a device below the root.
pub(super) fn uri(name: &str) -> String {
    let name = utf8_percent_encode(name, RESERVED);
    format!("/devices/{name}/")
}

pub(super) fn error_response(error: Error) -> Response {
    if matches!(error, Error::NoSuchDevice(_)) {
        Response::not_found(error)
    } else {
        Response::conflict(error)
    }
}

/// What a program needs to plan its motions: model, period, base, tools and joint limits, m, rad and kg.
fn details_of(device: &DeviceDetails) -> Vec<Element> {
    let text = |frame: Frame| {
        let mut text = String::new();
        frame.format(&mut text);
        NetValue(text)
    };
    let mut elements = vec![
        Element::new("model")
            .with("name", device.model.name())
            .with("period", ms(Nanos::from(device.period))),
    ];
    elements.extend(device.base.as_ref().map(|base| {
        Element::new("base")
            .with("parent", &base.parent)
            .with("pose", text(base.placement().frame()))
    }));
    elements.extend(device.tools.iter().map(|tool| {
        Element::new("tool")
            .with("name", &tool.name)
            .with("pose", text(tool.placement().frame()))
            .with("mass", tool.mass)
    }));
    elements.extend(device.joints.iter().enumerate().map(|(number, joint)| {
        Element::new("limits")
            .with("axis", number)
            .with("positionmin", joint.position_min)
            .with("positionmax", joint.position_max)
            .with("velocitymax", joint.velocity_max)
            .with("accelerationmax", joint.acceleration_max)
    }));
    elements
}
