//! Serves the page, the subject's description, its photos, and the WebSocket.

use super::client::converse;
use super::guard::{Asked, Guard, Verdict};
use super::http::{self, HttpRequest, Reply, Status};
use super::requests::Requests;
use super::subject::{Job, Subject};
use crate::job::Error;
use crate::lock::lock;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tungstenite::handshake::derive_accept_key;

/// Largest number of connections at a time. One more takes the place of the oldest that has not sent a request, so that strangers
/// cannot keep users out by connections alone.
const MOST_CONNECTIONS: usize = 32;

/// Time for pages to receive the message that the program ends.
const FAREWELL: Duration = Duration::from_millis(300);
/// Time before the next connection is accepted after one could not be.
const PAUSE: Duration = Duration::from_millis(50);

const PAGE: &str = include_str!("page.html");
const SCRIPTS: [(&str, &str); 4] = [
    ("/camera.js", include_str!("camera.js")),
    ("/draw.js", include_str!("draw.js")),
    ("/input.js", include_str!("input.js")),
    ("/page.js", include_str!("page.js")),
];
const STYLE: &str = include_str!("page.css");

/// The address that a server listens on, and its limits.
#[derive(Clone, Copy, Debug)]
pub struct ServerOptions {
    /// Address to bind.
    pub host: IpAddr,
    /// Port; 0 for any that is free.
    pub port: u16,
    /// True if a page may pause, checkpoint and stop a run.
    pub control: bool,
}

/// State shared by all connections.
struct Site {
    guard: Guard,
    requests: Arc<Requests>,
    subject: Arc<Subject>,
    description: String,
    control: bool,
    connections: AtomicUsize,
    /// Connections that have not sent a request, by the order in which they came.
    silent: Mutex<BTreeMap<u64, TcpStream>>,
}

/// A listening server; it stops when dropped.
pub struct Server {
    site: Arc<Site>,
    address: SocketAddr,
}

impl Server {
    /// Listens and answers on its own threads.
    ///
    /// # Errors
    /// [`Error::Usage`] if the address cannot be bound; [`Error::Threads`].
    pub fn start(options: &ServerOptions, subject: Arc<Subject>, device: &str) -> Result<Self, Error> {
        let wanted = SocketAddr::new(options.host, options.port);
        let refused = |e: io::Error| {
            Error::Usage(if e.kind() == io::ErrorKind::AddrNotAvailable {
                format!("cannot listen: {} is not an address of this machine; choose another --host", options.host)
            } else {
                format!("cannot listen on {wanted}: {e}; choose another --port")
            })
        };
        let listener = TcpListener::bind(wanted).map_err(refused)?;
        let address = listener.local_addr().map_err(refused)?;
        let control = options.control && subject.job != Job::Show;
        let description = subject.description(device, control).to_string();
        let site = Arc::new(Site {
            guard: Guard::new(options.host, address.port()).map_err(refused)?,
            requests: Arc::new(Requests::default()),
            subject,
            description,
            control,
            connections: AtomicUsize::new(0),
            silent: Mutex::default(),
        });
        let serving = Arc::clone(&site);
        let accepting = std::thread::Builder::new().spawn(move || accept(&listener, &serving));
        accepting.map_err(|e| Error::Threads(e.to_string()))?;
        Ok(Self { site, address })
    }

    /// The address to open in a browser. It contains the token.
    pub fn url(&self) -> String {
        let ip = if self.address.ip().is_unspecified() { own_address() } else { None };
        let address = SocketAddr::new(ip.unwrap_or(self.address.ip()), self.address.port());
        format!("http://{address}{}", self.site.guard.entrance())
    }

