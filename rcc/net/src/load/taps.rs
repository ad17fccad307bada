//! Debug taps during loading: the ports that a text asks to record, and the out port that feeds
//! each. What is recorded, and when, is decided elsewhere.

use crate::fault::FaultKind;
use crate::load::resolve::Resolver;
use crate::load::resolved::Tapped;
use crate::taps::{TAP_SECONDS_MAX, TAPS_MAX};
use crate::text::{Arg, ArgValue};

impl<'t> Resolver<'t, '_> {
    /// Collects the taps at the ports of `owner`, or of the fragment `scope` itself.
    pub(super) fn tap(&mut self, ports: &'t [Arg<'t>], owner: Option<&str>, scope: u32) {
        for port in ports.iter().filter(|port| port.debug_s.is_some()) {
            let found = self.taps.len() + 1;
            if found > TAPS_MAX {
                // Reported once, at the first tap beyond the bound.
                if found == TAPS_MAX + 1 {
                    let (item, bound) = ("debug taps", TAPS_MAX);
                    self.fault(FaultKind::Bound { item, found, bound }, port.name.span());
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

    /// Resolves the sources of the ports. A port without a source has already been reported.
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
