//! The photos of a run in memory that kernels can read: all on the device if they fit its share, otherwise sent one at
//! a time from the host's memory or a file.

use super::error::Result;
use crate::gpu::{Buffer, Device, Feed, Recording};
use crate::scene::{Photo, Pixels};
use std::io;
use std::thread::{self, JoinHandle};

/// Share of the device's memory that photos may take.
const DEVICE_SHARE: u64 = 4;
/// Recordings in flight, the one being made included: while the device works on one iteration, the next are encoded and
/// their photos written to staging memory.
pub(super) const UNDER_WAY: usize = 3;

/// Photos readable by kernels: one word per pixel, red in its lowest byte.
pub enum DevicePhotos {
    /// All on the device.
    Resident(Vec<Buffer<u32>>),
    /// Sent one at a time, with each iteration.
    Streamed(Stream),
}

/// Room for one photo on the device, staging memory, and the photo that a thread reads ahead: its number and its words.
pub struct Stream {
    room: Buffer<u32>,
    feed: Feed<u32>,
    ahead: Option<(usize, JoinHandle<io::Result<Vec<u32>>>)>,
}

impl Stream {
    /// The words of photo `at`, read ahead or now; starts reading `next` ahead.
    fn take(&mut self, photos: &[Photo], at: usize, next: usize) -> io::Result<Vec<u32>> {
        let here = match self.ahead.take() {
            Some((number, thread)) if number == at => {
                thread.join().unwrap_or_else(|_| Err(io::Error::other("the reading thread ended early")))
            }
            _ => words(&photos[at].pixels),
        };
        let pixels = photos[next].pixels.clone();
        // If no thread can be started, the photo is read when it is needed.
        self.ahead = thread::Builder::new().spawn(move || words(&pixels)).ok().map(|thread| (next, thread));
        here
    }
}

impl DevicePhotos {
    /// Device bytes for photos of these sizes under a memory limit, all in bytes.
    pub fn bytes(sizes: &[u64], limit: u64) -> u64 {
        let all = sizes.iter().sum();
        let largest = sizes.iter().copied().max().unwrap_or(0);
        if Self::fit(all, limit) { all } else { largest + Feed::<u32>::bytes(largest as usize / 4, UNDER_WAY) }
    }

    fn fit(bytes: u64, limit: u64) -> bool {
        bytes <= limit / DEVICE_SHARE
    }

    /// Uploads all photos if they take at most a quarter of the memory allowed; otherwise makes room for one.
    pub fn new(device: &Device, photos: &[Photo]) -> Result<Self> {
        let bytes: u64 = photos.iter().map(|p| p.pixels.len() as u64).sum();
        if Self::fit(bytes, device.memory_limit()) {
            let upload = |p: &Photo| Ok(device.upload("photo", &words(&p.pixels)?)?);
            return photos.iter().map(upload).collect::<Result<_>>().map(Self::Resident);
        }
        let largest = photos.iter().map(|p| p.pixels.len() / 4).max().unwrap_or(0);
        let feed = Feed::new(device, "photo under way", largest, UNDER_WAY)?;
        Ok(Self::Streamed(Stream { room: device.buffer("photo", largest)?, feed, ahead: None }))
    }

    /// The buffer of photo `at` for commands recorded after this; `next` is expected after it. A streamed photo
    /// replaces the previous one, so recordings must be submitted in the order in which they were made.
    pub fn get(&mut self, recording: &mut Recording, photos: &[Photo], at: usize, next: usize) -> Result<&Buffer<u32>> {
        match self {
            Self::Resident(all) => Ok(&all[at]),
            Self::Streamed(stream) => {
                let words = stream.take(photos, at, next)?;
                stream.feed.record(recording, &words, &stream.room)?;
                Ok(&stream.room)
            }
        }
    }
}

fn words(pixels: &Pixels) -> io::Result<Vec<u32>> {
    Ok(pixels.read()?.chunks_exact(4).map(|p| u32::from_le_bytes([p[0], p[1], p[2], p[3]])).collect())
}
