//! Failures of primitives, as they are declared while a net is loaded.

use std::sync::Arc;

use crate::failure::{Failure, FailureCell};
use crate::load::builder::Build;

impl Build<'_, '_> {
    /// Where the step notes that the primitive failed for good. When the net then ends by itself, its end is reported with
    /// `text` of the noted code: cause, then `hint:` on a line of its own.
    pub fn failure(
        &mut self,
        text: impl Fn(u64) -> String + Send + Sync + 'static,
    ) -> Arc<FailureCell> {
        let cell = Arc::default();
        self.parts.failures.push(Failure {
            primitive: self.node.name.to_owned(),
            cell: Arc::clone(&cell),
            text: Box::new(text),
        });
        cell
    }
}
