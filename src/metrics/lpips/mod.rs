//! LPIPS (v0.1 heads) with VGG16 or AlexNet features, exact, on the CPU.
//!
//! A stage (the convolutions between two pools) runs strip by strip: only pooled maps exist in full, so that a full-HD
//! pair needs hundreds of megabytes, not gigabytes.

mod conv;
mod matrix;
mod rows;
mod weights;
mod winograd;

use super::{Error, Image};
use crate::wording::named;
use conv::Conv;
use glam::Vec4;
use rayon::prelude::*;
use rows::{Map, Pool, window_places};

/// Floats of the widest feature map that a strip may hold (32 MB).
const STRIP: usize = 8 << 20;
/// Mean and deviation of the colours, for values in [-1, 1].
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

named! {
    /// The network that computes the features.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Kind {
        /// VGG16: relu1_2, 2_2, 3_3, 4_3, 5_3.
        Vgg = "vgg",
        /// AlexNet: its five ReLUs.
        Alex = "alex",
    }
}

/// Scaling of pixel values in [0, 1] for the network, which was calibrated on [-1, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Unchanged, as the 3DGS papers report.
    Unit,
    /// 2 v - 1, as LPIPS intends.
    Symmetric,
}

/// One LPIPS network with its weights.
pub struct Lpips {
    kind: Kind,
    stages: Vec<Stage>,
}

/// Convolutions (each with its ReLU), the feature map's head, and the pool before the next stage.
struct Stage {
    convs: Vec<Conv>,
    head: Vec<f32>,
    pool: Option<Pool>,
}

impl Lpips {
    /// The network.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The least width and height in pixels.
    pub fn least_size(&self) -> usize {
        (1..=1024).find(|&n| self.fits(n)).unwrap_or(usize::MAX)
    }

    /// The LPIPS distance of two images of one size, at least 0 and exactly 0 for identical images.
    ///
    /// # Errors
    /// [`Error::Sizes`] if the sizes differ, [`Error::TooSmall`] if the deepest feature map would be empty.
    pub fn distance(&self, a: &Image<'_>, b: &Image<'_>, range: Range) -> Result<f64, Error> {
        self.distance_in_strips(a, b, range, STRIP)
    }

    fn distance_in_strips(&self, a: &Image<'_>, b: &Image<'_>, range: Range, strip: usize) -> Result<f64, Error> {
        a.same_size(b)?;
        let (width, height) = (a.width(), a.height());
        if !self.fits(width) || !self.fits(height) {
            return Err(Error::TooSmall { kind: self.kind, least: self.least_size(), width, height });
        }
        let (mut a, mut b) = (input(a, range), input(b, range));
        let mut sum = 0.0;
        for stage in &self.stages {
            let distance;
            (distance, a, b) = stage.run(&a, &b, strip);
            sum += distance;
        }
        Ok(sum)
    }

    /// True if an axis of `n` pixels leaves at least one at every depth.
    fn fits(&self, n: usize) -> bool {
        let mut left = Some(n);
        for stage in &self.stages {
            for conv in &stage.convs {
                left = left.and_then(|n| conv.places(n));
            }
            if let Some(pool) = stage.pool {
                left = left.and_then(|n| window_places(n, pool.size, pool.stride, 0));
            }
        }
        left.is_some()
    }
}

/// The network's input.
fn input(image: &Image<'_>, range: Range) -> Map {
    let (gain, offset) = match range {
        Range::Unit => (1.0, 0.0),
        Range::Symmetric => (2.0, -1.0),
    };
    let (pixels, _) = image.pixels().as_chunks::<3>();
    let data = pixels.iter().flat_map(|p| [0, 1, 2].map(|c| (p[c] * gain + offset - SHIFT[c]) / SCALE[c])).collect();
    Map { first: 0, width: image.width(), channels: 3, data }
}

impl Stage {
    /// This stage's share of the distance, and the inputs of the next stage; strips hold about `strip` floats.
    fn run(&self, a: &Map, b: &Map, strip: usize) -> (f64, Map, Map) {
        let mut heights = vec![a.rows()];
        let mut width = a.width;
        for conv in &self.convs {
            heights.push(conv.places(heights[heights.len() - 1]).unwrap_or(0));
            width = conv.places(width).unwrap_or(0);
        }
        let height = heights[self.convs.len()];
        let channels = self.head.len();
        let pool = self.pool.unwrap_or(Pool { size: 1, stride: 1 });
        let pooled_rows = window_places(height, pool.size, pool.stride, 0).unwrap_or(0);

        // Multiples of 4 suit both the pools' stride and the Winograd tiles.
        let strip = (strip / (width * channels).max(1) / 4 * 4).max(4);
        let (mut sum, mut next_a, mut next_b) = (0.0, pool.empty(width, channels), pool.empty(width, channels));
        for y0 in (0..height).step_by(strip) {
            let y1 = (y0 + strip).min(height);
            let pooled = y0.div_ceil(pool.stride)..y1.div_ceil(pool.stride).min(pooled_rows);
            // A pool's window may reach below the strip.
            let end = pooled.end.checked_sub(1).map_or(y1, |last| y1.max(last * pool.stride + pool.size));
            let (fa, fb) = rayon::join(|| self.features(a, y0..end, &heights), || self.features(b, y0..end, &heights));
            let count = (y1 - y0) * width * channels;
            sum += distance(&fa.data[..count], &fb.data[..count], &self.head, width);
            rayon::join(
                || pool.append(&fa, pooled.clone(), &mut next_a),
                || pool.append(&fb, pooled.clone(), &mut next_b),
            );
        }
        (sum / (width * height) as f64, next_a, next_b)
    }

