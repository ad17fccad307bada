//! The tutorial of docs/nets.md, as a reader follows it: its nets are saved, its shell lines run literally in one shell
//! environment, and what they print is compared with the text. Ports are free ones; figures are not compared.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::path::Path;
use std::process::{Command, Stdio};

use common::{Folder, Process, alone};

/// Names of the nets, in their order, as the text gives them.
const NETS: [&str; 4] = ["clock.net", "wave.net", "begin.net", "move.net"];
/// Commands of the tutorial, so that none is left out without notice.
const COMMANDS: usize = 21;

/// A shell line, and the lines that it is to print.
struct Step<'a> {
    line: &'a str,
    output: Vec<&'a str>,
}

fn blocks<'a>(text: &'a str, language: &'a str) -> impl Iterator<Item = &'a str> {
    let blocks = text.split("\n```").skip(1).step_by(2);
    blocks.filter_map(move |block| block.strip_prefix(language)?.strip_prefix('\n'))
}

fn steps(text: &str) -> Vec<Step<'_>> {
    let mut steps: Vec<Step<'_>> = Vec::new();
    for line in blocks(text, "text").flat_map(str::lines) {
        match line.strip_prefix("$ ") {
            Some(line) => steps.push(Step {
                line,
                output: Vec::new(),
            }),
            None => steps.last_mut().unwrap().output.push(line),
        }
    }
    steps
}

/// A line with each figure that has a point as `#`: those depend on the time.
fn shape(line: &str) -> String {
    let word = |word: &str| {
        let is_figure = word.contains('.') && word.parse::<f64>().is_ok();
        if is_figure { "#" } else { word }.to_owned()
    };
    line.split_whitespace()
        .map(word)
        .collect::<Vec<_>>()
        .join(" ")
}

/// The environment of the reader.
struct Shell {
    folder: Folder,
    http: String,
}

impl Shell {
    fn command(&self, line: &str) -> Command {
        let program = Path::new(env!("CARGO_BIN_EXE_takt"));
        let path = std::env::var("PATH").unwrap();
        let mut command = Command::new("sh");
        command
            .args(["-c", &line.replace("127.0.0.1:8080", &self.http)])
            .current_dir(self.folder.file(""))
            .env("XDG_RUNTIME_DIR", self.folder.file("run"))
            .env(
                "PATH",
                format!("{}:{path}", program.parent().unwrap().display()),
            )
            .stdin(Stdio::null());
        command
    }

    /// Runs a line to its end; what it prints is what the text shows.
    #[track_caller]
    fn run(&self, step: &Step<'_>) {
        let output = self.command(step.line).output().unwrap();
        let [out, err] = [&output.stdout, &output.stderr].map(|it| String::from_utf8_lossy(it));
        assert!(output.status.success(), "{}: {out}{err}", step.line);
        let lines: Vec<_> = out.lines().map(shape).collect();
        if !step.output.is_empty() {
            let expected: Vec<_> = step.output.iter().map(|line| shape(line)).collect();
            assert_eq!(lines, expected, "{}: {err}", step.line);
        }
    }

    /// Runs a line that goes on until the net ends, and waits for the lines that the text shows, in their order.
    #[track_caller]
    fn follow(&self, step: &Step<'_>) {
        let mut process = Process::spawn(self.command(&format!("exec {}", step.line)));
        assert!(!step.output.is_empty(), "{} shows nothing", step.line);
        for line in &step.output {
            process.wait_until(line, |it| shape(it) == shape(line));
        }
        if step.output.last() == Some(&"TERMINATED") {
            assert_eq!(process.end().1, Some(0), "{}", step.line);
        }
    }
}

#[test]
fn tutorial_commands_print_what_it_shows() {
    let _alone = alone();
    let text = include_str!("../../docs/nets.md");
    let (tutorial, _) = text.split_once("\n## Language").unwrap();
    let nets: Vec<_> = blocks(tutorial, "net").collect();
    assert_eq!(nets.len(), NETS.len());
    let mut shell = Shell {
        folder: Folder::new(),
        http: String::new(),
    };
    std::fs::create_dir(shell.folder.file("run")).unwrap();
    for (name, net) in NETS.iter().zip(nets) {
        assert!(tutorial.contains(&format!("`{name}`")), "{name}");
        shell.folder.write(name, net);
    }
    let steps = steps(tutorial);
    assert_eq!(steps.len(), COMMANDS);
    let mut controller = None;
    for step in &steps {
        let words: Vec<_> = step.line.split_whitespace().take(3).collect();
        match words[..] {
            ["takt", "run", _] => {
                // Free ports are all that differs from the empty cell file.
                let stop = shell.folder.file("stop.sock");
                let cell = format!(
                    "[controller]\nwebsocket = '127.0.0.1:0'\ntcp = '127.0.0.1:0'\nstop_socket = '{stop}'\n"
                );
                shell.folder.write("cell.toml", &cell);
                let line = step.line.strip_suffix(" &").unwrap();
                let mut process = Process::spawn(shell.command(&format!("exec {line}")));
                let line = process.wait_for("DirectIO at ws");
                let (_, address) = line.rsplit_once("ws://").unwrap();
                shell.http = address.trim_end_matches("/DirectIO/").to_owned();
                process.wait_for("lines at unix");
                controller = Some(process);
            }
            ["takt", "net", "watch" | "tap"] => shell.follow(step),
            _ => shell.run(step),
        }
    }
    drop(controller);
}
