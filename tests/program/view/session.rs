//! A running viewer, and a client that does what its page does.

use qirf_vk::view::protocol::Header;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use tempfile::NamedTempFile;
use tungstenite::{ClientRequestBuilder, Error, Message, WebSocket};

/// The program while it shows something; it ends when dropped.
pub struct Viewer {
    child: Child,
    said: NamedTempFile,
    /// The printed address.
    pub url: String,
    /// Name and port of the server.
    pub host: String,
    /// The cookie that the token is exchanged for.
    pub cookie: String,
}

impl Viewer {
    /// Starts the program and enters with the printed address.
    pub fn start(arguments: &[&str]) -> Self {
        // Measurements name a program of the release profile, and do without validation.
        let measured = std::env::var_os("QIRF_PROGRAM");
        let mut command = Command::new(measured.clone().unwrap_or_else(|| env!("CARGO_BIN_EXE_qirf-vk").into()));
        command.args(arguments).env("QIRF_VALIDATION", if measured.is_some() { "0" } else { "1" });
        Self::of(command)
    }

    /// The same with any command of the program that prints an address.
    pub fn of(mut command: Command) -> Self {
        let said = tempfile::NamedTempFile::new().unwrap();
        // One file for both streams: `view` prints its address as a result, `run` beside its results.
        let both = std::fs::OpenOptions::new().append(true).open(said.path()).unwrap();
        let mut child = command.stdout(both.try_clone().unwrap()).stderr(both).spawn().expect("the program starts");
        let begun = Instant::now();
        let url = loop {
            let text = std::fs::read_to_string(said.path()).unwrap();
            if let Some(line) = text.lines().find(|l| l.starts_with("http://")).filter(|_| text.ends_with('\n')) {
                break line.to_owned();
            }
            assert!(child.try_wait().unwrap().is_none() && begun.elapsed() < Duration::from_secs(120), "{text}");
            std::thread::sleep(Duration::from_millis(2));
        };
        let (host, entrance) = url.strip_prefix("http://").expect("an address").split_once('/').expect("a path");
        let (host, entrance) = (host.to_owned(), format!("/{entrance}"));
        let mut viewer = Self { child, said, host, cookie: String::new(), url };
        let (status, head, _) = viewer.exchange(&viewer.request(&entrance, &[]));
        assert_eq!(status, 200);
        let set = head.lines().find_map(|l| l.strip_prefix("Set-Cookie: ")).expect("a cookie");
        assert!(set.contains("HttpOnly") && set.contains("SameSite=Strict"), "{set}");
        set.split(';').next().unwrap().clone_into(&mut viewer.cookie);
        viewer
    }

    /// The text of a GET request.
    pub fn request(&self, path: &str, headers: &[(&str, &str)]) -> String {
        let mut text = format!("GET {path} HTTP/1.1\r\n");
        if headers.iter().all(|h| h.0 != "Host") {
            text += &format!("Host: {}\r\n", self.host);
        }
        for (name, value) in headers {
            text += &format!("{name}: {value}\r\n");
        }
        text + "\r\n"
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.set_nodelay(true).unwrap(); // as browsers do
        stream
    }