    /// Rows of the last convolution's output, computed from the input rows that they need.
    fn features(&self, input: &Map, rows: std::ops::Range<usize>, heights: &[usize]) -> Map {
        let mut needed = vec![rows];
        for (conv, &height) in self.convs.iter().zip(heights).skip(1).rev() {
            needed.push(conv.input_rows(&needed[needed.len() - 1], height));
        }
        let mut map: Option<Map> = None;
        for (conv, rows) in self.convs.iter().zip(needed.into_iter().rev()) {
            map = Some(conv.forward(map.as_ref().unwrap_or(input), rows));
        }
        map.unwrap_or_else(|| input.clone())
    }
}

/// Sum over pixels of the weighted squared difference of the unit-length features.
fn distance(a: &[f32], b: &[f32], head: &[f32], width: usize) -> f64 {
    let row = width * head.len();
    let rows: Vec<f64> = (a.par_chunks(row).zip(b.par_chunks(row)))
        .map(|(a, b)| {
            let pixels = a.chunks_exact(head.len()).zip(b.chunks_exact(head.len()));
            pixels.map(|(a, b)| pixel_distance(a, b, head)).sum::<f64>()
        })
        .collect();
    // In order, so that the sum does not depend on the threads.
    rows.iter().sum()
}

fn pixel_distance(a: &[f32], b: &[f32], head: &[f32]) -> f64 {
    // Channel counts are multiples of 4, which loading checks.
    let quads = |v: &'_ [f32], at: usize| Vec4::from_slice(&v[at..]);
    let inverse_length = |v: &[f32]| {
        let squares = (0..v.len()).step_by(4).fold(Vec4::ZERO, |sum, c| sum + quads(v, c) * quads(v, c));
        1.0 / (squares.element_sum().sqrt() + 1e-10)
    };
    let (na, nb) = (inverse_length(a), inverse_length(b));
    let sum = (0..head.len()).step_by(4).fold(Vec4::ZERO, |sum, c| {
        let difference = quads(a, c) * na - quads(b, c) * nb;
        sum + quads(head, c) * difference * difference
    });
    f64::from(sum.element_sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Many strips give the same result as a single one, with overlapping pools as well.
    #[test]
    fn strips_change_nothing() {
        let mut seed = 1u32;
        let mut noise = |count: usize| -> Vec<f32> {
            let mut next = || {
                seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
                (seed >> 8) as f32 / (1 << 23) as f32 - 1.0
            };
            (0..count).map(|_| next()).collect()
        };
        let mut conv = |inputs: usize, outputs: usize, size: usize, stride: usize, pad: usize| {
            Conv::new(&noise(inputs * outputs * size * size), noise(outputs), inputs, size, stride, pad)
        };
        let (first, second) = (conv(3, 8, 5, 2, 2), conv(8, 8, 3, 1, 1));
        let (third, fourth) = (conv(8, 4, 3, 1, 1), conv(4, 4, 5, 1, 2));
        let head = |channels: usize| (0..channels).map(|c| c as f32 * 0.1).collect();
        let lpips = Lpips {
            kind: Kind::Alex,
            stages: vec![
                Stage { convs: vec![first, second], head: head(8), pool: Some(Pool { size: 3, stride: 2 }) },
                Stage { convs: vec![third], head: head(4), pool: Some(Pool { size: 2, stride: 2 }) },
                Stage { convs: vec![fourth], head: head(4), pool: None },
            ],
        };
        for (width, height) in [(40, 167), (23, 90), (61, 33)] {
            let (a, b) = (noise(width * height * 3), noise(width * height * 3));
            let (a, b) = (Image::new(width, height, &a).unwrap(), Image::new(width, height, &b).unwrap());
            let whole = lpips.distance_in_strips(&a, &b, Range::Symmetric, 1 << 20).unwrap();
            for strip in [1, 1200, 3000] {
                let found = lpips.distance_in_strips(&a, &b, Range::Symmetric, strip).unwrap();
                assert!((found / whole - 1.0).abs() < 1e-6, "{width} x {height}, {strip}: {found}, whole {whole}");
            }
            assert!(whole > 1e-3);
        }
    }
}
