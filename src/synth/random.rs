//! Random numbers by counter: a value depends on its key alone, never on who asked first.

/// What a random number is for; keeps the streams apart.
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
    /// Leaves, pebbles and other scattered things.
    Scatter,
    /// Place of the moving object.
    Mover,
}

/// Mixes 64 bits so that each depends on all (the finaliser of `SplitMix64`; Steele, Lea, Flood 2014).
pub(super) const fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

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
