//! A Chromium without a window, by its own protocol (CDP over WebSocket), for tests of the page. It keeps what the page reports
//! as errors.
#![allow(dead_code, reason = "each test uses a part of it")]

use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use super::common::Folder;

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
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--no-first-run",
        ];
        let quiet = ["--disable-background-networking", "--disable-dev-shm-usage"];
        command.args(flags).args(quiet);
        command.arg("--remote-debugging-port=0");
        command.arg(format!("--user-data-dir={}", profile.file("profile")));
        // A group of its own: its processes can be stopped and continued together.
        let child = std::os::unix::process::CommandExt::process_group(&mut command, 0)
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

    /// Shows the page at a width and height, in light or dark colours.
    pub(crate) fn resize(&mut self, width: u32, height: u32, is_dark: bool) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", &size);
        let value = if is_dark { "dark" } else { "light" };
        let feature = json!({ "name": "prefers-color-scheme", "value": value });
        self.call(
            "Emulation.setEmulatedMedia",
            &json!({ "features": [feature] }),
        );
    }

    /// Writes a picture of what is shown, for people, into the folder of pages in the target directory.
    pub(crate) fn picture(&mut self, name: &str) {
        let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("../page");
        std::fs::create_dir_all(&folder).unwrap();
        let shot = self.call("Page.captureScreenshot", &json!({ "format": "png" }));
        let bytes = decoded(shot["data"].as_str().unwrap());
        std::fs::write(folder.join(format!("{name}.png")), bytes).unwrap();
    }

    /// Moves the pointer into the middle of the element of a selector, which must exist, and presses or releases its button.
    #[track_caller]
    pub(crate) fn pointer(&mut self, kind: &str, selector: &str) {
        let place = format!(
            "(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'center' }}); \
             const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        );
        let place = self.value(&place);
        assert!(place[0].is_number(), "{selector} does not exist");
        let mut event = json!({ "type": "mouseMoved", "x": place[0], "y": place[1] });
        self.call("Input.dispatchMouseEvent", &event);
        event["type"] = kind.into();
        (event["button"], event["clickCount"]) = ("left".into(), 1.into());
        self.call("Input.dispatchMouseEvent", &event);
    }

    /// Clicks on the element of a selector.
    #[track_caller]
    pub(crate) fn click(&mut self, selector: &str) {
        self.pointer("mousePressed", selector);
        self.pointer("mouseReleased", selector);
    }

    /// Presses (`rawKeyDown`) or releases (`keyUp`) a key, such as `Tab`.
    pub(crate) fn key(&mut self, kind: &str, key: &str) {
        let code = match key {
            "Tab" => 9,
            "Enter" => 13,
            _ => 32,
        };
        let event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
        self.call("Input.dispatchKeyEvent", &event);
    }

    /// Runs a program in every page before its own scripts.
    pub(crate) fn before_pages(&mut self, program: &str) {
        let source = json!({ "source": program });
        self.call("Page.addScriptToEvaluateOnNewDocument", &source);
    }

    /// Saves what the page offers for saving in a folder.
    pub(crate) fn save_to(&mut self, folder: &str) {
        let into = json!({ "behavior": "allow", "downloadPath": folder });
        self.call("Browser.setDownloadBehavior", &into);
    }

    /// Sends a signal to all of its processes: SIGSTOP lets them stall, SIGCONT go on.
    pub(crate) fn signal(&self, signal: nix::sys::signal::Signal) {
        let group = i32::try_from(self.child.id()).unwrap();
        nix::sys::signal::killpg(nix::unistd::Pid::from_raw(group), signal).unwrap();
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

/// The bytes of a text in base 64.
fn decoded(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => Some(c - b'A'),
        b'a'..=b'z' => Some(c - b'a' + 26),
        b'0'..=b'9' => Some(c - b'0' + 52),
        b'+' => Some(62),
        b'/' => Some(63),
        _ => None,
    };
    let digits: Vec<u8> = text.bytes().filter_map(digit).collect();
    let group = |four: &[u8]| {
        let bits = four
            .iter()
            .fold(0_u32, |bits, digit| bits << 6 | u32::from(*digit));
        let bits = bits << (6 * (4 - four.len()));
        let [_, bytes @ ..] = bits.to_be_bytes();
        bytes[..four.len() - 1].to_vec()
    };
    digits.chunks(4).flat_map(group).collect()
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
