//! The radiance-response density matrix P = W W^T of a batch's blocks (Q5, Q6): its factor W, and P if a solver needs it.

use super::plan::{Arrays, Batch};
use crate::gpu::{Groups, Recording};
use crate::kernels::constants::rrdm::{DENSITY, FACTOR};
use crate::kernels::qirf::{Rrdm, RrdmPush, RrdmSpec};

/// Parameters of the density matrix, besides the responses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Density {
    /// Weight of the rendering responses; the optimisation responses get the rest.
    pub eta: f32,
    /// Added to each trace.
    pub epsilon: f32,
    /// True if P itself is needed, which only `dsygvd` does.
    pub full: bool,
}

impl Default for Density {
    fn default() -> Self {
        Self { eta: 0.75, epsilon: 1e-4, full: false }
    }
}

/// Records W, and P if requested, from rows of H, which contain the weights sqrt(eta) and sqrt(1 - eta).
pub(super) fn record(recording: &mut Recording, arrays: &Arrays, batch: &Batch, density: &Density) {
    let phases = [(FACTOR, &batch.blocks), (DENSITY, &batch.tiles)];
    for (phase, range) in phases.into_iter().take(if density.full { 2 } else { 1 }) {
        let kernel = Rrdm {
            blocks: &arrays.blocks,
            tiles: &arrays.tiles,
            members: &arrays.members,
            h: &arrays.responses,
            factors: &arrays.factors,
            densities: &arrays.densities,
            divisors: &arrays.divisors,
            push: RrdmPush {
                first: range.start as u32,
                count: range.len() as u32,
                first_member: batch.members.start as u32,
                first_block: batch.blocks.start as u32,
                eta: density.eta,
                epsilon: density.epsilon,
            },
            spec: RrdmSpec { workgroup: arrays.rows, phase, columns: arrays.columns },
        };
        recording.dispatch(&kernel, Groups::Count(range.len() as u32));
    }
}
