//! Sketches of what each Gaussian does in the pictures of a set of views: few numbers whose products are, on average, the sums
//! over all pixels of the products of two Gaussians' changes phi, and of their weights w = T alpha.
//!
//! A pixel has two random signs, and the tiles of all views fall at random into [`BUCKETS`] buckets. A row of a sketch is the
//! sum of the signed values of all pixels in a bucket (count sketch: Charikar, Chen, Farach-Colton 2002, with one bucket a tile).

use super::score::{Of, sums, walk};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::response::{Sketch as SketchKernel, SketchPush, SketchSpec};
use crate::primitives::WORKGROUP;
use crate::render::Renderer;
use crate::scene::camera::Camera;

/// Buckets that the tiles fall into.
pub const BUCKETS: usize = 32;
/// Rows of a sketch: buckets times two sets of signs.
pub const ROWS: usize = 2 * BUCKETS;

/// A Gaussian's sketch: in each row phi in red, green and blue, and w.
pub type Sketch = [[f32; 4]; ROWS];

/// Sketches of all Gaussians over the recorded views, in device memory.
pub struct ResidentSketches {
    /// Rows of all sketches, n x [`ROWS`].
    values: Buffer<[f32; 4]>,
    subgroup: u32,
}

impl ResidentSketches {
    /// Bytes of the sketches of `gaussians` Gaussians.
    pub fn bytes(gaussians: usize) -> u64 {
        Buffer::<[f32; 4]>::bytes_of(ROWS * gaussians)
    }

    /// Sketches of no view: zero.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn zeros(device: &Device, gaussians: usize) -> Result<Self> {
        let values = device.zeros("sketches", ROWS * gaussians)?;
        Ok(Self { values, subgroup: device.info().subgroup_size })
    }

    /// Records the sketches of the picture recorded before, that of view number `number`; the slots' sums are overwritten.
    ///
    /// # Panics
    /// If the renderer was not made by [`Renderer::for_training`].
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &Renderer,
        model: &Resident,
        camera: &Camera,
        number: u32,
    ) {
        let slots = renderer.slots(camera);
        let sums = sums(&slots);
        let walk = walk(&slots, &sums, [renderer.image(); 2], Of::Sketch(number), self.subgroup);
        let sketch = SketchKernel {
            count: &model.count.value,
            pairs: slots.pairs,
            tile_counts: slots.tile_counts,
            first_slots: slots.first_slots,
            first_signs: &sums[0],
            second_signs: &sums[1],
            tiles: &sums[2],
            sketches: &self.values,
            push: SketchPush { pair_limit: slots.limit, number },
            spec: SketchSpec { workgroup: WORKGROUP, buckets: BUCKETS as u32 },
        };
        recording.scope("sketch", |r| {
            r.dispatch(&walk, Groups::Count(slots.tiles));
            r.dispatch(&sketch, model.count.groups(WORKGROUP));
        });
    }

    /// The sketches, n.
    ///
    /// # Errors
    /// Device errors.
    pub fn read(&self, device: &Device) -> Result<Vec<Sketch>> {
        self.values.cast::<Sketch>().read(device)
    }
}
