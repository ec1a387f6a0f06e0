//! 3 x 3 convolution by Winograd's F(4 x 4, 3 x 3): 36 products for 16 outputs instead of 144 (Lavin and Gray 2016).

use super::matrix::matrix_product;
use super::rows::Map;
use glam::Vec4;
use rayon::prelude::*;
use std::array::from_fn;

/// Tiles per matrix product: enough to make packing the weights cheap; the two buffers take 38 MB at 512 channels.
const TILES: usize = 256;
/// Elements of a transformed tile.
const PLACES: usize = 36;

/// 1-D transform of three weights.
const G: [[f32; 3]; 6] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// (out, in, 3, 3) to 36 matrices in x out.
pub(super) fn transform_weights(oihw: &[f32], inputs: usize, outputs: usize) -> Vec<f32> {
    let mut transformed = vec![0.0; PLACES * inputs * outputs];
    transformed.par_chunks_mut((inputs * outputs).max(1)).enumerate().for_each(|(place, matrix)| {
        let (gy, gx) = (G[place / 6], G[place % 6]);
        let factors: [f32; 9] = from_fn(|k| gy[k / 3] * gx[k % 3]);
        for (oi, window) in oihw.chunks_exact(9).enumerate() {
            matrix[oi % inputs * outputs + oi / inputs] = factors.iter().zip(window).map(|(f, w)| f * w).sum();
        }
    });
    transformed
}

/// Fills `out` (its rows and channels are set) with relu(conv(input) + bias).
pub(super) fn forward(input: &Map, out: &mut Map, weights: &[f32], bias: &[f32]) {
    let (width, channels) = (out.width, bias.len());
    let tiles_wide = width.div_ceil(4);
    let tile_rows = (TILES / tiles_wide.max(1)).max(1);
    let first = out.first;
    let block = tile_rows * 4 * width * channels;
    let alone = out.data.len() <= block;
    out.data.par_chunks_mut(block.max(1)).enumerate().for_each_init(Buffers::default, |buffers, (index, out)| {
        let rows = out.len() / (width * channels);
        let tiles: Vec<(usize, usize)> =
            (0..rows).step_by(4).flat_map(|y| (0..width).step_by(4).map(move |x| (y, x))).collect();
        for tiles in tiles.chunks(TILES) {
            let top = first + index * tile_rows * 4;
            buffers.gather(input, tiles, top);
            buffers.multiply(tiles.len(), weights, input.channels, channels, alone);
            buffers.scatter(out, tiles, rows, width, bias);
        }
    });
}

/// Transformed inputs (36 x tiles x in) and outputs (36 x tiles x out) of some tiles.
#[derive(Default)]
struct Buffers {
    inputs: Vec<f32>,
    outputs: Vec<f32>,
}

impl Buffers {
    /// Transforms the 6 x 6 input windows of `tiles` (top row and left column of their output, rows from `top`).
    fn gather(&mut self, input: &Map, tiles: &[(usize, usize)], top: usize) {
        let channels = input.channels;
        self.inputs.resize(PLACES * tiles.len() * channels, 0.0);
        let zeros = vec![0.0; channels];
        for (t, &(y, x)) in tiles.iter().enumerate() {
            let window: [&[f32]; PLACES] = from_fn(|k| {
                let row = input.row((top + y + k / 6) as isize - 1);
                let column = (x + k % 6).checked_sub(1).filter(|&c| c < input.width);
                match (row, column) {
                    (Some(row), Some(c)) => &row[c * channels..(c + 1) * channels],
                    _ => &zeros[..],
                }
            });
            for c in (0..channels).step_by(4) {
                let mut v: [Vec4; PLACES] = from_fn(|k| Vec4::from_slice(&window[k][c..]));
                for i in 0..6 {
                    let line = from_input(from_fn(|k| v[k * 6 + i]));
                    (0..6).for_each(|k| v[k * 6 + i] = line[k]);
                }
                for i in 0..6 {
                    let line = from_input(from_fn(|k| v[i * 6 + k]));
                    for k in 0..6 {
                        let at = ((i * 6 + k) * tiles.len() + t) * channels + c;
                        line[k].write_to_slice(&mut self.inputs[at..]);
                    }
                }
            }
        }
    }

    /// 36 matrix products; on all threads if this block is the only one.
    fn multiply(&mut self, tiles: usize, weights: &[f32], inputs: usize, outputs: usize, alone: bool) {
        self.outputs.resize(PLACES * tiles * outputs, 0.0);
        let size = [tiles, inputs, outputs];
        let product = |place: usize, out: &mut [f32]| {
            let a = &self.inputs[place * tiles * inputs..][..tiles * inputs];
            matrix_product(a, &weights[place * inputs * outputs..][..inputs * outputs], out, size);
        };
        if alone {
            self.outputs.par_chunks_mut(tiles * outputs).enumerate().for_each(|(place, out)| product(place, out));
        } else {
            self.outputs.chunks_mut(tiles * outputs).enumerate().for_each(|(place, out)| product(place, out));
        }
    }

    /// Transforms back, adds the bias, applies the ReLU; a tile's pixels past the border are dropped.
    fn scatter(&self, out: &mut [f32], tiles: &[(usize, usize)], rows: usize, width: usize, bias: &[f32]) {
        let channels = bias.len();
        for (t, &(y, x)) in tiles.iter().enumerate() {
            for c in (0..channels).step_by(4) {
                let m: [Vec4; PLACES] =
                    from_fn(|k| Vec4::from_slice(&self.outputs[(k * tiles.len() + t) * channels + c..]));
                let columns: [[Vec4; 4]; 6] = from_fn(|i| to_output(from_fn(|k| m[k * 6 + i])));
                let bias = Vec4::from_slice(&bias[c..]);
                for dy in 0..4.min(rows - y) {
                    let line = to_output(from_fn(|i| columns[i][dy]));
                    for dx in 0..4.min(width - x) {
                        let at = ((y + dy) * width + x + dx) * channels + c;
                        (line[dx] + bias).max(Vec4::ZERO).write_to_slice(&mut out[at..]);
                    }
                }
            }
        }
    }
}

/// 1-D transform of six inputs.
#[inline(always)]
fn from_input(d: [Vec4; 6]) -> [Vec4; 6] {
    let (even, odd) = (d[4] - 4.0 * d[2], d[3] - 4.0 * d[1]);
    let (near, far) = (d[4] - d[2], 2.0 * (d[3] - d[1]));
    let (first, last) = (4.0 * d[0] - 5.0 * d[2] + d[4], 4.0 * d[1] - 5.0 * d[3] + d[5]);
    [first, even + odd, even - odd, near + far, near - far, last]
}

/// 1-D transform of six products to four outputs.
#[inline(always)]
fn to_output(m: [Vec4; 6]) -> [Vec4; 4] {
    let (a, b, c, d) = (m[1] + m[2], m[1] - m[2], m[3] + m[4], m[3] - m[4]);
    [m[0] + a + c, b + 2.0 * d, a + 4.0 * c, b + 8.0 * d + m[5]]
}
