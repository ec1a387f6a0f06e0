//! The photos that a run trains on: packed 8-bit RGBA, on the device where they fit its share, else on the host.

use crate::gpu::{Buffer, Device, Result};
use crate::scene::camera::Camera;
use glam::DVec3;
use std::sync::Arc;

/// Share of the device's memory that photos may take.
const DEVICE_SHARE: u64 = 4;

/// A view that is trained on: its camera at the working size and its photo.
#[derive(Clone)]
pub struct TrainView {
    /// The camera, at the photo's size.
    pub camera: Camera,
    /// Width x height x RGBA, 8 bits each, colours not multiplied by alpha.
    pub pixels: Arc<[u8]>,
}

impl TrainView {
    /// Colour of a pixel in [0, 1], over black.
    pub fn colour(&self, [x, y]: [u32; 2]) -> DVec3 {
        let at = (y as usize * self.camera.width as usize + x as usize) * 4;
        let byte = |c: usize| f64::from(self.pixels[at + c]) / 255.0;
        DVec3::new(byte(0), byte(1), byte(2)) * byte(3)
    }
}

/// Photos where kernels can read them.
pub enum Photos {
    /// All on the device.
    Resident(Vec<Buffer<u32>>),
    /// One at a time, sent before each iteration.
    Streamed(Buffer<u32>),
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
    /// Device memory; device errors.
    pub fn new(device: &Device, views: &[TrainView]) -> Result<Self> {
        let bytes: u64 = views.iter().map(|v| v.pixels.len() as u64).sum();
        if Self::fit(bytes, device.memory_limit()) {
            let upload = |v: &TrainView| device.upload("photo", &words(v));
            return views.iter().map(upload).collect::<Result<_>>().map(Self::Resident);
        }
        let largest = views.iter().map(|v| v.pixels.len() / 4).max().unwrap_or(0);
        Ok(Self::Streamed(device.buffer("photo", largest)?))
    }

    /// The photo of view `at`, on the device. A streamed one replaces the last, so that work on that must be over.
    ///
    /// # Errors
    /// Device errors.
    pub fn get(&self, device: &Device, views: &[TrainView], at: usize) -> Result<&Buffer<u32>> {
        match self {
            Self::Resident(all) => Ok(&all[at]),
            Self::Streamed(one) => {
                one.write(device, &words(&views[at]))?;
                Ok(one)
            }
        }
    }
}

fn words(view: &TrainView) -> Vec<u32> {
    view.pixels.chunks_exact(4).map(|p| u32::from_le_bytes([p[0], p[1], p[2], p[3]])).collect()
}
