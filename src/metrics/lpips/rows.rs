//! Feature maps, whole or in strips, and max pooling.

use rayon::prelude::*;
use std::ops::Range;

/// Rows of a feature map, channels innermost; missing rows read as zeros.
#[derive(Clone)]
pub(super) struct Map {
    /// Index of the first row held.
    pub first: usize,
    /// Pixels per row.
    pub width: usize,
    /// Channels per pixel.
    pub channels: usize,
    /// Rows x width x channels.
    pub data: Vec<f32>,
}

impl Map {
    /// Number of rows held.
    pub fn rows(&self) -> usize {
        self.data.len() / (self.width * self.channels).max(1)
    }

    /// Row `y` of the map; `None` if it is not held.
    pub fn row(&self, y: isize) -> Option<&[f32]> {
        let at = usize::try_from(y).ok()?.checked_sub(self.first)?;
        let length = self.width * self.channels;
        self.data.get(at * length..(at + 1) * length)
    }
}

/// Number of positions of a window along an axis of `n` pixels; `None` if no window fits.
pub(super) fn window_places(n: usize, size: usize, stride: usize, pad: usize) -> Option<usize> {
    Some((n + 2 * pad).checked_sub(size)? / stride + 1)
}

/// A max pool without padding.
#[derive(Clone, Copy)]
pub(super) struct Pool {
    /// Width and height of the window.
    pub size: usize,
    /// Step of the window.
    pub stride: usize,
}

impl Pool {
    /// The empty pooled map of an input `width` pixels wide.
    pub fn empty(self, width: usize, channels: usize) -> Map {
        let width = window_places(width, self.size, self.stride, 0).unwrap_or(0);
        Map { first: 0, width, channels, data: Vec::new() }
    }

    /// Appends the pooled `rows` of `from`, which contains all the rows that they cover.
    pub fn append(self, from: &Map, rows: Range<usize>, to: &mut Map) {
        let (channels, length) = (to.channels, to.width * to.channels);
        let start = to.data.len();
        to.data.resize(start + rows.len() * length, 0.0);
        to.data[start..].par_chunks_mut(length).zip(rows).for_each(|(out, row)| {
            // Features come from a ReLU, so zero is a valid start.
            for source in (0..self.size).filter_map(|k| from.row((row * self.stride + k) as isize)) {
                for (x, pixel) in out.chunks_exact_mut(channels).enumerate() {
                    let window = &source[x * self.stride * channels..][..self.size * channels];
                    for values in window.chunks_exact(channels) {
                        pixel.iter_mut().zip(values).for_each(|(most, &v)| *most = if v > *most { v } else { *most });
                    }
                }
            }
        });
    }
}
