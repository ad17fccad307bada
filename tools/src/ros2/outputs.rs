//! Digital outputs as services `std_srvs/SetBool`. A thread for all of them; requests wait in a bounded queue.

use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use takt_api::{Cell, Outcome};
use takt_fleet::ros::messages::{decode_set_bool, set_bool};
use takt_fleet::ros::node::{Node, Request};
use takt_fleet::ros::types::SET_BOOL;

use super::names::ros_name;
use super::server::Refusals;
use crate::signal::Stop;

/// Requests that wait.
const QUEUE: usize = 64;
/// How often the end of the command is looked for.
const TICK: Duration = Duration::from_millis(50);
/// More outputs of a device have no service.
const OUTPUTS_MAX: usize = 64;

/// Offers a service for each digital output.
pub(super) fn start(
    node: &Arc<Node>,
    cell: &Cell,
    refusals: &Refusals,
    stop: &Stop,
) -> anyhow::Result<Option<JoinHandle<()>>> {
    let (requests, received) = sync_channel::<(usize, u32, Request)>(QUEUE);
    let devices = cell.ios()?;
    let mut count = 0;
    for (device, io) in devices.iter().enumerate() {
        let outputs = io
            .state()
            .map(|state| state.digital_outputs.len())
            .unwrap_or(0);
        for port in 0..u32::try_from(outputs.min(OUTPUTS_MAX)).unwrap_or(0) {
            let name = format!("{}/output_{port}", ros_name(io.name()));
            let (requests, refusals) = (requests.clone(), refusals.clone());
            let of = format!("service {name}");
            node.service(&name, &SET_BOOL, move |request| {
                if let Err(TrySendError::Full(_)) = requests.try_send((device, port, request)) {
                    refusals.say(&of, "a request is not answered: too many wait");
                }
            })?;
            count += 1;
        }
    }
    if count == 0 {
        return Ok(None);
    }
    let (stop, refusals) = (stop.clone(), refusals.clone());
    let serve = move || {
        while !stop.is_requested() {
            let (device, port, request) = match received.recv_timeout(TICK) {
                Ok(request) => request,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            let Some(io) = devices.get(device) else {
                continue;
            };
            let (is_set, text) = match decode_set_bool(&request.message()) {
                Err(why) => (false, format!("the request is malformed: {why}")),
                Ok(state) => match io.set(port, state).now().run() {
                    Ok(Outcome::Completed | Outcome::Maintaining) => (true, String::new()),
                    Ok(other) => (false, format!("{other:?}")),
                    Err(error) => (false, error.kind.to_string()),
                },
            };
            let of = format!("output {port} of {}", io.name());
            if !is_set {
                refusals.say(&of, &text);
            }
            if let Err(why) = request.reply(set_bool(is_set, &text)) {
                refusals.say(&of, &why.to_string());
            }
        }
    };
    let thread = std::thread::Builder::new().name("takt-ros2-outputs".to_owned());
    Ok(Some(thread.spawn(serve)?))
}
