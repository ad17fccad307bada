//! The page for people: one text that asks for resources and shows them. It is not made anew for
//! anybody, and takes nothing from elsewhere.

/// The page.
pub(super) const PAGE: &str = include_str!("page.html");
