//! Imbalance of a picture's work: counts that explain times, equal on every device of one tuning.

use qirf_vk::gpu::{Device, Result};
use qirf_vk::render::Slots;
use serde::Serialize;

/// Lanes that work in lockstep on most GPUs.
const LANES: usize = 32;

/// Distribution of the sizes of parts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Distribution {
    /// Parts that are not empty.
    pub count: u64,
    /// Sum of the parts.
    pub sum: u64,
    /// The median part.
    pub p50: u32,
    /// The 99th percentile.
    pub p99: u32,
    /// The largest part.
    pub most: u32,
}

impl Distribution {
    /// The sizes of these parts.
    pub fn of(parts: impl Iterator<Item = u32>) -> Self {
        let mut parts: Vec<u32> = parts.filter(|part| *part > 0).collect();
        parts.sort_unstable();
        let at = |share: f64| parts.get(((parts.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(0);
        let sum = parts.iter().map(|part| u64::from(*part)).sum();
        Self { count: parts.len() as u64, sum, p50: at(0.5), p99: at(0.99), most: at(1.0) }
    }
}

/// Counts of a picture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Imbalance {
    /// Gaussians in a tile's list.
    pub tile: Distribution,
    /// Tiles of a Gaussian.
    pub gaussian: Distribution,
    /// Steps of lanes, busy or idle, in which the projection's backward pass adds up slots: 32 Gaussians in the model's
    /// order take as many as the one with the most slots, unless a subgroup shares it. `gaussian.sum` if no lane ever
    /// waits.
    pub project_backward_steps: u64,
    /// The same for binning, which processes Gaussians from near to far.
    pub bin_steps: u64,
}

/// Steps of lanes over these numbers of slots; from `many` slots on (0: never) a subgroup shares a Gaussian's.
pub fn steps(slots: &[u32], many: u32) -> u64 {
    let of_group = |group: &[u32]| {
        let shared = |slots: u32| many > 0 && slots >= many;
        let alone = group.iter().copied().filter(|slots| !shared(*slots)).max().unwrap_or(0);
        let together = group.iter().copied().filter(|slots| shared(*slots));
        let rounds = u64::from(alone) + together.map(|slots| u64::from(slots).div_ceil(LANES as u64)).sum::<u64>();
        LANES as u64 * rounds
    };
    slots.chunks(LANES).map(of_group).sum()
}

impl Imbalance {
    /// Counts of the picture that these slots are of.
    pub fn of(device: &Device, picture: &Slots<'_>) -> Result<Self> {
        let many = device.tuning().bin_many;
        let starts = picture.starts.read_first(device, picture.tiles as usize + 1)?;
        let (slots, depths) = (picture.tile_counts.read(device)?, picture.depth.read(device)?);
        let mut order: Vec<usize> = (0..slots.len()).filter(|i| slots[*i] > 0).collect();
        order.sort_by_key(|i| (depths[*i], *i));
        let near_to_far: Vec<u32> = order.into_iter().map(|i| slots[i]).collect();
        Ok(Self {
            tile: Distribution::of(starts.windows(2).map(|range| range[1] - range[0])),
            gaussian: Distribution::of(slots.iter().copied()),
            project_backward_steps: steps(&slots, many),
            bin_steps: steps(&near_to_far, many),
        })
    }
}
