//! Models: Gaussians as stored, on the host and on the device, and their file formats.

mod attributes;
mod band_rotations;
mod bands;
mod edit;
mod error;
pub mod formats;
pub(crate) mod order;
pub mod outline;
pub mod resident;
pub mod sh;

pub use crate::kernels::constants::projection::MIN_QUATERNION;
pub use attributes::Attributes;
pub use error::Error;

/// Highest spherical-harmonics degree that the engine supports.
pub const MAX_SH_DEGREE: usize = 3;

/// The opacity, 0 to 1, of a logit as stored.
pub fn opacity(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// A 3DGS model as stored: one array per attribute, all of the same length `n`.
///
/// Stored values are those that the optimiser changes: scales are logarithms, opacities are logits, quaternions are (w,
/// x, y, z) of any length. This is the layout of the standard 3DGS PLY without its interleaving.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians<T = f32> {
    /// Centres in world units, n.
    pub means: Vec<[T; 3]>,
    /// Natural logarithms of the axes' standard deviations, n.
    pub log_scales: Vec<[T; 3]>,
    /// Quaternions (w, x, y, z), not necessarily of unit length, n.
    pub rotations: Vec<[T; 4]>,
    /// Opacity before the sigmoid, n.
    pub opacity_logits: Vec<T>,
    /// Spherical harmonics, one array per degree l = 0..=L; band l holds n x (2l + 1) x 3 floats: per Gaussian its
    /// 2l + 1 coefficients in the order m = -l..=l, each red, green, blue.
    pub sh: Vec<Vec<T>>,
}

impl<T> Gaussians<T> {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// True if the model has no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The SH degree: the number of bands minus one.
    pub fn degree(&self) -> usize {
        self.sh.len().saturating_sub(1)
    }
}

impl Gaussians {
    /// Floats per Gaussian in band `l`: (2l + 1) coefficients of three colours.
    pub const fn band_width(l: usize) -> usize {
        (2 * l + 1) * 3
    }
}
