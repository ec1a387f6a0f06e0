//! The minimum work of a stage, whatever its code: bytes between memory and device, and float32 operations. Divided by
//! the rates of the group `device`, it gives a lower bound on the time of any code of this algorithm on that device.
//! Bytes: a kernel's inputs are read once and its outputs written once, however often it really touches them; data
//! passed from one kernel to the next counts as both. Gathers count the requested bytes, not the cache lines that
//! contain them. A Gaussian that is not visible counts as its mean alone. Operations are counted from the shaders by
//! hand, low where in doubt: an addition, multiplication, division, root, exponential or logarithm is one; comparisons,
//! selections, integers and moves between lanes are none. Rates of operations are those of multiply-adds, two each, so
//! the bound is too low for roots and exponentials.

use super::facts;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::reference::{self, project};
use qirf_vk::scene::camera::Camera;

/// Bytes and operations.
#[derive(Clone, Copy, Default)]
pub struct Bound {
    /// Bytes read and written.
    pub bytes: f64,
    /// Operations in float32.
    pub operations: f64,
}

impl Bound {
    /// Records this as the bound of a benchmark, with other numbers of it.
    pub fn note(self, group: &str, rest: &[&str], others: &[(&str, f64)]) {
        let own = [("bytes", self.bytes), ("operations", self.operations)];
        facts::note(group, rest, &[&own, others].concat());
    }
}

impl std::iter::Sum for Bound {
    fn sum<I: Iterator<Item = Self>>(parts: I) -> Self {
        parts.fold(Self::default(), |a, b| Self { bytes: a.bytes + b.bytes, operations: a.operations + b.operations })
    }
}

/// Bytes of a pair's key and value, read and written, and of its key read once more to count digits: one pass of a
/// sort.
const PASS: f64 = 20.0;
/// Bytes of a scanned word: read to sum blocks, read and written to apply them.
const SCANNED: f64 = 12.0;
/// Bytes of a projected Gaussian: `geometry`, `shape`, `colour`.
const SPLAT: f64 = 40.0;
/// Bytes of mean, log scales, rotation and opacity.
const FORM: f64 = 44.0;
/// Floats of a row of lib/gradient_row.glsl.
const ROW: f64 = 18.0;

/// Operations of render/project.comp for a visible Gaussian, without its colour.
const PROJECT: f64 = 248.0;
/// Operations of the SH basis, by degree.
const BASIS: [f64; 4] = [0.0, 3.0, 15.0, 40.0];
/// Operations of `blend` in render/rasterise.comp: distance 9, exponential 2, blending 9.
const BLEND: f64 = 20.0;
/// Operations of the innermost loop of lib/backward_pixels.glsl and lib/backward_alone.glsl, without the sums over lanes.
const WALK: f64 = 44.0;
/// Operations of render/project_backward.comp without the SH; and those of the SH by degree.
const PROJECT_BACKWARD: f64 = 400.0;
const DIRECTION: [f64; 4] = [0.0, 20.0, 70.0, 135.0];
/// Operations of train/adam.comp for a parameter: moments 7, step 8.
const ADAM: f64 = 15.0;
/// Operations of train/loss.comp for a pixel's channel: windows of 11 taps 4 + 4 + 3 + 3 times 21, map and gradient 50.
const LOSS: f64 = 344.0;
/// Bytes of train/loss.comp for a pixel: picture and photo read twice, 12 means and 9 partials written and read,
/// gradient.
const LOSS_BYTES: f64 = 2.0 * (16.0 + 4.0) + 2.0 * 4.0 * (12.0 + 9.0) + 16.0;

/// Quantities that bound the stages of a picture and of an iteration.
#[derive(Clone, Copy, Default)]
pub struct Picture {
    /// All Gaussians.
    pub gaussians: f64,
    /// Gaussians drawn.
    pub visible: f64,
    /// (tile, Gaussian) pairs.
    pub pairs: f64,
    /// Width and height.
    pub size: [u32; 2],
    /// Side of a tile.
    pub tile: u32,
    /// SH degree.
    pub degree: usize,
}

impl Picture {
    fn pixels(self) -> f64 {
        f64::from(self.size[0]) * f64::from(self.size[1])
    }

    fn tiles(self) -> u32 {
        self.size[0].div_ceil(self.tile) * self.size[1].div_ceil(self.tile)
    }

    /// Pixels of all tiles' lists, which the rasteriser walks. Pixels that finish early walk less, but not by much in
    /// any benchmark.
    fn pair_pixels(self) -> f64 {
        self.pairs * f64::from(self.tile * self.tile)
    }

    /// SH coefficients of a Gaussian.
    fn sh(self) -> f64 {
        3.0 * ((self.degree + 1) * (self.degree + 1)) as f64
    }

