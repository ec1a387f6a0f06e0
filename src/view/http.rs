//! A minimal HTTP/1.1 server: GET and HEAD requests of at most 8 KiB within ten seconds, one per connection.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Largest head of a request in bytes.
const MOST_HEAD: usize = 8 << 10;
/// Largest number of headers.
const MOST_HEADERS: usize = 64;
/// Time limit for receiving a request, and for sending an answer.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// A request's head.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HttpRequest {
    /// True for HEAD, whose answer has no body.
    pub head: bool,
    /// Path, without the query.
    pub path: String,
    /// Query, without `?`.
    pub query: String,
    pub host: String,
    pub origin: Option<String>,
    pub cookie: String,
    /// `Sec-WebSocket-Key` of a request to upgrade.
    pub socket_key: Option<String>,
    /// Bytes received after the head.
    pub rest: Vec<u8>,
}

/// A status line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status(pub u16, pub &'static str);

impl Status {
    pub const OK: Self = Self(200, "OK");
    pub const BAD: Self = Self(400, "Bad Request");
    pub const FORBIDDEN: Self = Self(403, "Forbidden");
    pub const MISSING: Self = Self(404, "Not Found");
    pub const METHOD: Self = Self(405, "Method Not Allowed");
    pub const SLOW: Self = Self(408, "Request Timeout");
    pub const LONG: Self = Self(431, "Request Header Fields Too Large");
    pub const FULL: Self = Self(503, "Service Unavailable");
}

/// Reads a request's head.
///
/// # Errors
/// The status to answer with; `None` if the client is gone.
pub fn read(stream: &mut TcpStream) -> Result<HttpRequest, Option<Status>> {
    let deadline = Instant::now() + PATIENCE;
    let mut head = Vec::with_capacity(1024);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(Some(Status::SLOW));
        }
        stream.set_read_timeout(Some(left)).map_err(|_| None)?;
        let mut piece = [0; 1024];
        match stream.read(&mut piece) {
            Ok(0) => return Err(None),
            Ok(n) => head.extend_from_slice(&piece[..n]),
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => continue,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return Err(None),
        }
        if let Some(request) = parse(&head).map_err(Some)? {
            return Ok(request);
        }
        if head.len() > MOST_HEAD {
            return Err(Some(Status::LONG));
        }
    }
}

/// Parses a head; `None` while it is incomplete.
fn parse(bytes: &[u8]) -> Result<Option<HttpRequest>, Status> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut parsed = httparse::Request::new(&mut headers);
    let end = match parsed.parse(bytes) {
        Ok(httparse::Status::Complete(end)) if end > MOST_HEAD => return Err(Status::LONG),
        Ok(httparse::Status::Complete(end)) => end,
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::TooManyHeaders) => return Err(Status::LONG),
        Err(_) => return Err(Status::BAD),
    };
    if !matches!(parsed.method, Some("GET" | "HEAD")) {
        return Err(Status::METHOD);
    }
    let text = |value: &[u8]| std::str::from_utf8(value).map(str::to_owned).map_err(|_| Status::BAD);
    let target = parsed.path.unwrap_or_default();
    // Proxies send the whole address.
    let target = target.strip_prefix("http://").map_or(target, |rest| rest.find('/').map_or("/", |at| &rest[at..]));
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let mut request = HttpRequest {
        head: parsed.method == Some("HEAD"),
        path: path.to_owned(),
        query: query.to_owned(),
        rest: bytes[end..].to_vec(),
        ..HttpRequest::default()
    };
    for header in parsed.headers.iter() {
        match header.name.to_ascii_lowercase().as_str() {
            "host" => request.host = text(header.value)?,
            "origin" => request.origin = Some(text(header.value)?),
            "cookie" => request.cookie = text(header.value)?,
            "sec-websocket-key" => request.socket_key = Some(text(header.value)?),
            _ => {}
        }
    }
    Ok(Some(request))
}

/// A page may not load from, or send to, any other place.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// A connection whose request waits for an answer.
pub struct Reply {
    pub stream: TcpStream,
    /// True if the answer has no body.
    pub head: bool,
}

impl Reply {
    /// Writes an answer, with headers `more`, and ends the connection. Failures are ignored: the client is gone.
    pub fn answer(mut self, status: Status, kind: &str, more: &str, body: &[u8]) {
        let Status(code, reason) = status;
        let allowed = if status == Status::METHOD { "Allow: GET, HEAD\r\n" } else { "" };
        let head = format!(
            "HTTP/1.1 {code} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\nCache-Control: no-store\r\n\
             Content-Security-Policy: {POLICY}\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
             Cross-Origin-Resource-Policy: same-origin\r\n{allowed}{more}\r\n",
            body.len()
        );
        let body: &[u8] = if self.head { &[] } else { body };
        let stream = &mut self.stream;
        let _ = stream.set_write_timeout(Some(PATIENCE));
        let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(body)).and_then(|()| stream.flush());
        let _ = stream.shutdown(std::net::Shutdown::Write);
    }

    /// Answers with a sentence.
    pub fn say(self, status: Status, sentence: &str) {
        self.answer(status, "text/plain; charset=utf-8", "", format!("{sentence}\n").as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_read_whole_or_refused() {
        let head = b"GET /photo/3?a=b HTTP/1.1\r\nhost: localhost:80\r\nORIGIN: http://localhost:80\r\nCookie: a=b\r\n\r\nrest";
        let request = parse(head).unwrap().unwrap();
        assert_eq!(
            (request.path.as_str(), request.query.as_str(), request.host.as_str()),
            ("/photo/3", "a=b", "localhost:80")
        );
        assert_eq!(
            (request.cookie.as_str(), request.origin.as_deref(), &request.rest[..]),
            ("a=b", Some("http://localhost:80"), &b"rest"[..])
        );
        for end in 0..head.len() - 8 {
            assert_eq!(parse(&head[..end]), Ok(None), "{end}");
        }
        let absolute = parse(b"GET http://127.0.0.1:80/photo/3?a=b HTTP/1.1\r\n\r\n").unwrap().unwrap();
        assert_eq!((absolute.path, absolute.query), (request.path.clone(), request.query.clone()));
        assert!(!request.head && parse(b"HEAD / HTTP/1.1\r\n\r\n").unwrap().unwrap().head);
        assert_eq!(parse(b"POST / HTTP/1.1\r\n\r\n"), Err(Status::METHOD));
        assert_eq!(parse(b"\0\x01\x02"), Err(Status::BAD));
        assert_eq!(parse(format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(65)).as_bytes()), Err(Status::LONG));
        assert_eq!(parse(format!("GET /{} HTTP/1.1\r\n\r\n", "a".repeat(9000)).as_bytes()), Err(Status::LONG));
        assert_eq!(parse(b"GET / HTTP/1.1\r\nHost: \xff\r\n\r\n"), Err(Status::BAD));
    }
}
