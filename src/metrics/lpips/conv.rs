//! Convolution with bias and ReLU: patches gathered to a matrix, times the weights.

use super::matrix::matrix_product;
use super::rows::{Map, window_places};
use super::winograd;
use rayon::prelude::*;
use std::ops::Range;

/// Output pixels per matrix product: enough to make packing the weights cheap, few enough to stay in the cache.
const BLOCK: usize = 512;

/// A convolution of square windows.
pub(super) struct Conv {
    pub size: usize,
    pub stride: usize,
    pub pad: usize,
    pub inputs: usize,
    /// One per output channel.
    pub bias: Vec<f32>,
    weights: Weights,
}

enum Weights {
    /// (ky, kx, in) x out.
    Direct(Vec<f32>),
    /// 36 times in x out.
    Winograd(Vec<f32>),
}

impl Conv {
    /// From weights (out, in, ky, kx); their number must be out x in x size x size.
    pub fn new(oihw: &[f32], bias: Vec<f32>, inputs: usize, size: usize, stride: usize, pad: usize) -> Self {
        let quads = inputs.is_multiple_of(4) && bias.len().is_multiple_of(4);
        let winograd = size == 3 && stride == 1 && pad == 1 && quads;
        let weights = if winograd {
            Weights::Winograd(winograd::transform_weights(oihw, inputs, bias.len()))
        } else {
            Weights::Direct(direct_weights(oihw, inputs, bias.len(), size))
        };
        Self { size, stride, pad, inputs, bias, weights }
    }

    /// Output pixels along an axis of `n` input pixels.
    pub fn places(&self, n: usize) -> Option<usize> {
        window_places(n, self.size, self.stride, self.pad)
    }

    /// The input rows, out of `height`, that output `rows` need.
    pub fn input_rows(&self, rows: &Range<usize>, height: usize) -> Range<usize> {
        let end = rows.end.saturating_sub(1) * self.stride + self.size - self.pad;
        (rows.start * self.stride).saturating_sub(self.pad)..end.min(height)
    }

    /// Output `rows`, from an input that contains all the rows that they need.
    pub fn forward(&self, input: &Map, rows: Range<usize>) -> Map {
        let (width, channels) = (self.places(input.width).unwrap_or(0), self.bias.len());
        let mut out = Map { first: rows.start, width, channels, data: vec![0.0; rows.len() * width * channels] };
        match &self.weights {
            Weights::Direct(weights) => self.direct(input, &mut out, weights),
            Weights::Winograd(weights) => winograd::forward(input, &mut out, weights, &self.bias),
        }
        out
    }

    fn direct(&self, input: &Map, out: &mut Map, weights: &[f32]) {
        let (channels, width, first) = (self.bias.len(), out.width, out.first);
        let patch = self.size * self.size * self.inputs;
        out.data.par_chunks_mut(BLOCK * channels).enumerate().for_each_init(Vec::new, |patches, (block, out)| {
            let pixels = out.len() / channels;
            patches.clear();
            patches.resize(pixels * patch, 0.0);
            for (p, patch) in patches.chunks_exact_mut(patch).enumerate() {
                let (y, x) = (first + (block * BLOCK + p) / width, (block * BLOCK + p) % width);
                self.gather(input, y, x, patch);
            }
            matrix_product(patches, weights, out, [pixels, patch, channels]);
            for pixel in out.chunks_exact_mut(channels) {
                pixel.iter_mut().zip(&self.bias).for_each(|(v, b)| *v = (*v + b).max(0.0));
            }
        });
    }

    /// The input window of output pixel (x, y), zeros outside; `patch` holds zeros before.
    fn gather(&self, input: &Map, y: usize, x: usize, patch: &mut [f32]) {
        let left = (x * self.stride) as isize - self.pad as isize;
        let columns = left.max(0) as usize..((left + self.size as isize).max(0) as usize).min(input.width);
        let skip = (columns.start as isize - left) as usize;
        let span = columns.start * self.inputs..columns.end * self.inputs;
        for (ky, line) in patch.chunks_exact_mut(self.size * self.inputs).enumerate() {
            if let Some(row) = input.row((y * self.stride + ky) as isize - self.pad as isize) {
                line[skip * self.inputs..][..span.len()].copy_from_slice(&row[span.clone()]);
            }
        }
    }
}

/// (out, in, ky, kx) to (ky, kx, in) x out.
fn direct_weights(oihw: &[f32], inputs: usize, outputs: usize, size: usize) -> Vec<f32> {
    let area = size * size;
    let mut weights = vec![0.0; oihw.len()];
    for (oi, window) in oihw.chunks_exact(area).enumerate() {
        let (o, i) = (oi / inputs, oi % inputs);
        for (k, w) in window.iter().enumerate() {
            weights[(k * inputs + i) * outputs + o] = *w;
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(count: usize, mut seed: u32) -> Vec<f32> {
        let mut next = || {
            seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
            (seed >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        (0..count).map(|_| next()).collect()
    }

    /// The convolution by its definition, in float64.
    fn plain(conv: &Conv, oihw: &[f32], input: &Map, rows: Range<usize>) -> Vec<f64> {
        let mut out = Vec::new();
        for y in rows {
            for x in 0..conv.places(input.width).unwrap() {
                for o in 0..conv.bias.len() {
                    let mut sum = f64::from(conv.bias[o]);
                    for ky in 0..conv.size {
                        let row = input.row((y * conv.stride + ky) as isize - conv.pad as isize);
                        for kx in 0..conv.size {
                            let x = (x * conv.stride + kx).checked_sub(conv.pad).filter(|&x| x < input.width);
                            let (Some(row), Some(x)) = (row, x) else { continue };
                            for i in 0..conv.inputs {
                                let w = oihw[((o * conv.inputs + i) * conv.size + ky) * conv.size + kx];
                                sum += f64::from(w) * f64::from(row[x * conv.inputs + i]);
                            }
                        }
                    }
                    out.push(sum.max(0.0));
                }
            }
        }
        out
    }

    #[test]
    fn both_ways_follow_the_definition() {
        let cases = [(3, 3, 1, 1, 8), (8, 3, 1, 1, 12), (64, 3, 1, 1, 64), (3, 11, 4, 2, 8), (8, 5, 1, 2, 4)];
        for (inputs, size, stride, pad, outputs) in cases {
            for (width, height) in [(11, 11), (17, 14), (31, 12), (150, 12)] {
                let oihw = noise(outputs * inputs * size * size, 3);
                let conv = Conv::new(&oihw, noise(outputs, 4), inputs, size, stride, pad);
                let input = Map { first: 0, width, channels: inputs, data: noise(width * height * inputs, 5) };
                let all = conv.places(height).unwrap();
                for rows in [0..all, all / 3..all.min(all / 3 + 5)] {
                    let expected = plain(&conv, &oihw, &input, rows.clone());
                    // Only the rows reported as needed may have an effect.
                    let needed = conv.input_rows(&rows, height);
                    let length = width * inputs;
                    let strip = Map {
                        first: needed.start,
                        data: input.data[needed.start * length..needed.end * length].to_vec(),
                        ..input
                    };
                    let found = conv.forward(&strip, rows.clone());
                    assert_eq!(found.data.len(), expected.len());
                    let scale = expected.iter().fold(1.0, |m: f64, v| m.max(*v));
                    for (f, e) in found.data.iter().zip(&expected) {
                        assert!((f64::from(*f) - e).abs() < 2e-5 * scale, "{inputs} {size} {width} {rows:?}: {f} {e}");
                    }
                }
            }
        }
    }
}
