//! Clients and their wishes. The newest wish of a client replaces an older one, and a client that has not shown its last frames
//! gets no others, so that latency cannot build up.

use super::protocol::{Control, Header, Wish};
use crate::pipeline::Error;
use crate::render::Image;
use serde_json::json;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Largest number of clients.
pub const MOST_CLIENTS: usize = 4;
/// Largest number of frames that a client was sent and has not shown.
pub const MOST_IN_FLIGHT: u32 = 2;

/// A message to a client.
pub enum Outgoing {
    /// A picture, encoded by the client's thread.
    Frame(Header, Arc<Image>),
    /// A JSON text.
    Text(String),
}

/// One page.
struct Client {
    wish: Option<Wish>,
    in_flight: u32,
    outbox: Sender<Outgoing>,
}

#[derive(Default)]
struct Guests {
    clients: BTreeMap<u64, Client>,
    /// The client whose wish was taken last: the next one is served first.
    served: u64,
    next: u64,
    controls: Vec<Control>,
}

/// Request queue between clients and the render thread.
#[derive(Default)]
pub struct Lobby {
    guests: Mutex<Guests>,
    bell: Condvar,
    /// Number of clients: what a run without any reads.
    present: AtomicUsize,
    closed: AtomicBool,
}

impl Lobby {
    fn guests(&self) -> MutexGuard<'_, Guests> {
        self.guests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a client in; none if there are too many.
    pub(super) fn enter(&self, outbox: Sender<Outgoing>) -> Option<u64> {
        let mut guests = self.guests();
        if guests.clients.len() >= MOST_CLIENTS || self.closed() {
            return None;
        }
        guests.next += 1;
        let id = guests.next;
        guests.clients.insert(id, Client { wish: None, in_flight: 0, outbox });
        self.present.store(guests.clients.len(), Ordering::Release);
        Some(id)
    }

    pub(super) fn leave(&self, id: u64) {
        let mut guests = self.guests();
        guests.clients.remove(&id);
        self.present.store(guests.clients.len(), Ordering::Release);
    }

    /// Replaces the client's wish.
    pub(super) fn wish(&self, id: u64, wish: Wish) {
        if let Some(client) = self.guests().clients.get_mut(&id) {
            client.wish = Some(wish);
            self.bell.notify_all();
        }
    }

    /// Notes that a client has shown a frame.
    pub(super) fn shown(&self, id: u64) {
        if let Some(client) = self.guests().clients.get_mut(&id) {
            client.in_flight = client.in_flight.saturating_sub(1);
            self.bell.notify_all();
        }
    }

    /// Passes on a request to steer the run.
    pub(super) fn control(&self, control: Control) {
        self.guests().controls.push(control);
        self.bell.notify_all();
    }

    /// True if the client waits for a picture.
    pub(super) fn awaits(&self, id: u64) -> bool {
        self.guests().clients.get(&id).is_some_and(|c| c.wish.is_some() || c.in_flight > 0)
    }

    /// Number of clients.
    pub fn present(&self) -> usize {
        self.present.load(Ordering::Acquire)
    }

    /// True if a client waits for a picture that it can be sent.
    pub fn waiting(&self) -> bool {
        self.guests().clients.values().any(|c| c.wish.is_some() && c.in_flight < MOST_IN_FLIGHT)
    }

    /// The next wish to fulfil, with its client; waits for one until `patience` is over.
    pub fn next_wish(&self, patience: Duration) -> Option<(u64, Wish)> {
        let take = |guests: &mut Guests| -> Option<(u64, Wish)> {
            let ready = |(id, c): (&u64, &Client)| (c.wish.is_some() && c.in_flight < MOST_IN_FLIGHT).then_some(*id);
            let after = guests.clients.range(guests.served + 1..).find_map(ready);
            let id = after.or_else(|| guests.clients.iter().find_map(ready))?;
            guests.served = id;
            let client = guests.clients.get_mut(&id)?;
            client.in_flight += 1;
            Some((id, client.wish.take()?))
        };
        let mut guests = self.guests();
        let found = take(&mut guests);
        if found.is_some() || patience.is_zero() {
            return found;
        }
        let (mut guests, _) = self.bell.wait_timeout(guests, patience).unwrap_or_else(PoisonError::into_inner);
        take(&mut guests)
    }

    /// Requests to steer the run since the last call.
    pub fn controls(&self) -> Vec<Control> {
        std::mem::take(&mut self.guests().controls)
    }

    /// Sends a picture to a client.
    pub fn deliver(&self, id: u64, header: Header, image: Arc<Image>) {
        self.send(id, Outgoing::Frame(header, image));
    }

    /// Tells a client why the picture that it wished for does not come.
    pub fn refuse(&self, id: u64, wish: &Wish, error: &Error) {
        self.shown(id);
        self.send(id, Outgoing::Text(json!({ "error": error.to_string(), "number": wish.number }).to_string()));
    }

    /// Sends a text to every client.
    pub fn tell(&self, text: &str) {
        for client in self.guests().clients.values() {
            // A client that is gone is removed by its own thread.
            let _ = client.outbox.send(Outgoing::Text(text.to_owned()));
        }
    }

    fn send(&self, id: u64, what: Outgoing) {
        if let Some(client) = self.guests().clients.get(&id) {
            let _ = client.outbox.send(what);
        }
    }

    /// Ends all conversations.
    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.bell.notify_all();
    }

    /// True once closed.
    pub fn closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::super::protocol::{Eye, Picture};
    use super::*;
    use std::sync::mpsc::channel;

    fn wish(number: u32) -> Wish {
        let (camera, size) = (Eye::Photo(0), [8, 8]);
        Wish { number, camera, size, picture: Picture::Colour, model: 0, degree: 3, background: None, still: false }
    }

    fn next(lobby: &Lobby) -> Option<(u64, u32)> {
        lobby.next_wish(Duration::ZERO).map(|(id, w)| (id, w.number))
    }

    #[test]
    fn the_newest_wish_wins_and_clients_take_turns() {
        let lobby = Lobby::default();
        let [a, b] = [(); 2].map(|()| lobby.enter(channel().0).unwrap());
        for number in 0..500 {
            lobby.wish(a, wish(number));
        }
        lobby.wish(b, wish(7));
        assert_eq!(next(&lobby), Some((a, 499)));
        lobby.wish(a, wish(500));
        assert_eq!(next(&lobby), Some((b, 7)));
        assert_eq!(next(&lobby), Some((a, 500)));
        assert_eq!(next(&lobby), None);
    }

    #[test]
    fn a_client_that_shows_nothing_is_sent_two_frames() {
        let lobby = Lobby::default();
        let id = lobby.enter(channel().0).unwrap();
        for (number, drawn) in [(1, true), (2, true), (3, false)] {
            lobby.wish(id, wish(number));
            assert_eq!(next(&lobby).is_some(), drawn);
        }
        lobby.shown(id);
        assert_eq!(next(&lobby), Some((id, 3)));
    }

    #[test]
    fn a_fifth_client_stays_outside_until_one_leaves() {
        let lobby = Lobby::default();
        let ids: Vec<_> = (0..MOST_CLIENTS).map(|_| lobby.enter(channel().0).unwrap()).collect();
        assert_eq!((lobby.enter(channel().0), lobby.present()), (None, 4));
        lobby.leave(ids[1]);
        assert!(lobby.enter(channel().0).is_some());
    }
}
