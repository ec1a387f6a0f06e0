//! A headless Chromium, controlled through its debugging protocol.

use super::skip;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

/// Names of the program.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// Time limit, long enough for a loaded machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser with one page.
pub struct Browser {
    child: Child,
    _profile: TempDir,
    socket: WebSocket<TcpStream>,
    number: u64,
    /// Messages that the page logged, and errors that it threw.
    pub complaints: Vec<String>,
    /// Addresses that it requested.
    pub requests: Vec<String>,
}

fn installed() -> Option<&'static str> {
    let path = std::env::var_os("PATH")?;
    NAMES.into_iter().find(|name| std::env::split_paths(&path).any(|folder| Path::new(&folder).join(name).is_file()))
}

fn connect(url: &str) -> WebSocket<TcpStream> {
    let host = url.strip_prefix("ws://").unwrap().split('/').next().unwrap();
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    tungstenite::client(url, stream).expect("the debugging port").0
}

impl Browser {
    /// Opens a page; `None` if no browser is installed, and the test is skipped.
    pub fn open(url: &str) -> Option<Self> {
        let Some(program) = installed() else {
            skip("no chromium");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new(program)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--enable-unsafe-swiftshader",
                "--remote-debugging-port=0",
                "--window-size=1000,700",
            ])
            .args(["--no-first-run", "--disable-extensions", "--disable-background-networking", "about:blank"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the browser starts");
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines.find_map(|l| Some(l.ok()?.strip_prefix("DevTools listening on ")?.to_owned()));
        let address = address.expect("the browser tells its debugging port");
        std::thread::spawn(move || lines.for_each(drop));
        let mut browser = Self {
            child,
            _profile: profile,
            socket: connect(&address),
            number: 0,
            complaints: Vec::new(),
            requests: Vec::new(),
        };
        let target = browser.call("Target.createTarget", &json!({ "url": "about:blank" }));
        let host = address.strip_prefix("ws://").unwrap().split('/').next().unwrap();
        browser.socket = connect(&format!("ws://{host}/devtools/page/{}", target["targetId"].as_str().unwrap()));
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        browser.call("Page.navigate", &json!({ "url": url }));
        Some(browser)
    }

    /// Calls a method of the protocol; records the events that arrive before its result.
    pub fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.number += 1;
        let text = json!({ "id": self.number, "method": method, "params": parameters }).to_string();
        self.socket.send(Message::text(text)).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().expect("the browser answers") else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.number {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            self.note(&message);
        }
    }

    fn note(&mut self, event: &Value) {
        let parameters = &event["params"];
        match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => self.complaints.push(parameters["exceptionDetails"].to_string()),
            "Runtime.consoleAPICalled" => self.complaints.push(parameters["args"].to_string()),
            "Log.entryAdded" => self.complaints.push(parameters["entry"].to_string()),
            "Network.requestWillBeSent" => {
                self.requests.push(parameters["request"]["url"].as_str().unwrap_or_default().to_owned());
            }
            "Network.webSocketCreated" => self.requests.push(parameters["url"].as_str().unwrap_or_default().to_owned()),
            _ => {}
        }
    }

    /// The value of an expression on the page, once it has settled.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", &parameters);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    #[track_caller]
    pub fn until(&mut self, expression: &str) {
        let begun = Instant::now();
        // An expression about objects that the page has not created yet is not true yet.
        let settled = format!("(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()");
        while self.value(&settled) != json!(true) {
            if begun.elapsed() > PATIENCE {
                let said = self.value("document.body.innerText");
                panic!("never true: {expression}\n{said}\n{:?}", self.complaints);
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// A mouse event at a position on the page.
    pub fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], more: &Value) {
        let mut parameters = json!({ "type": kind, "x": x, "y": y, "button": "left", "clickCount": 1 });
        for (key, value) in more.as_object().into_iter().flatten() {
            parameters[key] = value.clone();
        }
        self.call("Input.dispatchMouseEvent", &parameters);
    }

    /// Presses and releases a key.
    pub fn key(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", &json!({ "type": kind, "key": key }));
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