    /// Status, head and body of the answer to these bytes; status 0 if there is none.
    pub fn exchange(&self, request: &str) -> (u16, String, Vec<u8>) {
        let mut stream = self.connect();
        let _ = stream.write_all(request.as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").map_or(answer.len(), |at| at + 4);
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or(0);
        (status, head, answer[end..].to_vec())
    }

    /// Status and body of a path, for a client that has entered.
    pub fn get(&self, path: &str) -> (u16, Vec<u8>) {
        let (status, _, body) = self.exchange(&self.request(path, &[("Cookie", &self.cookie)]));
        (status, body)
    }

    pub fn json(&self, path: &str) -> serde_json::Value {
        serde_json::from_slice(&self.get(path).1).expect("JSON")
    }

    /// A WebSocket of a client that has entered.
    pub fn socket(&self) -> Socket {
        let request = ClientRequestBuilder::new(format!("ws://{}/ws", self.host).parse().unwrap())
            .with_header("Origin", format!("http://{}", self.host))
            .with_header("Cookie", &self.cookie);
        Socket(tungstenite::client(request, self.connect()).expect("a WebSocket").0)
    }

    /// Presses Ctrl-C; returns the exit code.
    pub fn interrupt(mut self) -> Option<i32> {
        let _ = Command::new("kill").args(["-s", "INT", &self.child.id().to_string()]).status();
        self.child.wait().unwrap().code()
    }

    /// Waits for the end; returns the exit code.
    pub fn wait(mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }

    /// Largest resident memory of the program so far, in bytes; 0 where the system does not tell.
    pub fn peak_memory(&self) -> f64 {
        self.status("VmHWM:")
    }

    /// Resident memory of the program, in bytes; 0 where the system does not tell.
    pub fn memory(&self) -> f64 {
        self.status("VmRSS:")
    }

    /// A line of the system's status of the program, in bytes.
    fn status(&self, name: &str) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let line =
            status.lines().find_map(|l| l.strip_prefix(name)?.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
        line.unwrap_or(0.0) * 1024.0
    }

    /// Seconds that the program has computed on any core, to 10 ms; 0 where the system does not tell.
    pub fn processor_seconds(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap_or_default();
        // Behind the name in brackets: the state, then numbers; of the program itself, in user mode and in the system.
        let numbers = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace();
        numbers.skip(11).take(2).filter_map(|n| n.parse::<f64>().ok()).sum::<f64>() / 100.0
    }

    /// True while the program runs.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let said = std::fs::read_to_string(self.said.path()).unwrap_or_default();
        if !std::thread::panicking() {
            assert!(!said.contains("panicked") && !said.contains("validation:"), "{said}");
        }
    }
}

/// A client's side of the conversation.
pub struct Socket(WebSocket<TcpStream>);

impl Socket {
    pub fn send(&mut self, text: &str) {
        self.0.send(Message::text(text)).expect("the message leaves");
    }

    /// The next frame; an error holds the reason for which the server ended.
    pub fn frame(&mut self) -> Result<(Header, Vec<u8>), String> {
        loop {
            match self.0.read() {
                Ok(Message::Binary(bytes)) => {
                    let header = Header::from_bytes(&bytes).expect("a header");
                    return Ok((header, bytes[Header::BYTES..].to_vec()));
                }
                Ok(Message::Text(text)) => return Err(text.to_string()),
                Ok(Message::Close(why)) => return Err(why.map(|w| w.reason.to_string()).unwrap_or_default()),
                Ok(_) => {}
                Err(e) => return Err(e.to_string()),
            }
        }
    }

    /// The next frame, if one comes in time.
    pub fn frame_within(&mut self, patience: Duration) -> Option<(Header, Vec<u8>)> {
        self.0.get_ref().set_read_timeout(Some(patience)).unwrap();
        let read = self.0.read();
        self.0.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        match read {
            Ok(Message::Binary(bytes)) => Some((Header::from_bytes(&bytes).unwrap(), bytes[Header::BYTES..].to_vec())),
            Err(Error::Io(e)) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => None,
            other => panic!("{other:?}"),
        }
    }

    /// Wishes for a picture, waits for it and acknowledges it.
    pub fn picture(&mut self, request: &str) -> (Header, Vec<u8>) {
        self.send(request);
        let frame = self.frame().unwrap_or_else(|e| panic!("{request}: {e}"));
        self.send(r#"{"shown":0}"#);
        frame
    }

    /// Sends a text; fails if the server has ended the conversation.
    pub fn try_send(&mut self, text: &str) -> Result<(), Error> {
        self.0.send(Message::text(text))
    }

    /// As [`Socket::picture`], but returns the server's reason for ending the conversation.
    pub fn frame_or_refusal(&mut self, request: &str) -> Result<(Header, Vec<u8>), String> {
        self.try_send(request).map_err(|e| e.to_string())?;
        self.frame()
    }

    /// Waits for the server's end of the conversation, and returns its reason.
    pub fn goodbye(&mut self) -> String {
        let begun = Instant::now();
        loop {
            assert!(begun.elapsed() < Duration::from_secs(20), "the conversation goes on");
            if let Err(reason) = self.frame() {
                return reason;
            }
        }
    }
}

/// A request from a camera.
pub fn request(number: u32, camera: &str, more: &str) -> String {
    let comma = if more.is_empty() { "" } else { "," };
    format!(r#"{{"request":{{"number":{number},"camera":{camera},"size":[64,48]{comma}{more}}}}}"#)
}

/// A request from a free camera among the scene's.
pub fn pose(more: &str, number: u32) -> String {
    request(number, r#"{"pose":{"position":[0,-1,-6],"rotation":[1,0,0,0],"fov":0.9}}"#, more)
}
