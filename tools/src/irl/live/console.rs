//! Requests to a running program, a line each from standard input. Nothing is executed here.

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

const HELP: &str = "pause | continue | step | break LINE | clear LINE | print [NAME] | override 0.5 | set SIGNAL=VALUE | stop";

/// A request.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Request {
    /// Hold motions and program.
    Pause,
    /// Go on.
    Continue,
    /// Go on to the next line.
    Step,
    /// End the program; robots brake on their paths.
    Stop,
    /// Wait before a line.
    Break(u32),
    /// Do not.
    Clear(u32),
    /// Show a variable, or all.
    Print(String),
    /// Part of the speed, 0 to 1.
    Override(f64),
    /// Write an input that no device has.
    Set(String, String),
}

impl Request {
    fn parse(line: &str) -> Result<Option<Self>, String> {
        let mut words = line.split_whitespace();
        let Some(word) = words.next() else {
            return Ok(None);
        };
        let rest: Vec<_> = words.collect();
        let number = || {
            let line = rest.first().and_then(|word| word.parse::<u32>().ok());
            line.filter(|line| *line > 0)
                .ok_or_else(|| format!("`{word}` needs a line, such as `{word} 12`"))
        };
        Ok(Some(match word {
            "pause" => Self::Pause,
            "continue" | "c" => Self::Continue,
            "step" | "s" => Self::Step,
            "stop" => Self::Stop,
            "break" | "b" => Self::Break(number()?),
            "clear" => Self::Clear(number()?),
            "print" | "p" => Self::Print(rest.concat().to_lowercase()),
            "override" => {
                let part = rest.first().and_then(|word| word.parse().ok());
                let part = part.filter(|part| (0.0..=1.0).contains(part));
                Self::Override(part.ok_or_else(|| "`override` needs 0 to 1".to_owned())?)
            }
            "set" => {
                let text = rest.concat();
                let parts = text.split_once('=');
                let (name, value) = parts.ok_or_else(|| "`set` needs SIGNAL=VALUE".to_owned())?;
                Self::Set(name.to_lowercase(), value.to_owned())
            }
            _ => return Err(format!("`{word}` is no request\nhint: {HELP}")),
        }))
    }
}

/// Standard input.
pub(super) struct Console(Receiver<String>);

impl Console {
    /// Reads lines from now on.
    pub(super) fn listen() -> Self {
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self(receiver)
    }

    /// The next request, if there is one in this time, which passes otherwise.
    pub(super) fn next(&self, within: Duration) -> Option<Result<Request, String>> {
        let received = self.0.recv_timeout(within);
        match received {
            Ok(line) => Request::parse(&line).transpose(),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                // Standard input has ended; the program goes on.
                std::thread::sleep(within);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_or_refused_with_hint() {
        let parse = |line: &str| Request::parse(line);
        assert_eq!(parse("  "), Ok(None));
        assert_eq!(parse("b 12"), Ok(Some(Request::Break(12))));
        assert_eq!(parse("override 0.5"), Ok(Some(Request::Override(0.5))));
        assert_eq!(parse("print P.x"), Ok(Some(Request::Print("p.x".into()))));
        let set = Request::Set("part".into(), "true".into());
        assert_eq!(parse("set part = true"), Ok(Some(set)));
        for wrong in ["break", "break 0", "override 2", "override NaN", "set part"] {
            assert!(parse(wrong).unwrap_err().contains("needs"), "{wrong}");
        }
        assert!(parse("go").unwrap_err().contains("hint: pause | continue"));
    }
}
