//! Replays exchanges in the format of `transcripts/README.md` against a real server over loopback sockets and compares
//! them line by line.

#![allow(dead_code, reason = "shared by test files that need different parts")]

use std::collections::{HashMap, VecDeque};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use takt_client::Token;
use takt_server::{OnLoss, ServerConfig};

use crate::common::TestServer;

/// Far longer than any test takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(20);

/// The WebSocket handshake of a client of the original.
const UPGRADE: &str = "GET /DirectIO/ HTTP/1.1\r\nHost: h\r\nUpgrade: websocket\r\n\
    Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

/// The transport of `open NAME`.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Transport {
    WebSocket,
    Tcp,
}

/// Whether `text` matches `pattern`.
pub(crate) fn fits(pattern: &str, text: &str) -> bool {
    let starts = [
        pattern.find("<number>").map(|at| (at, "<number>")),
        pattern.find("<text>").map(|at| (at, "<text>")),
        pattern.find("[?").map(|at| (at, "[?")),
    ];
    let Some((at, token)) = starts.into_iter().flatten().min() else {
        return pattern == text;
    };
    let (literal, rest) = pattern.split_at(at);
    let (Some(text), rest) = (text.strip_prefix(literal), &rest[token.len()..]) else {
        return false;
    };
    let ends = |accepts: fn(char) -> bool| {
        let ends = text.char_indices().take_while(move |(_, c)| accepts(*c));
        ends.map(|(at, c)| at + c.len_utf8()).collect::<Vec<_>>()
    };
    match token {
        "<number>" => {
            let number = |c: char| c.is_ascii_digit() || "+-.e".contains(c);
            ends(number).into_iter().any(|end| {
                text[..end].parse::<f64>().is_ok_and(f64::is_finite) && fits(rest, &text[end..])
            })
        }
        "<text>" => {
            let any = std::iter::once(0).chain(ends(|c| c != '\n'));
            any.into_iter().any(|end| fits(rest, &text[end..]))
        }
        _ => {
            let (optional, rest) = rest.split_once("?]").expect("the end of what is optional");
            fits(rest, text) || fits(&format!("{optional}{rest}"), text)
        }
    }
}

/// A connection of the transcript.
struct Line {
    stream: TcpStream,
    bytes: Vec<u8>,
    frames: bool,
    /// Messages permitted at any time.
    loose: Vec<String>,
    /// Messages expected once, in any order.
    awaited: Vec<String>,
    /// Messages permitted once, in any order.
    possible: Vec<String>,
    /// A message that was read but not compared yet.
    held: VecDeque<(u8, String)>,
}

impl Line {
    fn new(stream: TcpStream, frames: bool) -> Self {
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        stream.set_nodelay(true).unwrap();
        Self {
            stream,
            bytes: Vec::new(),
            frames,
            loose: Vec::new(),
            awaited: Vec::new(),
            possible: Vec::new(),
            held: VecDeque::new(),
        }
    }

    /// Reads `count` bytes; `None` at the end of the stream.
    fn fill(&mut self, count: usize) -> Option<()> {
        while self.bytes.len() < count {
            let mut part = [0; 4096];
            match self.stream.read(&mut part) {
                Ok(0) => return None,
                Ok(n) => self.bytes.extend_from_slice(&part[..n]),
                Err(e) if e.kind() == ErrorKind::ConnectionReset => return None,
                Err(e) => panic!("nothing is received: {e}"),
            }
        }
        Some(())
    }

    fn take(&mut self, count: usize) -> Vec<u8> {
        self.bytes.drain(..count).collect()
    }

    /// A line without its line end.
    fn text_line(&mut self) -> Option<String> {
        let mut seen = 0;
        loop {
            if let Some(at) = self.bytes.iter().position(|b| *b == b'\n') {
                let line = String::from_utf8(self.take(at + 1)).unwrap();
                return Some(line.trim_end_matches(['\r', '\n']).to_owned());
            }
            seen = self.bytes.len().max(seen);
            self.fill(seen + 1)?;
        }
    }

