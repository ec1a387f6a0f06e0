//! The photos that a run trains on: packed 8-bit RGBA, on the device where they fit its share, else sent one
//! at a time from the host's memory or its file.

use super::error::Result;
use super::pixels::Pixels;
use crate::gpu::{Buffer, Device};
use crate::scene::camera::Camera;
use glam::DVec3;
use std::io;
use std::thread::{self, JoinHandle};

/// Share of the device's memory that photos may take.
const DEVICE_SHARE: u64 = 4;

/// A view that is trained on: its camera at the working size and its photo.
#[derive(Clone)]
pub struct TrainView {
    /// The camera, at the photo's size.
    pub camera: Camera,
    /// Width x height x RGBA, 8 bits each, colours not multiplied by alpha.
    pub pixels: Pixels,
}

impl TrainView {
    /// Colour of a pixel in [0, 1], over black.
    ///
    /// # Errors
    /// A photo that lies in a file which cannot be read.
    pub fn colour(&self, [x, y]: [u32; 2]) -> io::Result<DVec3> {
        let [r, g, b, a] = self.pixels.at(y as usize * self.camera.width as usize + x as usize)?;
        let share = |byte: u8| f64::from(byte) / 255.0;
        Ok(DVec3::new(share(r), share(g), share(b)) * share(a))
    }
}

/// Photos where kernels can read them.
pub enum Photos {
    /// All on the device.
    Resident(Vec<Buffer<u32>>),
    /// One at a time, sent before each iteration.
    Streamed(Stream),
}

/// Room for one photo on the device, and the one that a thread reads meanwhile: its number and its words.
pub struct Stream {
    room: Buffer<u32>,
    ahead: Option<(usize, JoinHandle<io::Result<Vec<u32>>>)>,
}

impl Stream {
    /// The words of view `at`, read ahead or now; `next` is read ahead.
    fn take(&mut self, views: &[TrainView], at: usize, next: usize) -> io::Result<Vec<u32>> {
        let here = match self.ahead.take() {
            Some((number, thread)) if number == at => {
                thread.join().unwrap_or_else(|_| Err(io::Error::other("the reading thread ended early")))
            }
            _ => words(&views[at].pixels),
        };
        let pixels = views[next].pixels.clone();
        // Where no thread can be had, the photo is read when it is needed.
        self.ahead = thread::Builder::new().spawn(move || words(&pixels)).ok().map(|thread| (next, thread));
        here
    }
}

impl Photos {
    /// Bytes on the device of photos of these bytes each, where so many bytes are allowed in all.
    pub fn bytes(sizes: &[u64], limit: u64) -> u64 {
        let all = sizes.iter().sum();
        if Self::fit(all, limit) { all } else { sizes.iter().copied().max().unwrap_or(0) }
    }

    fn fit(bytes: u64, limit: u64) -> bool {
        bytes <= limit / DEVICE_SHARE
    }

    /// Uploads all photos, where they take no more than a quarter of the memory allowed; else makes room for one.
    ///
    /// # Errors
    /// Device memory; device errors; photos in a file that cannot be read.
    pub fn new(device: &Device, views: &[TrainView]) -> Result<Self> {
        let bytes: u64 = views.iter().map(|v| v.pixels.len() as u64).sum();
        if Self::fit(bytes, device.memory_limit()) {
            let upload = |v: &TrainView| Ok(device.upload("photo", &words(&v.pixels)?)?);
            return views.iter().map(upload).collect::<Result<_>>().map(Self::Resident);
        }
        let largest = views.iter().map(|v| v.pixels.len() / 4).max().unwrap_or(0);
        Ok(Self::Streamed(Stream { room: device.buffer("photo", largest)?, ahead: None }))
    }

    /// The photo of view `at`, on the device; `next` is expected after it. A streamed one replaces the last, so that
    /// work on that must be over.
    ///
    /// # Errors
    /// Device errors; photos in a file that cannot be read.
    pub fn get(&mut self, device: &Device, views: &[TrainView], at: usize, next: usize) -> Result<&Buffer<u32>> {
        match self {
            Self::Resident(all) => Ok(&all[at]),
            Self::Streamed(stream) => {
                let words = stream.take(views, at, next)?;
                stream.room.write(device, &words)?;
                Ok(&stream.room)
            }
        }
    }
}

fn words(pixels: &Pixels) -> io::Result<Vec<u32>> {
    Ok(pixels.read()?.chunks_exact(4).map(|p| u32::from_le_bytes([p[0], p[1], p[2], p[3]])).collect())
}
