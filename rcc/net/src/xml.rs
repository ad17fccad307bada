//! The XML form of nets, which older tools write: conversion to net text and back. Only the form is
//! checked here; the resulting net text is read by the ordinary parser, so faults of a net refer to
//! the net text, not to its XML.
//!
//! ```xml
//! <rpinet>
//!   <module id="c" type="Core::Clock"><parameter name="Increment" value="1"/></module>
//!   <fragment id="f">
//!     <module id="a" type="Core::DoubleAdd"><port name="inFirst" frommodule="f" fromport="inX"/></module>
//!     <inport name="inX" frommodule="c" fromport="outValue" debug="2.0"/>
//!     <outport name="outY" frommodule="a" fromport="outValue"/>
//!   </fragment>
//!   <outport name="outTerminate" frommodule="f" fromport="outZ"/>
//! </rpinet>
//! ```
//! `frommodule` names a sibling, or the enclosing fragment for that fragment's own in ports, which
//! is `parent` in net text; the root's is `ROOT`. Element names may be in any case.

mod read;
mod write;

pub use read::from_xml;
pub use write::to_xml;

/// Name of the root fragment.
const ROOT: &str = "ROOT";

/// Why a text is not the XML form of a net.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {kind}")]
pub struct XmlFault {
    /// Line, from 1.
    pub line: usize,
    /// The cause.
    pub kind: XmlFaultKind,
}

/// The kinds of faults.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum XmlFaultKind {
    /// The text is not XML.
    #[error("{0}")]
    Malformed(String),
    /// A document type, whose entities could grow without bound.
    #[error("a document type is not allowed; remove `<!DOCTYPE …>`")]
    DocumentType,
    /// A misplaced element.
    #[error("`<{element}>` is not allowed in {inside}")]
    Element {
        element: String,
        inside: &'static str,
    },
    /// There is no net.
    #[error("there is no `<rpinet>`, or it does not end")]
    NoNet,
    /// An element lacks an attribute.
    #[error("`<{element}>` needs the attribute `{attribute}`")]
    Missing {
        element: &'static str,
        attribute: &'static str,
    },
    /// An attribute value that net text cannot contain.
    #[error("{attribute}=\"{value}\": {wanted} is expected here")]
    Value {
        attribute: &'static str,
        value: String,
        wanted: &'static str,
    },
    /// A bound of [`crate::Limits`], or on attributes, is exceeded.
    #[error("{found} {item}; at most {bound} are allowed")]
    Bound {
        item: &'static str,
        found: usize,
        bound: usize,
    },
}

#[cfg(test)]
mod tests;
