//! `/geometry/meshes/DEVICE/NUMBER`: the files of meshes that the URDF of an arm names, and no other file.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::sync::Arc;

use nix::libc::O_NONBLOCK;
use percent_encoding::utf8_percent_encode;
use takt_core::controller::VisualShape;

use super::super::super::Response;
use super::super::super::response::Download;
use super::super::devices::RESERVED;
use super::super::{Handler, Outcome};
use crate::site::Limits;

/// Most bytes of a mesh; viewers read no more.
const MESH_BYTES_MAX: u64 = 16 << 20;
/// Bytes of the head of a binary STL file, and of a triangle.
const HEAD: usize = 84;
const TRIANGLE: u64 = 50;

impl Handler<'_> {
    /// The bytes of a mesh. What cannot be drawn is named in the log, too.
    pub(super) fn mesh(&self, device: &str, number: &str) -> Outcome {
        let details = self.controller.device_details();
        let details = details.iter().find(|details| details.info.name == device);
        let arm = details.and_then(|details| details.model.arm());
        let number: Option<usize> = number.parse().ok();
        let visual = arm.and_then(|arm| arm.visuals.get(number?));
        let Some(VisualShape::Mesh(path, _)) = visual.map(|visual| &visual.shape) else {
            return Err(Response::not_found(
                "there is no such mesh\nhint: /geometry/ lists those of the models",
            ));
        };
        open(Path::new(path)).map_err(|why| {
            let line = format!("{device}: the mesh {path} is drawn as a simple solid: {why}");
            self.site.warn(|limits: &Limits| &limits.meshes, &line);
            Response::conflict(why)
        })
    }
}

/// The path of a mesh below the root.
pub(super) fn mesh_uri(device: &str, number: usize) -> String {
    let device = utf8_percent_encode(device, RESERVED);
    format!("/geometry/meshes/{device}/{number}")
}

/// The last part of a path or of a name such as `package://robot/mesh.stl`.
pub(super) fn file_name(path: &str) -> String {
    path.rsplit('/').next().unwrap_or(path).to_owned()
}

/// A response with a mesh, or why it cannot be drawn.
fn open(path: &Path) -> Result<Response, String> {
    let is_stl = path
        .extension()
        .is_some_and(|it| it.eq_ignore_ascii_case("stl"));
    if !is_stl {
        return Err(
            "only STL files are read\nhint: convert it, for example with meshlab or blender"
                .to_owned(),
        );
    }
    let failed = |error: io::Error| error.to_string();
    // A pipe is not waited for.
    let mut options = OpenOptions::new();
    options.read(true).custom_flags(O_NONBLOCK);
    let mut file = options.open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err("it is no file".to_owned());
    }
    let bytes = metadata.len();
    if bytes > MESH_BYTES_MAX {
        return Err(format!(
            "it has {bytes} bytes; at most {MESH_BYTES_MAX} are read\nhint: reduce its number of triangles"
        ));
    }
    check(&mut file, bytes)?;
    let name = file_name(&path.to_string_lossy());
    let file = Arc::new(file);
    Ok(Response::file(&name, Download { file, bytes }))
}

/// Whether the head is that of an STL file of this length; viewers check the rest.
fn check(file: &mut File, bytes: u64) -> Result<(), String> {
    let mut head = Vec::new();
    let read = file.by_ref().take(HEAD as u64).read_to_end(&mut head);
    read.and_then(|_| file.rewind())
        .map_err(|error| error.to_string())?;
    let count = head.get(HEAD - 4..HEAD).and_then(|it| it.try_into().ok());
    let count = count.map(|it| u64::from(u32::from_le_bytes(it)));
    let is_binary = count.is_some_and(|count| bytes == HEAD as u64 + count * TRIANGLE);
    if is_binary || head.trim_ascii_start().starts_with(b"solid") {
        return Ok(());
    }
    Err("it is no STL file, or cut off".to_owned())
}
