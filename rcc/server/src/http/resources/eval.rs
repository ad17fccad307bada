//! `/eval/`: one cycle of a net with the devices as they are. Known clients read every value of
//! a device this way.

use super::super::element::Element;
use super::{Ask, Outcome};

impl Ask<'_> {
    /// What cannot be evaluated is answered as known clients expect it: as a value called `error`.
    pub(super) fn evaluate(&self) -> Outcome {
        let text = self.net_text()?;
        let data = |key: &str, text: String| Element::new("data").with("key", key).text(text);
        let eval = Element::new("eval");
        let eval = match self.controller.evaluate(&text) {
            Ok(values) => eval.containing(values.into_iter().map(|(k, v)| data(&k, v))),
            Err(rejection) => eval.containing([data("error", rejection.lines(&text).join("; "))]),
        };
        Ok(self.show(&eval))
    }
}
