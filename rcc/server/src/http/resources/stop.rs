//! `/stop/`: state of the stop channel for the page, and the page's second path to a stop, through this server. The
//! first path is the channel's own port, which works even when this server does not respond.

use takt_core::stop_channel::Origin;

use super::super::Response;
use super::super::element::Element;
use super::super::page;
use super::{Handler, Outcome};

impl Handler<'_> {
    /// The web page.
    pub(super) fn page(&self) -> Response {
        page::index(self.site.stop.as_ref().map(|stop| stop.port))
    }

    /// A file that the page loads.
    pub(super) fn page_file(path: &[&str]) -> Outcome {
        page::file(path).ok_or_else(|| Response::not_found("the page has no such file"))
    }

    /// Whether everything is stopped and by whom, and port and key of the stop channel.
    pub(super) fn stop_state(&self) -> Response {
        let switch = self.controller.stop_switch();
        let mut element = Element::new("stop").with("stopped", switch.is_stopped());
        if let Some((origin, _)) = switch.last_stop().filter(|_| switch.is_stopped()) {
            element = element.with("by", origin);
        }
        if let Some(stop) = &self.site.stop {
            element = element.with("port", stop.port).with("key", &stop.key);
        }
        self.show(&element)
    }

    pub(super) fn stop_all(&self) -> Response {
        self.controller.stop_switch().stop(Origin::Server);
        self.stop_state()
    }

    pub(super) fn release_stop(&self) -> Response {
        // Another client may already have released it.
        let _ = self.controller.stop_switch().release();
        self.stop_state()
    }
}
