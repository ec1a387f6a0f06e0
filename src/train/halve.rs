//! Photos at half their size for the first iterations of a run: coarse structure settles at a quarter of the pixels.

use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::train::{Halve as Kernel, HalvePush, HalveSpec};
use crate::primitives::WORKGROUP;
use crate::scene::camera::{Camera, Whole};

/// Shortest side of a halved picture, in pixels. Smaller pictures cost little and show little.
const LEAST: u32 = 64;

/// A camera at half its size, with the pixels of [`Halve`]; `None` if the picture would be too small. Corners of parts
/// are even.
pub fn camera(camera: &Camera) -> Option<Camera> {
    let (width, height) = (camera.width / 2, camera.height / 2);
    let (focal, principal) = (camera.focal / 2.0, camera.principal / 2.0);
    let half = |whole: Whole| Whole { size: whole.size.map(|n| n / 2), corner: whole.corner.map(|n| n / 2) };
    let whole = camera.whole.map(half);
    (width.min(height) >= LEAST).then(|| Camera { focal, principal, width, height, whole, ..camera.clone() })
}

/// Room for one photo at half its size.
pub struct Halve {
    /// Width / 2 x height / 2 x RGBA, 8 bits each.
    pub photo: Buffer<u32>,
}

impl Halve {
    /// Room for photos of at most `size`.
    pub fn new(device: &Device, size: [u32; 2]) -> Result<Self> {
        Ok(Self { photo: device.buffer("half photo", pixels(size) as usize)? })
    }

    /// Records the reduction of `photo`, of this size, to half its size, into [`Halve::photo`].
    pub fn record(&self, recording: &mut Recording, photo: &Buffer<u32>, size: [u32; 2]) {
        let kernel =
            Kernel { photo, halved: &self.photo, push: HalvePush { size }, spec: HalveSpec { workgroup: WORKGROUP } };
        let groups = Groups::Count(pixels(size).div_ceil(WORKGROUP));
        recording.scope("halve", |r| r.dispatch(&kernel, groups));
    }
}

fn pixels([width, height]: [u32; 2]) -> u32 {
    (width / 2) * (height / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec2, DVec3};

    /// Half of a part is the part of the half.
    #[test]
    fn halved_parts() {
        let whole = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, 480, 360);
        let half = camera(&whole).unwrap();
        assert_eq!((half.whole, half.principal), (None, DVec2::new(120.0, 90.0)));
        assert_eq!(camera(&whole.part([32, 64], [160, 200])), Some(half.part([16, 32], [80, 100])));
        assert_eq!(camera(&whole.part([0, 0], [120, 200])), None);
    }
}
