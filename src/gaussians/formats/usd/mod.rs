//! OpenUSD: `ParticleField3DGaussianSplat` (OpenUSD 26.03 and later) in a text layer, or in a USDZ package of one.
//!
//! Arrays of one entry a Gaussian: `positions`, `orientations` (w, x, y, z, unit), `scales` and `opacities` (linear); SH Gaussian by
//! Gaussian, (degree + 1)^2 triples each. A name that ends in `h` holds halves. Layers are right-up-back where Y is up, and that
//! after a quarter turn about x where Z is up; their unit is `metersPerUnit`. The schema knows neither dilation nor anti-aliasing: the tag lies in the prim's
//! `customData`. The local origin of means is its translation. Facts: openusd.org/release/user_guides/schemas/usdVol.

mod arrays;
mod package;
mod read;
mod scan;
mod transform;
mod write;

use super::fault::{Fault, malformed};
use super::{Format, Gaussians, Parsed, Tag};
pub(super) use package::{package, read_package};
pub(super) use read::read;
pub(super) use write::write;

/// Type of a prim that holds Gaussians.
const PRIM: &str = "ParticleField3DGaussianSplat";
/// Key of the tag in `customData`; values are those of PLY's comment.
const TAG: &str = "SplatRenderMode";
const AGAIN: &str = "fetch or export the file again";

/// The refusal of a binary layer.
pub(super) fn binary() -> Fault {
    Fault::Unsupported("a binary USD layer (.usdc); export it as text, such as with `usdcat FILE -o FILE.usda`".into())
}
