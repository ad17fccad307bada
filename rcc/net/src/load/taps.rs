//! Debug taps while loading: which ports a text asks to record, and which out port feeds each. What
//! is recorded, and when, is decided elsewhere.

use crate::fault::FaultKind;
use crate::load::resolve::{Origin, Resolver};
use crate::taps::{TAP_SECONDS_MAX, TAPS_MAX};
use crate::text::{Arg, ArgValue};

/// A port that is to be recorded.
#[derive(Debug)]
pub(super) struct Tapped {
    /// Names of the fragments it is in, of its primitive, and its own, joined by dots.
    pub(super) name: String,
    /// For how long it is remembered, s.
    pub(super) seconds: f64,
    /// What feeds it.
    pub(super) origin: Origin,
}

impl<'t> Resolver<'t, '_> {
    /// Notes the taps among the ports of `owner`, or of the fragment `scope` itself.
    pub(super) fn tap(&mut self, ports: &'t [Arg<'t>], owner: Option<&str>, scope: u32) {
        for port in ports.iter().filter(|port| port.debug_s.is_some()) {
            let found = self.taps.len() + 1;
            if found > TAPS_MAX {
                // Told once, at the first tap too many.
                if found == TAPS_MAX + 1 {
                    let (what, bound) = ("debug taps", TAPS_MAX);
                    self.fault(FaultKind::Bound { what, found, bound }, port.name.span());
                    self.taps.push((scope, port, String::new()));
                }
                return;
            }
            let mut parts = vec![port.name.text];
            parts.extend(owner);
            let mut next = Some(scope);
            while let Some(scope) = next.and_then(|number| self.scopes.get(number as usize)) {
                parts.push(scope.name);
                next = scope.parent;
            }
            parts.retain(|part| !part.is_empty());
            parts.reverse();
            self.taps.push((scope, port, parts.join(".")));
        }
    }

    /// Finds what feeds the ports. A port whose source is not there has been told already.
    pub(super) fn link_taps(&mut self) -> Vec<Tapped> {
        if !self.is_faultless() {
            return Vec::new();
        }
        let taps = std::mem::take(&mut self.taps);
        let link = |(scope, port, name): (u32, &'t Arg<'t>, String)| {
            let ArgValue::Link(source) = &port.value else {
                return None;
            };
            let seconds = port.debug_s?.clamp(0.0, TAP_SECONDS_MAX);
            let origin = self.origin(scope, source)?;
            Some(Tapped {
                name,
                seconds,
                origin,
            })
        };
        taps.into_iter().filter_map(link).collect()
    }
}
