//! `/flights/`: the files of the flight recorder, their bytes, and requests for one.

use std::fs::OpenOptions;
use std::os::unix::fs::OpenOptionsExt as _;
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use nix::libc::{O_NOFOLLOW, O_NONBLOCK};
use percent_encoding::utf8_percent_encode;
use takt_core::controller::FlightInfo;
use takt_core::record;

use super::super::Response;
use super::super::element::Element;
use super::super::response::Download;
use super::devices::RESERVED;
use super::{Handler, Outcome};

/// The cause of a request that comes without one.
const REQUESTED: &str = "requested over HTTP";
/// Most characters of the cause of a request.
const CAUSE_CHARS_MAX: usize = 200;

impl Handler<'_> {
    /// The flight files, oldest first.
    pub(super) fn flights(&self) -> Response {
        let files = self.controller.flights();
        let directory = self.controller.flight_directory();
        let list = Element::new("flights").with("recording", directory.is_some());
        let list = match directory {
            Some(directory) => list.with("directory", directory.display().to_string()),
            None => list,
        };
        self.show(&list.containing(files.iter().map(described)))
    }

    /// The bytes of a flight file. Only names of the list are found, so that no path leads out of the directory.
    pub(super) fn flight(&self, name: &str) -> Outcome {
        let mut files = self.controller.flights().into_iter();
        let found = files.find(|file| file.name == name).ok_or_else(|| {
            Response::not_found("there is no such flight file\nhint: /flights/ lists them")
        })?;
        if !found.is_complete {
            return Err(Response::conflict(format!(
                "{name} is being written\nhint: it is complete a second after its cause; request it again then"
            )));
        }
        let gone = |error| Response::not_found(format!("cannot read {name}: {error}"));
        // What may have replaced it since the list: a link is not followed, a pipe not waited for.
        let file = OpenOptions::new()
            .read(true)
            .custom_flags(O_NOFOLLOW | O_NONBLOCK)
            .open(&found.path)
            .map_err(gone)?;
        let metadata = file.metadata().map_err(gone)?;
        if !metadata.is_file() {
            return Err(Response::not_found(format!("{name} is no file")));
        }
        let download = Download {
            bytes: metadata.len(),
            file: Arc::new(file),
        };
        Ok(Response::file(name, download))
    }

    /// Writes a flight file of the last ten seconds and the second that follows, with the form's `cause`.
    pub(super) fn request_flight(&self) -> Outcome {
        let cause = self.field("cause").map(str::trim);
        let cause = cause.filter(|cause| !cause.is_empty()).unwrap_or(REQUESTED);
        let cause: String = cause.chars().take(CAUSE_CHARS_MAX).collect();
        let path = self.controller.request_flight(&cause);
        let path = path.map_err(Response::conflict)?;
        let name = path.file_name().map(|it| it.to_string_lossy().into_owned());
        let flight = Element::new("flight")
            .with("name", name.unwrap_or_default())
            .with("path", path.display().to_string());
        Ok(self.show(&flight))
    }
}

/// A flight file with its causes, one a line; these are known when it is complete.
fn described(file: &FlightInfo) -> Element {
    let changed = file.changed.duration_since(UNIX_EPOCH);
    let element = Element::new("flight")
        .with("name", &file.name)
        .with(
            "uri",
            format!("/flights/{}", utf8_percent_encode(&file.name, RESERVED)),
        )
        .with("path", file.path.display().to_string())
        .with("bytes", file.bytes)
        .with("changed", changed.unwrap_or_default().as_secs())
        .with("complete", file.is_complete);
    if !file.is_complete {
        return element;
    }
    match record::about(&file.path) {
        Ok(about) => match about.get("cause") {
            Some(cause) => element.with("cause", cause),
            None => element.with(
                "error",
                "it was cut off and names no cause\nhint: takt record recover",
            ),
        },
        Err(error) => element.with("error", error.to_string()),
    }
}
