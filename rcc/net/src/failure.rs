//! Why a primitive failed for good, such as a program that divided by zero: noted once by its step, read by any thread when the net
//! ends. A failure does not end the net: the primitive first brings its devices to rest.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Where the step of a primitive notes that it failed.
#[derive(Debug, Default)]
pub struct FailureCell(AtomicU64);

impl FailureCell {
    /// Notes a failure; the first one stays. `code` is given to the text of the failure; 0 is none.
    pub fn note(&self, code: u64) {
        if self.0.load(Ordering::Relaxed) == 0 {
            self.0.store(code, Ordering::Relaxed);
        }
    }

    /// The failure; 0 is none.
    pub fn read(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Text of a failure: cause, then `hint:` on a line of its own.
pub(crate) type FailureText = Box<dyn Fn(u64) -> String + Send + Sync>;

/// A primitive that can fail, as it is found while the net is loaded.
pub(crate) struct Failure {
    /// The primitive's name in the net.
    pub(crate) primitive: String,
    pub(crate) cell: Arc<FailureCell>,
    pub(crate) text: FailureText,
}

impl Failure {
    /// The text, if it failed.
    pub(crate) fn read(&self) -> Option<String> {
        let code = self.cell.read();
        (code != 0).then(|| format!("`{}`: {}", self.primitive, (self.text)(code)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_failure_of_primitive_stays() {
        let failure = Failure {
            primitive: "p".to_owned(),
            cell: Arc::default(),
            text: Box::new(|code| format!("number {code}")),
        };
        assert_eq!(failure.read(), None);
        failure.cell.note(7);
        failure.cell.note(8);
        assert_eq!(failure.read().as_deref(), Some("`p`: number 7"));
    }
}