    /// First byte and payload of a frame; a line counts as a text frame.
    fn read(&mut self) -> Option<(u8, String)> {
        if let Some(held) = self.held.pop_front() {
            return Some(held);
        }
        if !self.frames {
            return Some((0x81, self.text_line()?));
        }
        self.fill(2)?;
        let (first, mut length, mut head) = (self.bytes[0], usize::from(self.bytes[1]), 2);
        if length == 126 {
            self.fill(4)?;
            length = usize::from(u16::from_be_bytes([self.bytes[2], self.bytes[3]]));
            head = 4;
        }
        self.fill(head + length)?;
        self.take(head);
        Some((first, String::from_utf8(self.take(length)).unwrap()))
    }

    /// The next message that is not permitted at any time.
    fn message(&mut self) -> (u8, String) {
        loop {
            let (first, text) = self.read().expect("the server closed the connection");
            let is_once = once(&mut self.awaited, &text) || once(&mut self.possible, &text);
            if !is_once && !self.loose.iter().any(|pattern| fits(pattern, &text)) {
                return (first, text);
            }
        }
    }

    fn send(&mut self, first: u8, payload: &str) {
        let mut bytes = Vec::new();
        if self.frames {
            let length = payload.len();
            match u8::try_from(length) {
                Ok(short) if short < 126 => bytes.extend([first, short]),
                _ => {
                    bytes.extend([first, 126]);
                    bytes.extend(u16::try_from(length).unwrap().to_be_bytes());
                }
            }
            bytes.extend(payload.bytes());
        } else {
            bytes.extend(format!("{payload}\n").bytes());
        }
        self.stream.write_all(&bytes).unwrap();
    }
}

/// Whether one of `patterns` matches; that one is removed.
fn once(patterns: &mut Vec<String>, text: &str) -> bool {
    let at = patterns.iter().position(|pattern| fits(pattern, text));
    at.map(|at| patterns.remove(at)).is_some()
}

/// A replay of one file.
struct Replay<'s> {
    server: &'s TestServer,
    transport: Transport,
    lines: HashMap<String, Line>,
    /// Lines of the last response not compared yet, its status first.
    response: VecDeque<String>,
}

impl Replay<'_> {
    fn step(&mut self, line: &str) -> Result<(), String> {
        let (line, optional) = match line.strip_prefix("[?").and_then(|l| l.strip_suffix("?]")) {
            Some(line) => (line, true),
            None => (line, false),
        };
        let (name, rest) = line.split_once(' ').unwrap_or((line, ""));
        let (verb, rest) = rest.split_once(' ').unwrap_or((rest, ""));
        match (name, verb) {
            ("original", _) => Ok(()),
            ("open", name) => {
                self.open(name, rest);
                Ok(())
            }
            ("http", ">>") => {
                self.request(rest);
                Ok(())
            }
            ("http", "<<") => self.compare(rest),
            (name, verb) => {
                let line = self.lines.get_mut(name).ok_or("no such connection")?;
                converse(line, verb, rest, optional)
            }
        }
    }

    fn open(&mut self, name: &str, how: &str) {
        let address = match (self.transport, how) {
            (Transport::Tcp, "") => self.server.tcp,
            _ => self.server.http,
        };
        let mut line = Line::new(TcpStream::connect(address).unwrap(), false);
        if (self.transport, how) == (Transport::WebSocket, "") {
            line.stream.write_all(UPGRADE.as_bytes()).unwrap();
            while line.text_line().unwrap() != "" {}
            line.frames = true;
        }
        self.lines.insert(name.to_owned(), line);
    }

    fn request(&mut self, request: &str) {
        let (method, rest) = request.split_once(' ').unwrap();
        let (target, body) = match method {
            "POST" => rest.split_once(' ').unwrap(),
            _ => (rest, ""),
        };
        let mut stream = TcpStream::connect(self.server.http).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let length = body.len();
        let request =
            format!("{method} {target} HTTP/1.1\r\nContent-Length: {length}\r\n\r\n{body}");
        stream.write_all(request.as_bytes()).unwrap();
        let mut response = String::new();
        stream.read_to_string(&mut response).unwrap();
        let status = response.split(' ').nth(1).unwrap().to_owned();
        let lines = response.lines().skip(1).map(str::to_owned);
        self.response = std::iter::once(status).chain(lines).collect();
    }

    fn compare(&mut self, expected: &str) -> Result<(), String> {
        if expected.len() == 3 && expected.bytes().all(|b| b.is_ascii_digit()) {
            let status = self.response.pop_front().ok_or("there is no response")?;
            return (status == expected)
                .then_some(())
                .ok_or_else(|| format!("{status} {:?}", self.response));
        }
        let at = self.response.iter().position(|line| fits(expected, line));
        let at = at.ok_or_else(|| format!("not in {:#?}", self.response))?;
        self.response.drain(..=at);
        Ok(())
    }
}

