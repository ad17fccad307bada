//! The texts with which commands are refused. Clients compare them, so they stay as they are; a
//! reason, where there is one, follows as a second value. No command is executed here.

use super::SUBSCRIPTIONS_MAX;
use super::commands::{DESCRIPTION_BYTES_MAX, SESSIONS_PER_CONNECTION};
use crate::access::{WRONG_MAX, WRONG_WITHIN};
use crate::sessions::OPEN_SESSIONS_MAX;
use crate::wire::Message;

/// Why a command was not done.
#[derive(Debug, thiserror::Error)]
pub(super) enum Refusal {
    /// The line is no message.
    #[error("invalid syntax")]
    InvalidSyntax,
    /// Another version, or another command before `ver`.
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
    /// No such session, or the one of all nets without a session.
    #[error("invalid session")]
    InvalidSession,
    /// No such net.
    #[error("invalid net")]
    InvalidNet,
    /// No such net, as `snc` says it.
    #[error("invalidnetname")]
    InvalidNetName,
    /// The net text does not follow the grammar.
    #[error("Syntax error in net.")]
    NetSyntax { reason: String },
    /// The net could not be started.
    #[error("net start failed")]
    StartFailed { reason: String },
    /// No such net, as `nesc` says it.
    #[error("invalid netname")]
    InvalidRuleNet,
    /// The rule could not be installed.
    #[error("scheduling not possible")]
    SchedulingNotPossible { reason: String },
    /// No such rule.
    #[error("Invalid synchronization rule")]
    InvalidRule,
    /// The bound on subscriptions.
    #[error(
        "too many subscriptions: a connection has at most {SUBSCRIPTIONS_MAX}; unload nets or open another connection"
    )]
    TooManySubscriptions,
    /// A token is needed first.
    #[error("token missing: send tok(\"…\") first; tools take --token-file or TAKT_TOKEN")]
    TokenMissing,
    /// It is another one.
    #[error("wrong token")]
    WrongToken,
    /// The bound on guesses that are answered at once.
    #[error(
        "wrong token: more than {WRONG_MAX} within {} s from one address are answered late",
        WRONG_WITHIN.as_secs()
    )]
    TooManyTokens,
    /// The bound on sessions of a connection.
    #[error(
        "too many sessions: a connection has at most {SESSIONS_PER_CONNECTION}; end one with ase first"
    )]
    TooManySessions,
    /// The bound on sessions of clients without a credential.
    #[error(
        "too many sessions: clients without token have at most {OPEN_SESSIONS_MAX} together; end one with ase first"
    )]
    TooManyOpenSessions,
    /// What becomes of a session whose client is lost.
    #[error("on loss: \"keep\" or \"end\" is expected")]
    OnLoss,
    /// The bound on descriptions.
    #[error("the description has {bytes} bytes; at most {DESCRIPTION_BYTES_MAX} are taken")]
    DescriptionTooLong { bytes: usize },
    /// Whatever else the controller says.
    #[error(transparent)]
    Controller(#[from] takt_core::Error),
}

impl Refusal {
    /// The reply that says so.
    pub(super) fn reply(&self, tag: &str) -> Message {
        let reply = Message::new(tag, "err").with(self.to_string());
        match self {
            Self::NetSyntax { reason }
            | Self::StartFailed { reason }
            | Self::SchedulingNotPossible { reason } => reply.with(reason.as_str()),
            Self::InvalidSyntax
            | Self::BadHandshake
            | Self::UnknownCommand
            | Self::ParameterType
            | Self::ParameterMissing
            | Self::InvalidSession
            | Self::InvalidNet
            | Self::InvalidNetName
            | Self::InvalidRuleNet
            | Self::InvalidRule
            | Self::TooManySubscriptions
            | Self::TokenMissing
            | Self::WrongToken
            | Self::TooManyTokens
            | Self::TooManySessions
            | Self::TooManyOpenSessions
            | Self::OnLoss
            | Self::DescriptionTooLong { .. }
            | Self::Controller(_) => reply,
        }
    }
}
