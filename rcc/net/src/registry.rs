//! All primitives that a controller knows, by name. The controller composes them from the tables of
//! this crate and of the crates that use it.

use std::collections::HashMap;

use crate::cost::Cost;
use crate::definition::Definition;
use crate::fault::similar;

/// The primitives known to a controller.
#[derive(Debug, Default)]
pub struct Registry {
    definitions: Vec<Definition>,
    by_name: HashMap<String, usize>,
}

impl Registry {
    /// A registry with the primitives of this crate.
    pub fn core() -> Self {
        let mut registry = Self::default();
        registry.add(crate::primitives::all());
        registry
    }

    /// Adds definitions.
    ///
    /// # Panics
    /// If a name is already defined: two tables contradict each other.
    pub fn add(&mut self, definitions: impl IntoIterator<Item = Definition>) {
        for definition in definitions {
            let number = self.definitions.len();
            let earlier = self.by_name.insert(definition.name.clone(), number);
            assert!(
                earlier.is_none(),
                "primitive {} is defined twice",
                definition.name
            );
            self.definitions.push(definition);
        }
    }

    /// The definition with that name.
    pub fn find(&self, name: &str) -> Option<&Definition> {
        self.by_name.get(name).map(|i| &self.definitions[*i])
    }

    /// All definitions, in the order they were added.
    pub fn definitions(&self) -> &[Definition] {
        &self.definitions
    }

    /// Replaces declared costs, by name; primitives that are not named keep the declared cost.
    /// Returns the names that no primitive has.
    pub fn set_costs<'n>(
        &mut self,
        costs: impl IntoIterator<Item = (&'n str, Cost)>,
    ) -> Vec<&'n str> {
        let mut unknown = Vec::new();
        for (name, cost) in costs {
            match self.by_name.get(name) {
                Some(number) => self.definitions[*number].cost = cost,
                None => unknown.push(name),
            }
        }
        unknown
    }

    /// The known name most similar to `name`.
    pub fn similar(&self, name: &str) -> Option<&str> {
        similar(name, self.definitions.iter().map(|d| d.name.as_str()))
    }
}