fn converse(line: &mut Line, verb: &str, rest: &str, optional: bool) -> Result<(), String> {
    let check = |is: bool, received: String| is.then_some(()).ok_or(received);
    match verb {
        ">|" => {
            let text = format!("{rest}\r\n");
            line.stream.write_all(text.as_bytes()).unwrap();
            Ok(())
        }
        "<|" => {
            let text = line.text_line().ok_or("the connection is closed")?;
            check(text == rest, text)
        }
        "frames" => {
            line.frames = true;
            Ok(())
        }
        ">>" => {
            line.send(0x81, rest);
            Ok(())
        }
        "~~" if rest.is_empty() => {
            line.loose.clear();
            Ok(())
        }
        "~~" => {
            line.loose.push(rest.to_owned());
            Ok(())
        }
        "<<" => {
            let (first, text) = line.message();
            let fits = first == 0x81 && fits(rest, &text);
            if !fits && optional {
                line.held.push_front((first, text));
                return Ok(());
            }
            check(fits, text)
        }
        "<&" if rest.is_empty() => {
            while !line.awaited.is_empty() {
                let (_, text) = line.read().ok_or("the server closed the connection")?;
                if !once(&mut line.awaited, &text) && !once(&mut line.possible, &text) {
                    return Err(text);
                }
            }
            line.possible.clear();
            Ok(())
        }
        "<&" => {
            line.awaited.push(rest.to_owned());
            Ok(())
        }
        "<&?" => {
            line.possible.push(rest.to_owned());
            Ok(())
        }
        ">close" => {
            line.send(0x88, rest);
            Ok(())
        }
        "<close" => {
            let (first, text) = line.message();
            check(first == 0x88 && text == rest, format!("{first:#x} {text}"))
        }
        "end" => match line.read() {
            None => Ok(()),
            Some((_, text)) => Err(text),
        },
        other => Err(format!("no such verb: {other}")),
    }
}

/// Replays the text of a file against a server of its own; panics with the first line that differs.
pub(crate) fn replay(file: &str, text: &str, transport: Transport, token: Option<&str>) {
    let server = TestServer::start_with(ServerConfig {
        on_loss: Some(OnLoss::Keep),
        token: token.map(|token| Token::new(token).unwrap()),
        ..ServerConfig::default()
    });
    let mut replay = Replay {
        server: &server,
        transport,
        lines: HashMap::new(),
        response: VecDeque::new(),
    };
    for (number, line) in text.lines().enumerate() {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        if let Err(mismatch) = replay.step(line) {
            panic!(
                "{file}:{}: {line}\nbut the server sent: {mismatch}",
                number + 1
            );
        }
    }
    for (name, line) in &replay.lines {
        assert!(
            line.awaited.is_empty(),
            "{file}: {name}: {:?}",
            line.awaited
        );
    }
}
