//! The web page: a static text whose script reads the resources and displays them. It loads nothing from other
//! servers.

/// The HTML text.
pub(super) const PAGE: &str = include_str!("page.html");