    /// The request queue.
    pub fn requests(&self) -> &Requests {
        &self.site.requests
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.site.requests.close();
        // Wakes the listener, which then ends.
        let here = match self.address.ip() {
            ip if ip.is_unspecified() => SocketAddr::new(IpAddr::from([127, 0, 0, 1]), self.address.port()),
            _ => self.address,
        };
        let _ = TcpStream::connect_timeout(&here, Duration::from_millis(200));
        // Pages are notified, unless one does not read.
        let begun = Instant::now();
        while self.site.requests.present() > 0 && begun.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// This machine's address as seen by other machines; no packet is sent to find it.
fn own_address() -> Option<IpAddr> {
    let socket = UdpSocket::bind("0.0.0.0:0").ok()?;
    socket.connect("192.0.2.1:9").ok()?;
    socket.local_addr().ok().map(|a| a.ip())
}

fn accept(listener: &TcpListener, site: &Arc<Site>) {
    for (number, stream) in (0..).zip(listener.incoming()) {
        if site.requests.closed() {
            return;
        }
        let Ok(stream) = stream else {
            // Perhaps too many files are open: another connection may close soon.
            std::thread::sleep(PAUSE);
            continue;
        };
        let full = site.connections.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS;
        let connected = Connected { site: Arc::clone(site), number };
        if full && !site.end_silent() {
            Reply { stream, head: false }.say(Status::FULL, "too many connections");
            continue;
        }
        let Ok(twin) = stream.try_clone() else { continue };
        lock(&site.silent).insert(number, twin);
        // A connection for which the system has no thread is closed.
        let _ = std::thread::Builder::new().spawn(move || connected.serve(stream));
    }
}

/// A connection that counts until it is dropped.
struct Connected {
    site: Arc<Site>,
    number: u64,
}

impl Connected {
    fn serve(&self, mut stream: TcpStream) {
        let read = http::read(&mut stream);
        self.heard();
        match read {
            Ok(request) => self.site.serve(stream, request),
            Err(Some(status)) => Reply { stream, head: false }.say(status, status.1),
            Err(None) => {}
        }
    }

    /// Notes that it has sent a request, or never will.
    fn heard(&self) {
        lock(&self.site.silent).remove(&self.number);
    }
}

impl Drop for Connected {
    fn drop(&mut self) {
        self.heard();
        self.site.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Site {
    /// Ends the oldest connection that has not sent a request; returns false if there is none.
    fn end_silent(&self) -> bool {
        let oldest = lock(&self.silent).pop_first();
        let Some((_, stream)) = oldest else { return false };
        // An error means that it has ended by itself.
        let _ = stream.shutdown(Shutdown::Both);
        true
    }

    fn serve(&self, stream: TcpStream, request: HttpRequest) {
        let asked = Asked {
            query: &request.query,
            host: &request.host,
            origin: request.origin.as_deref(),
            cookie: &request.cookie,
            socket: request.path == "/ws",
        };
        let reply = Reply { stream, head: request.head };
        match self.guard.check(asked) {
            Verdict::Refuse(why) => reply.say(Status::FORBIDDEN, why),
            // No redirect: after a click on another site's link, browsers would send it without the cookie.
            Verdict::Enter => self.answer(reply, request, &format!("Set-Cookie: {}\r\n", self.guard.cookie())),
            Verdict::Pass => self.answer(reply, request, ""),
        }
    }

    /// Answers a request of somebody who may look, with headers `more`.
    fn answer(&self, reply: Reply, request: HttpRequest, more: &str) {
        match request.path.as_str() {
            "/" => reply.answer(Status::OK, "text/html; charset=utf-8", more, PAGE.as_bytes()),
            "/page.css" => reply.answer(Status::OK, "text/css; charset=utf-8", more, STYLE.as_bytes()),
            "/scene.json" => reply.answer(Status::OK, "application/json", more, self.description.as_bytes()),
            "/ws" => match request.socket_key {
                Some(key) if !request.head => self.upgrade(reply.stream, &key, request.rest),
                _ => reply.say(Status::BAD, "this path is for a WebSocket"),
            },
            path => match (script(path), photo_number(path)) {
                (Some(text), _) => reply.answer(Status::OK, "text/javascript; charset=utf-8", more, text.as_bytes()),
                (_, Some(n)) => self.photo(reply, n, more),
                _ => reply.say(Status::MISSING, "there is nothing here"),
            },
        }
    }

    fn photo(&self, reply: Reply, n: usize, more: &str) {
        let capture = self.subject.capture.as_ref().filter(|c| n < c.scene.views.len());
        let Some(capture) = capture else { return reply.say(Status::MISSING, "there is no such photo") };
        match capture.photo_jpeg(n, self.subject.background) {
            Ok(bytes) => reply.answer(Status::OK, "image/jpeg", more, &bytes),
            Err(e) => reply.say(Status::MISSING, &e.to_string()),
        }
    }

    fn upgrade(&self, mut stream: TcpStream, key: &str, rest: Vec<u8>) {
        let accept = derive_accept_key(key.as_bytes());
        let head = format!(
            "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\r\n"
        );
        if stream.write_all(head.as_bytes()).is_ok() {
            converse(stream, rest, &self.requests, self.control);
        }
    }
}

fn script(path: &str) -> Option<&'static str> {
    SCRIPTS.iter().find(|(name, _)| *name == path).map(|(_, text)| *text)
}

/// `/photo/12`; digits only, so that no path leads anywhere else.
fn photo_number(path: &str) -> Option<usize> {
    let digits = path.strip_prefix("/photo/")?;
    digits.bytes().all(|b| b.is_ascii_digit()).then(|| digits.parse().ok()).flatten()
}
