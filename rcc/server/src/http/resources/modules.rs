//! `/types/`, `/modules/` and `/modulesdetails/`: descriptions of types and primitives, from the tables that nets are
//! loaded with.

use takt_core::net::definition::{Definition, ParameterType};
use takt_core::net::{Element as ValueElement, Type};

use super::super::Response;
use super::super::element::Element;
use super::{Handler, Outcome};

impl Handler<'_> {
    pub(super) fn types(&self) -> Response {
        let types = all_types().map(|ty| describe_type(&ty));
        self.show(&Element::new("types").containing(types))
    }

    pub(super) fn type_named(&self, name: &str) -> Outcome {
        let found = all_types().find(|ty| ty.to_string() == name);
        let ty = found.ok_or_else(|| Response::not_found("there is no such type"))?;
        Ok(self.show(&describe_type(&ty)))
    }

    pub(super) fn modules(&self) -> Response {
        let definitions = self.controller.registry().definitions().iter();
        let modules = definitions.map(|d| named("module", "modules", &d.name));
        self.show(&Element::new("modules").containing(modules))
    }

    pub(super) fn modules_in_detail(&self) -> Response {
        let definitions = self.controller.registry().definitions().iter();
        self.show(&Element::new("modules").containing(definitions.map(describe)))
    }

    pub(super) fn module(&self, name: &str) -> Outcome {
        let registry = self.controller.registry();
        let definition = registry.find(name).ok_or_else(|| {
            let similar = registry
                .similar(name)
                .map(|s| format!("; did you mean {s}?"));
            let similar = similar.unwrap_or_default();
            Response::not_found(format!("there is no such primitive{similar}"))
        })?;
        Ok(self.show(&describe(definition)))
    }
}

fn all_types() -> impl Iterator<Item = Type> {
    let scalars = ValueElement::ALL.into_iter().map(Type::scalar);
    scalars.chain(ValueElement::ALL.into_iter().map(Type::array))
}

fn describe_type(ty: &Type) -> Element {
    named("type", "types", &ty.to_string())
}

fn named(element: &'static str, collection: &str, name: &str) -> Element {
    Element::new(element)
        .with("name", name)
        .with("uri", format!("/{collection}/{name}/"))
}

fn describe(definition: &Definition) -> Element {
    let ins = definition.inputs.iter().map(|port| {
        let element = Element::new("inport")
            .with("name", port.name)
            .with("type", port.ty)
            .with("required", port.required);
        let parameter = port.parameter.into_iter();
        parameter
            .fold(element, |e, name| e.with("parameter", name))
            .text(port.doc)
    });
    let outs = definition.outputs.iter().map(|port| {
        Element::new("outport")
            .with("name", port.name)
            .with("type", port.ty)
            .text(port.doc)
    });
    let parameters = definition.parameters.iter().map(|parameter| {
        let ty = match parameter.ty {
            ParameterType::Text => "Core::string".to_owned(),
            ParameterType::Value(ty) => ty.to_string(),
        };
        Element::new("parameter")
            .with("name", parameter.name)
            .with("type", ty)
            .with("default", parameter.default)
            .text(parameter.doc)
    });
    named("module", "modules", &definition.name)
        .with("doc", definition.doc)
        .with("null", definition.null.text())
        .with("source", definition.source)
        .with("firstns", definition.cost.first_ns)
        .with("ns", definition.cost.ns)
        .with("elementns", definition.cost.element_ns)
        .containing(ins)
        .containing(outs)
        .containing(parameters)
}
