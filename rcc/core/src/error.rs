//! Errors of calls to the controller. A rejected net and a device fault are
//! values, not errors of this kind.

use std::path::PathBuf;

use crate::ids::{NetId, NetState};

/// An error of a call to the controller.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
#[expect(
    clippy::error_impl_error,
    reason = "one error type per crate has this name"
)]
pub enum Error {
    /// Two devices with one name.
    #[error("device `{name}` exists already; give each device its own name")]
    DeviceTwice { name: String },
    /// The capacity for joints is exhausted.
    #[error("too many joints with `{name}`: at most {bound} in all and 8 in one arm")]
    TooManyJoints { name: String, bound: usize },
    /// The capacity for device values is exhausted.
    #[error("too many values with `{name}`: all devices together have {bound} words of each kind")]
    TooManyValues { name: String, bound: usize },
    /// A device cannot be created as requested.
    #[error("device `{name}`: {what}")]
    DeviceParameter { name: String, what: String },
    /// No device has this name.
    #[error("there is no device `{0}`")]
    NoSuchDevice(String),
    /// A device that nets use cannot be removed.
    #[error("device `{name}` is used by net {net}; unload that net first")]
    DeviceInUse { name: String, net: NetId },
    /// No net has this identifier.
    #[error("there is no net {0}")]
    NoSuchNet(NetId),
    /// A start names no net.
    #[error("the start names no net; name at least one")]
    NoNet,
    /// No session has this number.
    #[error("there is no session {0}")]
    NoSuchSession(String),
    /// No machine has this name.
    #[error("there is no machine `{name}`\nhint: loaded are {known}")]
    NoSuchMachine { name: String, known: String },
    /// A machine of this name is loaded.
    #[error("a machine `{0}` is loaded already\nhint: end it first, or rename one of them")]
    MachineTwice(String),
    /// A machine, a component of it or a text command has errors.
    #[error("{0}")]
    Machine(String),
    /// A machine or a component refused a request.
    #[error("{request}: {why}")]
    MachineRefused { request: String, why: String },
    /// The net is in the wrong state for the request.
    #[error("net {net} is {state}; {hint}")]
    WrongState {
        net: NetId,
        state: NetState,
        hint: &'static str,
    },
    /// A resource of the net is in use.
    #[error("net {net} needs {resource}, which {holder} holds; end that net first")]
    ResourceInUse {
        net: NetId,
        resource: String,
        holder: String,
    },
    /// A resource of the net is reserved for a scheduled net.
    #[error("net {net} needs {resource}, which is reserved for {holder}; abort that one first")]
    ResourceKept {
        net: NetId,
        resource: String,
        holder: String,
    },
    /// A resource cannot be reserved for a scheduled net.
    #[error(
        "{resource} cannot be reserved for the nets to be started: {holder} holds it or waits for it, and the rule does \
         not follow that net"
    )]
    NotSchedulable { resource: String, holder: String },
    /// Two of the nets that a rule starts need the same resource.
    #[error("{resource} cannot be reserved for the nets to be started: two of them need it")]
    NeededTwice { resource: String },
    /// The nets of one thread would exceed its budget.
    #[error(
        "net {net} costs up to {cost:?} a cycle, and {running:?} of the {budget:?} that nets of its thread \
         may cost together are taken: {heaviest}; end one of them, make them smaller, or load one for \
         another net thread (`[[controller.thread]]`)"
    )]
    Overload {
        net: NetId,
        cost: std::time::Duration,
        running: std::time::Duration,
        budget: std::time::Duration,
        heaviest: String,
    },
    /// A net would take cycle time reserved for scheduled nets.
    #[error(
        "net {net} costs up to {cost:?} a cycle: with what rules may start beside it, nets of its thread would \
         come to {most:?} together, and may cost {budget:?}; abort one of those that wait first: {waiting}"
    )]
    OverloadKept {
        net: NetId,
        cost: std::time::Duration,
        most: std::time::Duration,
        budget: std::time::Duration,
        waiting: String,
    },
    /// Nets that a rule starts would exceed the budget beside the nets that continue.
    #[error(
        "the nets to be started cost up to {started:?} a cycle: with what runs beside them or may be started \
         by other rules, nets of their thread would come to {most:?} together, and may cost {budget:?}. \
         Running beside them: {running}; waiting for rules: {waiting}. Let the rule stop a net that runs or wait for its end \
         (`net.terminated`), abort one that waits, or make them smaller"
    )]
    RuleOverload {
        started: std::time::Duration,
        most: std::time::Duration,
        budget: std::time::Duration,
        running: String,
        waiting: String,
    },
    /// A rule's condition is invalid.
    #[error("condition: {why}")]
    Condition { why: String },
    /// A device that the net commands does not follow commands.
    #[error("net {net} commands {device}, which is {status}; wait until it is operational")]
    DeviceNotReady {
        net: NetId,
        device: String,
        status: String,
    },
    /// A text is not a value of the in value's type.
    #[error("net {net}, value {key}: {why}")]
    Value {
        net: NetId,
        key: String,
        why: String,
    },
    /// A limit of the controller is reached.
    #[error("{item}: at most {bound}; unload or end some first")]
    TooMany { item: &'static str, bound: usize },
    /// The net thread did not answer a command.
    #[error("the net thread did not answer within {0:?}; it hangs or starves (see `takt jitter`)")]
    NoAnswer(std::time::Duration),
    /// A stop is latched.
    #[error(
        "the controller is stopped, by {by}; release it with `takt stop --release`, then request again"
    )]
    Stopped { by: String },
    /// The stop channel cannot be opened.
    #[error(
        "cannot open the stop channel at {address}: {source}; choose another `stop` or `stop_socket` under [controller]"
    )]
    StopChannel {
        address: String,
        source: std::io::Error,
    },
    /// The controller is shutting down.
    #[error("the controller is stopping")]
    Closing,
    /// A thread could not be started.
    #[error("cannot start thread {name}: {source}")]
    Thread {
        name: String,
        source: std::io::Error,
    },
    /// A device could not be opened.
    #[error("cannot open device `{name}`: {what}: {source}")]
    Device {
        name: String,
        what: String,
        source: std::io::Error,
    },
    /// The limits of this process leave too little memory for one more net.
    #[error(
        "not enough memory: the limits of this process leave {free_mib} MiB for nets\n\
         hint: unload nets, or raise ulimit -v or the memory limit of the service (MemoryMax)"
    )]
    HostMemory { free_mib: u64 },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    File {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The configuration of a cell is inconsistent.
    #[error("cell: {0}")]
    Cell(String),
    /// A configuration file is invalid.
    #[error("{path}: {why}")]
    Config { path: PathBuf, why: String },
    /// A recording is damaged or of another kind.
    #[error("{path}: {why}")]
    Recording { path: PathBuf, why: String },
}

impl Error {
    /// The resource of a conflict, such as `left_Joint_3`, and the net that holds it, as far as it is known; `None` for all
    /// other errors.
    #[must_use]
    pub fn conflict(&self) -> Option<(&str, Option<&str>)> {
        let (Self::ResourceInUse {
            resource, holder, ..
        }
        | Self::ResourceKept {
            resource, holder, ..
        }
        | Self::NotSchedulable { resource, holder }) = self
        else {
            return None;
        };
        let is_known = holder != UNKNOWN_HOLDER;
        Some((resource, is_known.then_some(holder.as_str())))
    }
}

/// What an error calls a net that holds a resource and is not known.
pub(crate) const UNKNOWN_HOLDER: &str = "another net";
