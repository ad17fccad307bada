//! `takt net load`, `start`, `cancel`, `abort`, `unload` and `schedule`: the life of a net. Each sends one request and
//! prints the answer; `watch` follows the net afterwards.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use takt_net::text::{Arg, ArgValue, Body, Fragment};
use takt_net::{Limits, Rejection};

use super::{Server, complain_of, read};
use crate::Verdict;
use crate::output::{complain, say};

/// Load a net.
#[derive(Debug, Args)]
pub(crate) struct Load {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Start it too.
    #[arg(long)]
    start: bool,
    /// Add a debug tap to a port, such as target.inFirst, for `takt net tap`; may be given several times.
    #[arg(long, value_name = "PRIMITIVE.PORT")]
    tap: Vec<String>,
    #[command(flatten)]
    server: Server,
}

impl Load {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let name = self.file.display().to_string();
        // Syntax errors are reported here, with their locations.
        let mut faults = Vec::new();
        let root = takt_net::text::parse(&text, &Limits::default(), &mut faults);
        if !faults.is_empty() {
            complain_of(&Rejection { faults }, &name, &text);
            return Ok(Verdict::Failed);
        }
        let text = with_taps(&text, &root, &self.tap)?;
        let mut client = self.server.connect()?;
        let net = client.load(&text, &name)?;
        let faults = client.faults(&net)?;
        if !faults.is_empty() {
            for fault in &faults {
                complain(&format!("{name}:{fault}"));
            }
            client.command("neun", &net)?;
            return Ok(Verdict::Failed);
        }
        say(&net)?;
        if self.start {
            client.command("nest", &net)?;
        }
        Ok(Verdict::Good)
    }
}

/// Seconds for which a tap that is added keeps values.
const TAP_SECONDS: &str = "[10]";

/// The text with debug taps at these ports, in addition to those that it has.
fn with_taps(text: &str, root: &Fragment<'_>, taps: &[String]) -> anyhow::Result<String> {
    let mut ends = Vec::new();
    for tap in taps {
        let port = port_of(root, tap);
        let port = port.with_context(|| format!("the net has no port {tap}"))?;
        if port.debug_s.is_none() {
            ends.push(port.name.span().end);
        }
    }
    ends.sort_unstable();
    ends.dedup();
    let mut text = text.to_owned();
    for end in ends.into_iter().rev() {
        text.insert_str(end, TAP_SECONDS);
    }
    Ok(text)
}

/// The port of that name: the names of fragments, of the primitive and of the port, joined by dots.
fn port_of<'s, 't>(root: &'s Fragment<'t>, name: &str) -> Option<&'s Arg<'t>> {
    let mut names: Vec<_> = name.split('.').collect();
    let port = names.pop()?;
    let (mut fragment, mut args): (_, &[Arg<'t>]) = (Some(root), &[]);
    for name in names {
        let mut children = fragment?.children.iter();
        let node = &children.find(|child| child.name.text == name)?.node;
        args = &node.args;
        fragment = match &node.body {
            Body::Primitive(_) => None,
            Body::Fragment(fragment) => Some(fragment),
        };
    }
    let outs = fragment.map_or(&[][..], |fragment| &fragment.outs);
    let mut ports = args.iter().chain(outs);
    ports.find(|arg| arg.name.text == port && matches!(arg.value, ArgValue::Link(_)))
}

/// A loaded net.
#[derive(Debug, Args)]
pub(crate) struct Target {
    /// Its identifier, such as rpinet0.
    net: String,
    #[command(flatten)]
    server: Server,
}

impl Target {
    pub(super) fn command(&self, command: &str) -> anyhow::Result<Verdict> {
        self.server.connect()?.command(command, &self.net)?;
        Ok(Verdict::Good)
    }
}

/// Start a net in the cycle after another one.
///
/// Once the condition holds, NET is ended and NEXT starts, with no cycle between them. If NEXT cannot
/// start then, for instance because another net holds its joints, it stays READY.
#[derive(Debug, Args)]
pub(crate) struct Schedule {
    /// The net to start; loaded and not yet started.
    next: String,
    /// The net that it comes after.
    #[arg(long, value_name = "NET")]
    after: String,
    /// Boolean values of nets, joined by `&`, `|`, `!`, such as `rpinet0.outdone`; without it, when
    /// NET has ended by itself.
    #[arg(long, value_name = "CONDITION")]
    when: Option<String>,
    #[command(flatten)]
    server: Server,
}

impl Schedule {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        // A condition that names a net that does not exist is another error.
        client.has_ended(&self.after)?;
        let ended = format!("{}.terminated", self.after);
        // A net that ends by itself need not be ended.
        let (condition, stop) = match &self.when {
            Some(condition) => (condition, Some(self.after.as_str())),
            None => (&ended, None),
        };
        let rule = client.schedule(condition, stop, &self.next)?;
        say(&format!("rule {rule}"))?;
        Ok(Verdict::Good)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tapped(text: &str, taps: &[&str]) -> Result<String, String> {
        let mut faults = Vec::new();
        let root = takt_net::text::parse(text, &Limits::default(), &mut faults);
        assert_eq!(faults, []);
        let taps: Vec<_> = taps.iter().map(|tap| (*tap).to_owned()).collect();
        with_taps(text, &root, &taps).map_err(|error| error.to_string())
    }

    #[test]
    fn taps_are_added_at_ports_of_all_levels() {
        let text = "{a=X(inV=b.outV, inW[2]=b.outV), f={c=Y(inV=parent.inP), outQ=c.outV}(inP=a.outV), outTerminate=f.outQ}";
        let expected = "{a=X(inV[10]=b.outV, inW[2]=b.outV), f={c=Y(inV[10]=parent.inP), outQ=c.outV}(inP[10]=a.outV), \
            outTerminate[10]=f.outQ}";
        let taps = [
            "outTerminate",
            "a.inV",
            "a.inW",
            "a.inV",
            "f.c.inV",
            "f.inP",
        ];
        assert_eq!(tapped(text, &taps).as_deref(), Ok(expected));
        assert_eq!(tapped(text, &[]).as_deref(), Ok(text));
    }

    #[test]
    fn tap_of_missing_port_is_rejected() {
        let text = "{a=X(inV=b.outV, P='1'), outTerminate=a.outV}";
        for port in ["a.inW", "b.inV", "a.P", "", "a", "a.inV.x"] {
            assert_eq!(
                tapped(text, &[port]),
                Err(format!("the net has no port {port}"))
            );
        }
    }
}
