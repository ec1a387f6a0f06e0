//! Clients and their requests. The newest request of a client replaces an older one, and a client that has not shown
//! its last frames gets no new ones, so that latency cannot build up.

use super::protocol::{Control, Header, Request};
use crate::job::Error;
use crate::lock::lock;
use crate::render::Image;
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Largest number of clients.
pub const MOST_CLIENTS: usize = 4;
/// Largest number of frames sent to a client that it has not shown yet.
pub const MOST_IN_FLIGHT: u32 = 2;

/// A message to a client.
pub enum Outgoing {
    /// A picture, encoded by the client's thread.
    Frame(Header, Arc<Image>),
    /// A JSON text.
    Text(String),
}

/// One connected page.
struct Client {
    request: Option<Request>,
    in_flight: u32,
    outbox: Sender<Outgoing>,
}

#[derive(Default)]
struct Clients {
    by_id: BTreeMap<u64, Client>,
    /// The client whose request was taken last: the next one is served first.
    served: u64,
    next: u64,
    controls: Vec<Control>,
}

/// Request queue between clients and the render thread.
#[derive(Default)]
pub struct Requests {
    clients: Mutex<Clients>,
    wake: Condvar,
    /// Number of clients: all that a run reads while there are none.
    present: AtomicUsize,
    closed: AtomicBool,
}

impl Requests {
    fn clients(&self) -> MutexGuard<'_, Clients> {
        lock(&self.clients)
    }

    /// Admits a client; `None` if there are too many.
    pub(super) fn enter(&self, outbox: Sender<Outgoing>) -> Option<u64> {
        let mut clients = self.clients();
        if clients.by_id.len() >= MOST_CLIENTS || self.closed() {
            return None;
        }
        clients.next += 1;
        let id = clients.next;
        clients.by_id.insert(id, Client { request: None, in_flight: 0, outbox });
        self.present.store(clients.by_id.len(), Ordering::Release);
        Some(id)
    }

    pub(super) fn leave(&self, id: u64) {
        let mut clients = self.clients();
        clients.by_id.remove(&id);
        self.present.store(clients.by_id.len(), Ordering::Release);
    }

    /// Replaces the client's request.
    pub(super) fn request(&self, id: u64, request: Request) {
        if let Some(client) = self.clients().by_id.get_mut(&id) {
            client.request = Some(request);
            self.wake.notify_all();
        }
    }

    /// Records that a client has shown a frame.
    pub(super) fn shown(&self, id: u64) {
        if let Some(client) = self.clients().by_id.get_mut(&id) {
            client.in_flight = client.in_flight.saturating_sub(1);
            self.wake.notify_all();
        }
    }

    /// Passes on a control of the run.
    pub(super) fn control(&self, control: Control) {
        self.clients().controls.push(control);
        self.wake.notify_all();
    }

    /// True if the client waits for a picture.
    pub(super) fn awaits(&self, id: u64) -> bool {
        self.clients().by_id.get(&id).is_some_and(|c| c.request.is_some() || c.in_flight > 0)
    }

    /// Number of clients.
    pub fn present(&self) -> usize {
        self.present.load(Ordering::Acquire)
    }

    /// True if a client waits for a picture and may be sent one.
    pub fn waiting(&self) -> bool {
        self.clients().by_id.values().any(|c| c.request.is_some() && c.in_flight < MOST_IN_FLIGHT)
    }

    /// The next request to draw, with its client; waits for one for up to `patience`.
    pub fn next_request(&self, patience: Duration) -> Option<(u64, Request)> {
        let take = |clients: &mut Clients| -> Option<(u64, Request)> {
            let ready = |(id, c): (&u64, &Client)| (c.request.is_some() && c.in_flight < MOST_IN_FLIGHT).then_some(*id);
            let after = clients.by_id.range(clients.served + 1..).find_map(ready);
            let id = after.or_else(|| clients.by_id.iter().find_map(ready))?;
            clients.served = id;
            let client = clients.by_id.get_mut(&id)?;
            client.in_flight += 1;
            Some((id, client.request.take()?))
        };
        let mut clients = self.clients();
        let found = take(&mut clients);
        if found.is_some() || patience.is_zero() {
            return found;
        }
        let (mut clients, _) = self.wake.wait_timeout(clients, patience).unwrap_or_else(PoisonError::into_inner);
        take(&mut clients)
    }

    /// Controls of the run since the last call.
    pub fn controls(&self) -> Vec<Control> {
        std::mem::take(&mut self.clients().controls)
    }

    /// Sends a picture to a client.
    pub fn deliver(&self, id: u64, header: Header, image: Arc<Image>) {
        self.send(id, Outgoing::Frame(header, image));
    }

    /// Sends a client the reason why its request was not drawn.
    pub fn refuse(&self, id: u64, request: &Request, error: &Error) {
        self.shown(id);
        self.send(id, Outgoing::Text(json!({ "error": error.to_string(), "number": request.number }).to_string()));
    }

    /// Sends a text to every client.
    pub fn tell(&self, text: &str) {
        for client in self.clients().by_id.values() {
            // The client's own thread removes it once it is gone.
            let _ = client.outbox.send(Outgoing::Text(text.to_owned()));
        }
    }

    /// Tells every client how the job has ended: what pages then show in place of a lost connection.
    pub fn tell_end(&self, how: &str) {
        self.tell(&json!({ "ended": how }).to_string());
    }

    fn send(&self, id: u64, what: Outgoing) {
        if let Some(client) = self.clients().by_id.get(&id) {
            let _ = client.outbox.send(what);
        }
    }

    /// Closes all connections.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.wake.notify_all();
    }

    /// True once closed.
    pub fn closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::super::protocol::{Picture, RequestCamera};
    use super::*;
    use std::sync::mpsc::channel;

    fn request(number: u32) -> Request {
        let (camera, size) = (RequestCamera::Photo(0), [8, 8]);
        Request { number, camera, size, picture: Picture::Colour, model: 0, degree: 3, background: None, still: false }
    }

    fn next(requests: &Requests) -> Option<(u64, u32)> {
        requests.next_request(Duration::ZERO).map(|(id, w)| (id, w.number))
    }

    #[test]
    fn the_newest_request_wins_and_clients_take_turns() {
        let requests = Requests::default();
        let [a, b] = [(); 2].map(|()| requests.enter(channel().0).unwrap());
        for number in 0..500 {
            requests.request(a, request(number));
        }
        requests.request(b, request(7));
        assert_eq!(next(&requests), Some((a, 499)));
        requests.request(a, request(500));
        assert_eq!(next(&requests), Some((b, 7)));
        assert_eq!(next(&requests), Some((a, 500)));
        assert_eq!(next(&requests), None);
    }

    #[test]
    fn a_client_that_shows_nothing_is_sent_two_frames() {
        let requests = Requests::default();
        let id = requests.enter(channel().0).unwrap();
        for (number, drawn) in [(1, true), (2, true), (3, false)] {
            requests.request(id, request(number));
            assert_eq!(next(&requests).is_some(), drawn);
        }
        requests.shown(id);
        assert_eq!(next(&requests), Some((id, 3)));
    }

    #[test]
    fn a_fifth_client_stays_outside_until_one_leaves() {
        let requests = Requests::default();
        let ids: Vec<_> = (0..MOST_CLIENTS).map(|_| requests.enter(channel().0).unwrap()).collect();
        assert_eq!((requests.enter(channel().0), requests.present()), (None, 4));
        requests.leave(ids[1]);
        assert!(requests.enter(channel().0).is_some());
    }
}
