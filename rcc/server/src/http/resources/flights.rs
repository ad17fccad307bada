//! `/flights/`: the files of the flight recorder, and requests for one.

use std::time::UNIX_EPOCH;

use super::super::Response;
use super::super::element::Element;
use super::{Handler, Outcome};

impl Handler<'_> {
    /// The flight files, oldest first.
    pub(super) fn flights(&self) -> Response {
        let files = self.controller.flights().into_iter().map(|file| {
            let changed = file.changed.duration_since(UNIX_EPOCH);
            Element::new("flight")
                .with("name", file.name)
                .with("path", file.path.display().to_string())
                .with("bytes", file.bytes)
                .with("changed", changed.unwrap_or_default().as_secs())
                .with("complete", file.is_complete)
        });
        let directory = self.controller.flight_directory();
        let list = Element::new("flights").with("recording", directory.is_some());
        let list = match directory {
            Some(directory) => list.with("directory", directory.display().to_string()),
            None => list,
        };
        self.show(&list.containing(files))
    }

    /// Writes a flight file of the last ten seconds and the second that follows.
    pub(super) fn request_flight(&self) -> Outcome {
        let path = self.controller.request_flight("requested over HTTP");
        let path = path.map_err(Response::conflict)?;
        let flight = Element::new("flight").with("path", path.display().to_string());
        Ok(self.show(&flight))
    }
}
