//! Normalised overlaps N_ij of a batch's blocks, on the device; `glsl/qirf/overlap.comp` explains the method.

use super::plan::{Arrays, Batch};
use crate::gaussians::resident::Resident;
use crate::gpu::{Groups, Recording};
use crate::kernels::constants::axes::{LARGEST_LOG, SCALE_FLOOR};
use crate::kernels::qirf::{
    Axes, AxesPush, AxesSpec, Overlap, OverlapBySum, OverlapBySumPush, OverlapBySumSpec, OverlapPush, OverlapSpec,
};
use crate::primitives::WORKGROUP;

/// The logarithm that stands for no dilation.
const NO_DILATION: f32 = -1e30;

/// Method of computing an overlap, all in float32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// QR of the stacked scaled axes. The engine uses no other method; the sweep measures the cost of the other.
    #[default]
    Qr,
    /// Determinant and adjugate of the summed covariances; NaN if they fail.
    Determinant,
}

/// Parameters of an overlap, besides the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Method of computation.
    pub method: Method,
    /// Share of a Gaussian's largest scale to which its other scales are raised.
    pub floor: f32,
    /// Standard deviation, in world units, added to every axis in quadrature; 0 for none.
    pub dilation: f32,
}

impl Default for Metric {
    fn default() -> Self {
        Self { method: Method::Qr, floor: SCALE_FLOOR, dilation: 0.0 }
    }
}

impl Metric {
    /// S_ii = pi^(3/2) s1 s2 s3 of the function that N has for a Gaussian with these logarithms of scales: clamped, widened and
    /// raised as `glsl/qirf/axes.comp` does.
    pub fn self_overlap(self, log_scales: [f32; 3]) -> f64 {
        let clamped =
            |log: f32| f64::from(if log.is_nan() { -LARGEST_LOG } else { log.clamp(-LARGEST_LOG, LARGEST_LOG) });
        let dilation = f64::from(self.dilation);
        let widened =
            |log: f64| if dilation > 0.0 { 0.5 * ((2.0 * log).exp() + dilation * dilation).ln() } else { log };
        let logs = log_scales.map(|log| widened(clamped(log)));
        let least = logs.into_iter().fold(f64::NEG_INFINITY, f64::max) + f64::from(self.floor).ln();
        std::f64::consts::PI.powf(1.5) * logs.iter().map(|log| log.max(least)).sum::<f64>().exp()
    }
}

/// Records the lower triangles of a batch.
///
/// The diagonal is exactly 1, and all other entries lie within [0, 1]. Scales are clamped to exp(-69)..exp(69), a zero
/// quaternion counts as the identity, and a Gaussian with a NaN mean overlaps with nothing.
pub(super) fn record(recording: &mut Recording, arrays: &Arrays, model: &Resident, batch: &Batch, metric: &Metric) {
    let kernel = Axes {
        members: &arrays.members,
        means: &model.parameters.means,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        axes: &arrays.axes,
        push: AxesPush {
            first: batch.members.start as u32,
            count: batch.members.len() as u32,
            log_dilation: if metric.dilation > 0.0 { metric.dilation.ln() } else { NO_DILATION },
            least: metric.floor,
        },
        spec: AxesSpec { workgroup: WORKGROUP },
    };
    recording.dispatch(&kernel, Groups::Count((batch.members.len() as u32).div_ceil(WORKGROUP)));
    let tiles = Groups::Count(batch.tiles.len() as u32);
    // Both formulas take the same arrays.
    macro_rules! by {
        ($Kernel:ident, $Push:ident, $Spec:ident) => {{
            let kernel = $Kernel {
                blocks: &arrays.blocks,
                tiles: &arrays.tiles,
                axes: &arrays.axes,
                overlaps: &arrays.overlaps,
                push: $Push {
                    first_tile: batch.tiles.start as u32,
                    tile_count: batch.tiles.len() as u32,
                    first_member: batch.members.start as u32,
                },
                spec: $Spec { workgroup: arrays.rows, columns: arrays.columns },
            };
            recording.dispatch(&kernel, tiles);
        }};
    }
    match metric.method {
        Method::Qr => by!(Overlap, OverlapPush, OverlapSpec),
        Method::Determinant => by!(OverlapBySum, OverlapBySumPush, OverlapBySumSpec),
    }
}
