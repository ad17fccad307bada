//! A net with all names resolved: primitives, the out ports at which their links start, activations and taps. Names are
//! resolved elsewhere.

use std::ops::Range;

use super::origin::Origin;
use crate::definition::Definition;
use crate::text::Arg;

/// A primitive instance.
#[derive(Debug)]
pub(super) struct Node<'t> {
    pub(super) definition: &'t Definition,
    /// Its name in messages; inline primitives are named after the port they feed.
    pub(super) name: &'t str,
    pub(super) at: Range<usize>,
    pub(super) scope: u32,
    pub(super) guard: u32,
    pub(super) args: &'t [Arg<'t>],
    /// By in port: the source of its value.
    pub(super) links: Vec<Option<Origin>>,
    /// By parameter: its text and the index of its first byte.
    pub(super) texts: Vec<Option<(&'t str, usize)>>,
}

/// Something that can be switched off: a fragment or a primitive with `inActive` connected.
#[derive(Debug, Default)]
pub(super) struct GuardInfo {
    pub(super) parent: u32,
    pub(super) active: Option<Origin>,
}

/// A net with all names resolved.
#[derive(Debug)]
pub(super) struct Resolved<'t> {
    pub(super) nodes: Vec<Node<'t>>,
    pub(super) guards: Vec<GuardInfo>,
    /// Out ports of the root fragment.
    pub(super) root: Vec<(&'t str, Option<Origin>)>,
    /// Tapped ports.
    pub(super) taps: Vec<Tapped>,
    /// Fragments, by number: their names, and the fragments around them.
    pub(super) scopes: Vec<(&'t str, Option<u32>)>,
}

/// A tapped port.
#[derive(Debug)]
pub(super) struct Tapped {
    /// Names of its fragments, of its primitive, and its own, joined by dots.
    pub(super) name: String,
    /// How long its values are kept, s.
    pub(super) seconds: f64,
    /// The source of its values.
    pub(super) origin: Origin,
}
