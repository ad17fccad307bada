//! Errors of commands. Clients compare the texts, so they never change; a reason, where there is one, follows as a
//! second value. No command is executed here.

use takt_client::wire::{Message, Value};

use super::limits::{DESCRIPTION_BYTES_MAX, SESSIONS_PER_CONNECTION, SUBSCRIPTIONS_MAX};
use crate::access::{WRONG_MAX, WRONG_WINDOW};
use crate::sessions::OPEN_SESSIONS_MAX;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub(super) enum CommandError {
    /// The line is not a message.
    #[error("invalid syntax")]
    InvalidSyntax,
    /// Wrong version, or another command before `ver`.
    #[error("bad handshake")]
    BadHandshake,
    /// No such command.
    #[error("unknown command or uninitialized result")]
    UnknownCommand,
    /// A value of another type than the command takes.
    #[error("Parameter type does not match")]
    ParameterType,
    /// Too few values.
    #[error("Parameter missing")]
    ParameterMissing,
    /// No such session, or session 0, which holds all nets without a session.
    #[error("invalid session")]
    InvalidSession,
    /// No such net.
    #[error("invalid net")]
    InvalidNet,
    /// No such net; text of `snc`.
    #[error("invalidnetname")]
    InvalidNetName,
    /// The net text has a syntax error.
    #[error("Syntax error in net.")]
    NetSyntax { reason: String },
    /// A net that was to be evaluated once has faults.
    #[error("net rejected")]
    NetRejected { reason: String },
    /// No such machine inside.
    #[error("invalid machine")]
    InvalidMachine,
    /// No such device.
    #[error("invalid device")]
    InvalidDevice,
    /// The net could not be started.
    #[error("net start failed")]
    StartFailed { source: takt_core::Error },
    /// No such net; text of `nesc`.
    #[error("invalid netname")]
    InvalidRuleNet,
    /// The rule could not be installed.
    #[error("scheduling not possible")]
    SchedulingNotPossible { source: takt_core::Error },
    /// The net is loading or was rejected.
    #[error("the net is not ready and records nothing")]
    NotReady,
    /// No such rule.
    #[error("Invalid synchronization rule")]
    InvalidRule,
    /// Quota of subscriptions exceeded.
    #[error(
        "too many subscriptions: a connection has at most {SUBSCRIPTIONS_MAX}; unload nets or open another connection"
    )]
    TooManySubscriptions,
    /// A token must be sent first.
    #[error("token missing: send tok(\"…\") first; tools take --token-file or TAKT_TOKEN")]
    TokenMissing,
    /// The token is wrong.
    #[error("wrong token")]
    WrongToken,
    /// The token is wrong, after too many others.
    #[error(
        "wrong token: more than {WRONG_MAX} within {} s from one address are answered late",
        WRONG_WINDOW.as_secs()
    )]
    TooManyTokens,
    /// Quota of sessions per connection exceeded.
    #[error(
        "too many sessions: a connection has at most {SESSIONS_PER_CONNECTION}; end one with ase first"
    )]
    TooManySessions,
    /// Quota of sessions for clients without a credential exceeded.
    #[error(
        "too many sessions: clients without token have at most {OPEN_SESSIONS_MAX} together; end one with ase first"
    )]
    TooManyOpenSessions,
    /// Invalid on-loss word.
    #[error("on loss: \"keep\" or \"end\" is expected")]
    OnLoss,
    /// Invalid pace of a subscription.
    #[error("pace: \"coalesced\" or \"every\" is expected")]
    Pace,
    /// The description is too long.
    #[error("the description has {bytes} bytes; at most {DESCRIPTION_BYTES_MAX} are taken")]
    DescriptionTooLong { bytes: usize },
    /// Any other error of the controller.
    #[error(transparent)]
    Controller(#[from] takt_core::Error),
}

impl CommandError {
    /// The `err` reply.
    pub(super) fn reply(&self, tag: &str) -> Message {
        let reply = Message::new(tag, "err").with(self.to_string());
        match self {
            Self::NetSyntax { reason } | Self::NetRejected { reason } => {
                reply.with(reason.as_str())
            }
            Self::StartFailed { source } | Self::SchedulingNotPossible { source } => {
                let reply = reply.with(source.to_string());
                match source.conflict() {
                    Some((resource, holder)) => reply.with(conflict(resource, holder)),
                    None => reply,
                }
            }
            Self::InvalidSyntax
            | Self::InvalidDevice
            | Self::InvalidMachine
            | Self::BadHandshake
            | Self::UnknownCommand
            | Self::ParameterType
            | Self::ParameterMissing
            | Self::InvalidSession
            | Self::InvalidNet
            | Self::InvalidNetName
            | Self::InvalidRuleNet
            | Self::InvalidRule
            | Self::NotReady
            | Self::TooManySubscriptions
            | Self::TokenMissing
            | Self::WrongToken
            | Self::TooManyTokens
            | Self::TooManySessions
            | Self::TooManyOpenSessions
            | Self::OnLoss
            | Self::Pace
            | Self::DescriptionTooLong { .. }
            | Self::Controller(_) => reply,
        }
    }
}

/// The fields of a conflict. A map, since clients that do not know it show all texts.
fn conflict(resource: &str, holder: Option<&str>) -> Value {
    let holder = holder.map(|holder| ("holder", holder));
    Value::map_of([("resource", resource)].into_iter().chain(holder))
}
