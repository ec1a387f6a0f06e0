//! Random numbers by counter: a value depends on its key alone, never on the order of calls.

/// The purpose of a random number; streams of different purposes are independent.
#[derive(Clone, Copy)]
#[repr(u64)]
pub(super) enum Stream {
    /// Jitter of the cameras' positions.
    Path = 1,
    /// Gain and white balance of the photos.
    Exposure,
    /// Positions of the samples inside pixels.
    Pixel,
    /// Choice of surface points.
    Points,
    /// Leaves, pebbles and other scattered objects.
    Scatter,
    /// Position of the moving object.
    Mover,
}

pub(super) use crate::random::mix;

/// A stream of random numbers with its own key.
#[derive(Clone)]
pub(super) struct Random {
    key: u64,
    counter: u64,
}

impl Random {
    /// The stream for item `index` of a purpose.
    pub const fn new(seed: u64, stream: Stream, index: u64) -> Self {
        Self { key: mix(mix(seed ^ mix(stream as u64)) ^ index), counter: 0 }
    }

    /// 64 random bits.
    pub const fn bits(&mut self) -> u64 {
        self.counter += 1;
        mix(self.key ^ self.counter.wrapping_mul(0xd134_2543_de82_ef95))
    }

    /// A number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (-53f64).exp2()
    }

    /// A number in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}
