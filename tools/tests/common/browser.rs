//! A Chromium without a window, by its own protocol (CDP over WebSocket), for tests of the page. It keeps what the page reports
//! as errors.

use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use super::Folder;

/// Programs of Debian and others.
const PROGRAMS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// After this time a test gives up; far longer than anything takes on a busy host.
const TIMEOUT: Duration = Duration::from_secs(90);

/// A browser with one page.
pub(crate) struct Browser {
    child: Child,
    socket: WebSocket<TcpStream>,
    session: Value,
    id: u64,
    /// Errors and uncaught exceptions of the page.
    pub(crate) errors: Vec<String>,
    _profile: Folder,
}

impl Browser {
    /// Starts it, or says why it cannot.
    pub(crate) fn start() -> Result<Self, String> {
        let works = |program: &&&str| {
            let version = Command::new(program).arg("--version").output();
            version.is_ok_and(|output| output.status.success())
        };
        let program = PROGRAMS.iter().find(works);
        let program = program.ok_or("needs Chromium (Debian package chromium)")?;
        let profile = Folder::new();
        let mut command = Command::new(program);
        // Without a sandbox, as root has none; the page is our own.
        let flags = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
        ];
        let quiet = ["--disable-background-networking", "--disable-dev-shm-usage"];
        command.args(flags).args(quiet);
        command.arg("--remote-debugging-port=0");
        command.arg(format!("--user-data-dir={}", profile.file("profile")));
        let child = command
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| format!("needs {program}, which does not start: {error}"))?;
        let address = address(&profile.file("profile/DevToolsActivePort"));
        let address = address.ok_or_else(|| format!("needs a {program} with a debugging port"))?;
        let stream = TcpStream::connect(address.split('/').next().unwrap()).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let (socket, _) = tungstenite::client(format!("ws://{address}"), stream).unwrap();
        let mut browser = Self {
            child,
            socket,
            session: Value::Null,
            id: 0,
            errors: Vec::new(),
            _profile: profile,
        };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        browser.session = browser.call("Target.attachToTarget", &attach)["sessionId"].clone();
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.call(domain, &json!({}));
        }
        Ok(browser)
    }

    /// Opens an address.
    pub(crate) fn open(&mut self, url: &str) {
        let opened = self.call("Page.navigate", &json!({ "url": url }));
        assert!(opened["errorText"].is_null(), "{url}: {opened}");
    }

    /// The value of an expression in the page.
    pub(crate) fn value(&mut self, expression: &str) -> Value {
        let asked =
            json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", &asked);
        answer["result"]["value"].clone()
    }

    /// The shown text of an element of the page, or of the whole page.
    pub(crate) fn text(&mut self, id: &str) -> String {
        let element = match id {
            "" => "document.body".to_owned(),
            _ => format!("document.getElementById('{id}')"),
        };
        let value = self.value(&format!("{element}?.innerText ?? ''"));
        value.as_str().unwrap_or_default().to_owned()
    }

    /// Waits until the text of an element contains `part`; returns it.
    #[track_caller]
    pub(crate) fn wait_for(&mut self, id: &str, part: &str) -> String {
        let until = Instant::now() + TIMEOUT;
        loop {
            let text = self.text(id);
            if text.contains(part) {
                return text;
            }
            let all = "document.body.innerText";
            assert!(
                Instant::now() < until,
                "`{part}` does not appear in {id}: {text}\n{}\nerrors: {:?}",
                self.value(all),
                self.errors
            );
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Calls a method and returns its result; events until then are looked at.
    fn call(&mut self, method: &str, params: &Value) -> Value {
        self.id += 1;
        let mut text = json!({ "id": self.id, "method": method, "params": params });
        if !self.session.is_null() {
            text["sessionId"] = self.session.clone();
        }
        self.socket.send(Message::text(text.to_string())).unwrap();
        loop {
            let message = self.socket.read().unwrap();
            let Message::Text(text) = message else {
                continue;
            };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.id {
                assert!(message["error"].is_null(), "{method}: {message}");
                return message["result"].clone();
            }
            self.errors.extend(error(&message));
        }
    }
}

/// The error that an event reports.
fn error(event: &Value) -> Option<String> {
    let params = &event["params"];
    let is_error = match event["method"].as_str()? {
        "Runtime.exceptionThrown" => true,
        "Runtime.consoleAPICalled" => params["type"] == "error",
        "Log.entryAdded" => params["entry"]["level"] == "error",
        _ => false,
    };
    is_error.then(|| params.to_string())
}

/// Host, port and path of the debugging port, from the file that the browser writes.
fn address(file: &str) -> Option<String> {
    let until = Instant::now() + TIMEOUT;
    while Instant::now() < until {
        let text = std::fs::read_to_string(file).unwrap_or_default();
        if let Some((port, path)) = text.split_once('\n') {
            return Some(format!("127.0.0.1:{port}{}", path.trim_end()));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    None
}

impl Drop for Browser {
    fn drop(&mut self) {
        let close = json!({ "id": 0, "method": "Browser.close" }).to_string();
        // It ends its own processes if asked; it may have ended already.
        let _ = self.socket.send(Message::text(close));
        let until = Instant::now() + Duration::from_secs(10);
        while Instant::now() < until && matches!(self.child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(50));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
