//! `/eval/`: evaluates one cycle of a net with the present device state. Known clients read every value of
//! a device this way.

use super::super::element::Element;
use super::{Handler, Outcome};

impl Handler<'_> {
    /// Errors are returned as known clients expect them: as a value called `error`.
    pub(super) fn evaluate(&self) -> Outcome {
        let text = self.net_text()?;
        let data = |key: &str| Element::new("data").with("key", key);
        let eval = Element::new("eval");
        let eval = match self.controller.evaluate(&text) {
            Ok(values) => eval.containing(values.into_iter().map(|(k, v)| data(&k).value(v))),
            Err(rejection) => {
                eval.containing([data("error").text(rejection.lines(&text).join("; "))])
            }
        };
        Ok(self.show(&eval))
    }
}
