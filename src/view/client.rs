//! The connection of one client: its requests go to the queue, and its pictures are encoded here, away from the thread
//! that draws them.

use super::protocol::{Encoding, Header, Message};
use super::requests::{Outgoing, Requests};
use super::subject::jpeg;
use crate::job::Error;
use crate::pipeline::evaluate::pictures::{byte, write_png};
use crate::render::Image;
use jpeg_encoder::SamplingFactor;
use std::io;
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};
use tungstenite::protocol::{CloseFrame, Role, WebSocketConfig, frame::coding::CloseCode};
use tungstenite::{Error as SocketError, Message as Packet, WebSocket};

/// Largest message of a client in bytes.
const MOST_MESSAGE: usize = 4 << 10;
/// Messages that a client may send per second; a page sends some 100.
const MOST_MESSAGES: u32 = 2_000;
/// Time limit for sending a picture.
const STALLED: Duration = Duration::from_secs(10);
/// Time between pings to a page, and time after which a page that does not answer counts as gone.
const ALIVE: [Duration; 2] = [Duration::from_secs(20), Duration::from_secs(60)];
/// Polling intervals of the outbox, while a picture is awaited and otherwise.
const PACES: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(20)];
/// Error kinds of a read that merely timed out; the last one follows SIGCONT.
const MEANWHILE: [io::ErrorKind; 3] = [io::ErrorKind::WouldBlock, io::ErrorKind::TimedOut, io::ErrorKind::Interrupted];
/// JPEG quality of moving pictures.
const QUALITY: u8 = 80;

/// Serves a client until one side closes the connection.
pub fn converse(stream: TcpStream, rest: Vec<u8>, requests: &Requests, control: bool) {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MOST_MESSAGE))
        .max_frame_size(Some(MOST_MESSAGE))
        .read_buffer_size(MOST_MESSAGE);
    let _ = stream.set_nodelay(true);
    let _ = stream.set_write_timeout(Some(STALLED));
    let mut socket = WebSocket::from_partially_read(stream, rest, Role::Server, Some(config));
    let (sender, outbox) = channel();
    let Some(id) = requests.enter(sender) else {
        end(&mut socket, CloseCode::Again, "four pages are connected already; close one of them");
        return;
    };
    let talk = Talk { requests, id, control, outbox };
    let (code, reason) = talk.run(&mut socket);
    requests.leave(id);
    end(&mut socket, code, reason);
}

fn end(socket: &mut WebSocket<TcpStream>, code: CloseCode, reason: &'static str) {
    let _ = socket.close(Some(CloseFrame { code, reason: reason.into() }));
    let _ = socket.flush();
}

struct Talk<'a> {
    requests: &'a Requests,
    id: u64,
    control: bool,
    outbox: Receiver<Outgoing>,
}

impl Talk<'_> {
    /// Returns the reason for closing.
    fn run(&self, socket: &mut WebSocket<TcpStream>) -> (CloseCode, &'static str) {
        let mut pace = None;
        let mut second = (Instant::now(), 0);
        let (mut heard, mut asked) = (Instant::now(), Instant::now());
        loop {
            let wanted = PACES[usize::from(!self.requests.awaits(self.id))];
            if pace != Some(wanted) {
                pace = Some(wanted);
                let _ = socket.get_ref().set_read_timeout(pace);
            }
            if asked.elapsed() > ALIVE[0] {
                asked = Instant::now();
                if heard.elapsed() > ALIVE[1] || socket.send(Packet::Ping(Vec::new().into())).is_err() {
                    return (CloseCode::Normal, "");
                }
            }
            let read = socket.read();
            if read.is_ok() {
                heard = Instant::now();
            }
            match read {
                Ok(Packet::Text(text)) => {
                    if second.0.elapsed() > Duration::from_secs(1) {
                        second = (Instant::now(), 0);
                    }
                    second.1 += 1;
                    if second.1 > MOST_MESSAGES {
                        return (CloseCode::Policy, "too many messages");
                    }
                    if let Err(reason) = self.hear(&text) {
                        return (CloseCode::Invalid, reason);
                    }
                }
                Ok(Packet::Binary(_)) => return (CloseCode::Unsupported, "messages are JSON"),
                Ok(_) => {}
                Err(SocketError::Io(e)) if MEANWHILE.contains(&e.kind()) => {}
                Err(SocketError::Capacity(_)) => return (CloseCode::Size, "a message has at most 4 kB"),
                Err(_) => return (CloseCode::Normal, ""),
            }
            // Asked before the outbox, which then holds the last news.
            let closed = self.requests.closed();
            loop {
                match self.outbox.try_recv() {
                    Ok(outgoing) => {
                        let Ok(packet) = packet(outgoing) else {
                            return (CloseCode::Error, "a picture was not encoded");
                        };
                        if socket.send(packet).is_err() {
                            return (CloseCode::Normal, "");
                        }
                    }
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return (CloseCode::Normal, ""),
                }
            }
            if closed {
                return (CloseCode::Away, "qirf-vk has ended");
            }
        }
    }

    fn hear(&self, text: &str) -> Result<(), &'static str> {
        match serde_json::from_str(text) {
            Ok(Message::Request(request)) => self.requests.request(self.id, request),
            Ok(Message::Shown(_)) => self.requests.shown(self.id),
            Ok(Message::Control(control)) if self.control => self.requests.control(control),
            Ok(Message::Control(_)) => return Err("this page cannot control the run"),
            Err(_) => return Err("this page is from another version; reload it"),
        }
        Ok(())
    }
}

fn packet(outgoing: Outgoing) -> Result<Packet, Error> {
    Ok(match outgoing {
        Outgoing::Text(text) => Packet::text(text),
        Outgoing::Frame(header, image) => Packet::binary(frame(header, &image)?),
    })
}

/// A frame's bytes: its header and its encoded picture.
fn frame(header: Header, image: &Image) -> Result<Vec<u8>, Error> {
    let mut out = header.to_bytes().to_vec();
    match header.encoding {
        Encoding::Png => write_png(&mut out, image, false).map_err(|e| Error::encoding("a PNG picture", e))?,
        Encoding::Jpeg => {
            let rgb: Vec<u8> = image.pixels.iter().flat_map(|p| [byte(p[0]), byte(p[1]), byte(p[2])]).collect();
            out.extend(jpeg(&rgb, image.width, image.height, QUALITY, SamplingFactor::F_2_2)?);
        }
    }
    Ok(out)
}
