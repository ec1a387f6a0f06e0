//! Serves the page, the subject's description, its photos, and the WebSocket.

use super::client::converse;
use super::guard::{Asked, Guard, Verdict};
use super::http::{self, HttpRequest, Status};
use super::requests::Requests;
use super::subject::{Job, Subject};
use crate::job::Error;
use std::io::Write;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tungstenite::handshake::derive_accept_key;

/// Largest number of connections at a time.
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
        let refused =
            |e: std::io::Error| Error::Usage(format!("cannot listen on {wanted}: {e}; choose another --port"));
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
    for stream in listener.incoming() {
        if site.requests.closed() {
            return;
        }
        let Ok(mut stream) = stream else {
            // Perhaps too many files are open: another connection may close soon.
            std::thread::sleep(PAUSE);
            continue;
        };
        if site.connections.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS {
            site.connections.fetch_sub(1, Ordering::AcqRel);
            http::say(&mut stream, Status::FULL, "too many connections");
            continue;
        }
        let connected = Connected(Arc::clone(site));
        // A connection for which the system has no thread is closed.
        let _ = std::thread::Builder::new().spawn(move || connected.0.serve(stream));
    }
}

/// A connection that counts until it is dropped.
struct Connected(Arc<Site>);

impl Drop for Connected {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Site {
    fn serve(&self, mut stream: TcpStream) {
        let request = match http::read(&mut stream) {
            Ok(request) => request,
            Err(Some(status)) => return http::say(&mut stream, status, status.1),
            Err(None) => return,
        };
        let asked = Asked {
            query: &request.query,
            host: &request.host,
            origin: request.origin.as_deref(),
            cookie: &request.cookie,
            socket: request.path == "/ws",
        };
        match self.guard.check(asked) {
            Verdict::Refuse(why) => http::say(&mut stream, Status::FORBIDDEN, why),
            // No redirect: after a click on another site's link, browsers would send it without the cookie.
            Verdict::Enter => {
                let more = format!("Set-Cookie: {}\r\n", self.guard.cookie());
                http::answer(&mut stream, Status::OK, "text/html; charset=utf-8", &more, PAGE.as_bytes());
            }
            Verdict::Pass => self.answer(stream, request),
        }
    }

    fn answer(&self, mut stream: TcpStream, request: HttpRequest) {
        let stream_ref = &mut stream;
        match request.path.as_str() {
            "/" => http::answer(stream_ref, Status::OK, "text/html; charset=utf-8", "", PAGE.as_bytes()),
            "/page.css" => http::answer(stream_ref, Status::OK, "text/css; charset=utf-8", "", STYLE.as_bytes()),
            "/scene.json" => {
                http::answer(stream_ref, Status::OK, "application/json", "", self.description.as_bytes());
            }
            "/ws" => match request.socket_key {
                Some(key) => self.upgrade(stream, &key, request.rest),
                None => http::say(stream_ref, Status::BAD, "this path is for a WebSocket"),
            },
            path => match (script(path), photo_number(path)) {
                (Some(text), _) => {
                    http::answer(stream_ref, Status::OK, "text/javascript; charset=utf-8", "", text.as_bytes());
                }
                (_, Some(n)) => self.photo(stream_ref, n),
                _ => http::say(stream_ref, Status::MISSING, "there is nothing here"),
            },
        }
    }

    fn photo(&self, stream: &mut TcpStream, n: usize) {
        let capture = self.subject.capture.as_ref().filter(|c| n < c.scene.views.len());
        let Some(capture) = capture else { return http::say(stream, Status::MISSING, "there is no such photo") };
        match capture.photo_jpeg(n, self.subject.background) {
            Ok(bytes) => http::answer(stream, Status::OK, "image/jpeg", "", &bytes),
            Err(e) => http::say(stream, Status::MISSING, &e.to_string()),
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
