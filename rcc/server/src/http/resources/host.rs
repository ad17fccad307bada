//! `/host/`, `/fleet/` and `/devices/<d>/jog`: what the program that runs the server adds.

use super::super::Response;
use super::{Handler, Outcome};
use crate::host_program::{HostProgram, JogKind};

impl Handler<'_> {
    fn host_program(&self) -> Result<&dyn HostProgram, Response> {
        self.site.program.as_deref().ok_or_else(|| {
            Response::not_found(
                "the program that runs this controller offers neither findings nor jogs nor a fleet",
            )
        })
    }

    /// The findings of the host check, or the cells of the fleet.
    pub(super) fn of_host_program(&self, part: &str) -> Outcome {
        if part == "fleet" {
            return self.fleet();
        }
        let found = self.host_program()?.findings();
        let found = found.map_err(Response::conflict)?;
        Ok(Response::of_kind("application/json", found))
    }

    /// The cells of the fleet.
    fn fleet(&self) -> Outcome {
        let cells = self.host_program()?.cells().map_err(Response::conflict)?;
        let none = || r#"{"own":null,"cells":[]}"#.to_owned();
        Ok(Response::of_kind(
            "application/json",
            cells.unwrap_or_else(none),
        ))
    }

    /// The net that jogs an arm, by `kind` and `speed`.
    pub(super) fn jog_net(&self, name: &str) -> Outcome {
        let device = self.find_device(name)?;
        if !device.interfaces.contains_key("robotarm") {
            return Err(Response::not_found(format!("{name} is not a robot arm")));
        }
        let kind = match self.query("kind") {
            Some("joints") => JogKind::Joints,
            Some("flange") => JogKind::Flange,
            _ => return Err(Response::bad_request("kind: joints or flange is expected")),
        };
        let speed = self.query("speed").unwrap_or("0.1").parse().ok();
        let speed = speed.filter(|speed| (f64::MIN_POSITIVE..=1.0).contains(speed));
        let wrong =
            || Response::bad_request("speed: a part of the limits is expected, above 0 to 1");
        let net = self
            .host_program()?
            .jog_net(name, kind, speed.ok_or_else(wrong)?);
        Ok(Response::text("200 OK", net.map_err(Response::conflict)?))
    }
}