    /// A stage's bound, by its scope's name; zero for other names.
    pub fn stage(self, stage: &str) -> Bound {
        let (n, v, p) = (self.gaussians, self.visible, self.pairs);
        let colour = BASIS[self.degree] + 2.0 * self.sh() + 3.0;
        let (bytes, operations) = match stage {
            // Written for all: visibility and number of tiles; for the visible also the splat and its depth.
            "project" => (n * (12.0 + 8.0) + v * (FORM - 12.0 + 4.0 * self.sh() + SPLAT + 4.0), v * (PROJECT + colour)),
            // Flags, read to sum blocks and to compact; depths read, pairs written; four passes.
            "depth sort" => (n * 8.0 + v * (4.0 + 8.0 + 4.0 * PASS), 0.0),
            // Gathering of the counts, their scan; order, offset, count, most of the splat and the first slot; three
            // words per pair.
            "bin" => (v * (12.0 + SCANNED + 12.0 + 32.0 + 4.0) + 12.0 * p, 0.0),
            "tile sort" => {
                let bits = 32 - self.tiles().leading_zeros();
                (p * PASS * f64::from(bits.div_ceil(8)) + 4.0 * f64::from(self.tiles()), 0.0)
            }
            "rasterise" => (8.0 * p + SPLAT * v + 16.0 * self.pixels(), BLEND * self.pair_pixels()),
            "loss" => (LOSS_BYTES * self.pixels(), 3.0 * LOSS * self.pixels()),
            // The picture, its gradient; nine sums to every pair's slot.
            "rasterise backward" => ((8.0 + 36.0) * p + SPLAT * v + 32.0 * self.pixels(), WALK * self.pair_pixels()),
            // Slots, counts, colour, parameters; rows, statistics read and written.
            "project backward" => {
                let parameters = FORM + 4.0 * (self.sh() - 3.0);
                let bytes = 36.0 * p + n * (8.0 + 4.0 * ROW + 16.0) + v * (24.0 + parameters);
                (bytes, v * (PROJECT_BACKWARD + DIRECTION[self.degree]) + 10.0 * p)
            }
            // Rows; value and two moments of every parameter, read and written.
            "adam" => {
                let parameters = 11.0 + self.sh();
                (n * (4.0 * ROW + 24.0 * parameters), n * (ADAM * parameters + self.sh()))
            }
            _ => (0.0, 0.0),
        };
        Bound { bytes, operations }
    }

    /// Numbers that tables show beside a time.
    pub fn numbers(self) -> [(&'static str, f64); 5] {
        [
            ("gaussians", self.gaussians),
            ("visible", self.visible),
            ("pairs", self.pairs),
            ("pixels", self.pixels()),
            ("tile", f64::from(self.tile)),
        ]
    }
}

/// Four passes over pairs of 32 bits.
pub fn sort(n: f64) -> Bound {
    Bound { bytes: 4.0 * PASS * n, operations: 0.0 }
}

/// An exclusive prefix sum.
pub fn scan(n: f64) -> Bound {
    Bound { bytes: SCANNED * n, operations: 0.0 }
}

/// Overlaps of `blocks` of `m` members: four vectors per member read, a lower triangle written.
pub fn overlap(method: &str, blocks: f64, m: f64) -> Bound {
    let each = match method {
        "qr" => 182.0,
        _ => 160.0,
    };
    let triangle = 0.5 * m * (m + 1.0);
    Bound { bytes: blocks * (64.0 * m + 4.0 * triangle), operations: blocks * each * (triangle - m) }
}

/// The same for density matrices: eight responses per member, their factor written and read, sums of eight products.
pub fn rrdm(blocks: f64, m: f64) -> Bound {
    let triangle = 0.5 * m * (m + 1.0);
    Bound { bytes: blocks * (96.0 * m + 4.0 * triangle), operations: blocks * 15.0 * triangle }
}

/// Eigenproblems of rank 8: Cholesky of the triangle (m^3 / 3), B and X by substitution (8 m^2 each), B^T B and X^2.
pub fn participation(blocks: f64, m: f64) -> Bound {
    let triangle = 0.5 * m * (m + 1.0);
    let operations = m * m * m / 3.0 + 16.0 * m * m + 144.0 * m;
    Bound { bytes: blocks * (8.0 * triangle + 36.0 * m), operations: blocks * operations }
}

/// Quantities that bound a picture of a model; the float64 twin counts visible Gaussians.
pub fn picture(model: &Gaussians, camera: &Camera, pairs: u32, tile: u32) -> Picture {
    let settings = reference::Settings { sh_degree: 0, ..reference::Settings::default() };
    let visible = project::project(&reference::Params::from(model), camera, &settings).iter().flatten().count();
    Picture {
        gaussians: model.len() as f64,
        visible: visible as f64,
        pairs: f64::from(pairs),
        size: [camera.width, camera.height],
        tile,
        degree: model.sh.len() - 1,
    }
}
