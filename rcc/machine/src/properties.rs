//! Property files: values of properties by name, with structs, as TOML and as the `.cpf` XML of Orocos. What is read from
//! one form and written in the other keeps names, order, types, values and descriptions; comments are not kept. Whether a
//! component has such properties is checked elsewhere.

mod cpf;
mod node;
mod read_toml;
mod write;

use crate::diagnostic::Diagnostics;

pub use node::{
    ARRAY, BAG, BYTES_MAX, Body, DEPTH_MAX, NODES_MAX, Node, PropertyFile, Simple, Unwritable,
};

impl PropertyFile {
    /// Reads the TOML form.
    ///
    /// # Errors
    /// All errors of the file.
    pub fn from_toml(text: &str) -> Result<Self, Diagnostics> {
        read_toml::read(text)
    }

    /// Reads the `.cpf` form.
    ///
    /// # Errors
    /// The errors of the file; after malformed XML no further ones.
    pub fn from_cpf(text: &str) -> Result<Self, Diagnostics> {
        cpf::read(text)
    }

    /// Writes the TOML form.
    #[must_use]
    pub fn to_toml(&self) -> String {
        write::toml(self)
    }

    /// Writes the `.cpf` form.
    ///
    /// # Errors
    /// If a text has a character that XML cannot represent, such as U+0000; the property is named.
    pub fn to_cpf(&self) -> Result<String, Unwritable> {
        write::cpf(self)
    }

    /// The property or struct of that name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Node> {
        self.nodes.iter().find(|node| node.name == name)
    }
}

#[cfg(test)]
mod tests;
