//! `/geometry/`: where everything in the cell is and how it moves, so that a viewer computes poses from joint positions
//! itself. Live values are not here: they are probes.

mod meshes;
mod solids;

use takt_core::cell::{ObjectConfig, Placement};
use takt_core::controller::DeviceDetails;
use takt_core::net::Frame;

use super::super::Response;
use super::super::element::{Element, NetValue};
use super::{Handler, Outcome};
use solids::{Model, Shape, Solid};

/// Version of the resource.
const VERSION: u32 = 1;

impl Handler<'_> {
    pub(super) fn geometry_part(&self, path: &[&str]) -> Outcome {
        match path {
            [] => Ok(self.geometry()),
            ["meshes", device, number] => self.mesh(device, number),
            _ => Err(Response::not_found("/geometry/ has meshes/DEVICE/NUMBER")),
        }
    }

    /// Frames, devices and objects of the cell; lengths in m, angles in rad, rotations as quaternions x, y, z, w.
    fn geometry(&self) -> Response {
        let cell = self.controller.frames();
        let frames = cell.frames.iter().map(|frame| {
            let element = Element::new("frame").with("name", &frame.name);
            placed(element, &frame.parent, &frame.placement())
        });
        let devices = self.controller.device_details();
        let devices = devices.iter().map(device);
        let objects = cell.objects.iter().filter_map(object);
        let geometry = Element::new("geometry").with("version", VERSION);
        let geometry = geometry.containing(frames).containing(devices);
        self.show(&geometry.containing(objects))
    }
}

/// An object with its solid, about its own middle.
fn object(object: &ObjectConfig) -> Option<Element> {
    let element = Element::new("object").with("name", &object.name);
    let element = placed(element, &object.parent, &object.placement());
    Some(element.containing([solid(&Solid::of_object(object.shape()?))]))
}

/// A device with its rotation axes, its flange, its tools and its solids, all in its base while its joints are at 0.
fn device(device: &DeviceDetails) -> Element {
    let model = Model::of(device);
    let mut element = Element::new("device")
        .with("name", &device.info.name)
        .with("type", &device.info.kind)
        .with("model", device.model.name())
        .with("serial", model.is_serial)
        .with("mobile", device.abilities.contains_key("robotbase"))
        .with("wrench", device.abilities.contains_key("wrench"));
    if let Some(base) = &device.base {
        element = placed(element, &base.parent, &base.placement());
    }
    let axes = model.axes.iter().enumerate().map(|(number, axis)| {
        let axis = Element::new("axis")
            .with("direction", numbers(axis.direction.as_slice()))
            .with("point", numbers(axis.point.as_slice()));
        match device.joints.get(number) {
            Some(limits) => axis
                .with("min", limits.position_min)
                .with("max", limits.position_max),
            None => axis,
        }
    });
    let flange = device.chain.as_ref();
    let flange = flange.map(|chain| posed(Element::new("flange"), &chain.home));
    let tools = device.tools.iter().map(|tool| {
        let element = Element::new("tool").with("name", &tool.name);
        posed(element, &tool.placement().frame())
    });
    element
        .containing(axes)
        .containing(flange)
        .containing(tools)
        .containing(model.solids.iter().map(solid))
}

fn solid(solid: &Solid) -> Element {
    let element = Element::new("solid")
        .with("link", solid.link)
        .with("role", solid.role);
    let element = match &solid.shape {
        Shape::Capsule { from, to, radius } => element
            .with("kind", "capsule")
            .with("from", numbers(from.as_slice()))
            .with("to", numbers(to.as_slice()))
            .with("radius", *radius),
        Shape::Cylinder { from, to, radius } => element
            .with("kind", "cylinder")
            .with("from", numbers(from.as_slice()))
            .with("to", numbers(to.as_slice()))
            .with("radius", *radius),
        Shape::Box { pose, size } => {
            posed(element.with("kind", "box"), pose).with("size", numbers(size.as_slice()))
        }
        Shape::Mesh {
            pose,
            uri,
            file,
            scale,
        } => posed(element.with("kind", "mesh"), pose)
            .with("uri", uri)
            .with("file", file)
            .with("scale", numbers(scale.as_slice())),
    };
    match &solid.slide {
        Some(slide) => element.with("slide", numbers(slide.as_slice())),
        None => element,
    }
}

fn placed(element: Element, parent: &str, placement: &Placement) -> Element {
    posed(element.with("parent", parent), &placement.frame())
}

fn posed(element: Element, frame: &Frame) -> Element {
    let position = numbers(frame.translation.vector.as_slice());
    let rotation = numbers(frame.rotation.coords.as_slice());
    element
        .with("position", position)
        .with("rotation", rotation)
}

fn numbers(values: &[f64]) -> NetValue {
    let texts: Vec<_> = values.iter().map(f64::to_string).collect();
    NetValue(format!("[{}]", texts.join(",")))
}
