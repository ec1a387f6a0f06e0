//! Edits of whole models on the host: crops, translations, rotations, removals, orders, merging.
//!
//! ```
//! use qirf_vk::edit::{Edit, Region, Similarity};
//! use qirf_vk::gaussians::formats;
//! use qirf_vk::glam::DVec3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut model = formats::read("tools/examples/ring.ply".as_ref())?.gaussians;
//! let whole = model.len();
//! let ball = Region::Sphere { centre: DVec3::ZERO, radius: 100.0 };
//! Edit::Transform(Similarity::turn(DVec3::X, 90.0)?).apply(&mut model)?; // colours turn along
//! let kept = Edit::Crop { region: ball, outside: false }.apply(&mut model)?;
//! assert_eq!(kept.map_or(whole, |kept| kept.iter().filter(|k| **k).count()), model.len());
//! # Ok(())
//! # }
//! ```
//!
//! An edit needs the model and one of its attributes in memory, and works on all cores; its results do not depend on their number.

mod editor;
mod error;
mod floaters;
mod merge;
mod region;
mod similarity;
mod transform;
mod unwanted;

pub use editor::{Editor, Step};
pub use error::Error;
pub use floaters::{Evidence, Reason, Sight, are_many_floaters, floater_warning};
pub use merge::{common_origin, merge, numbers, reading_warnings, rounding, rounding_warning};
pub use region::Region;
pub use similarity::{Similarity, between};
pub use unwanted::{INVISIBLE, NEEDLE, Unwanted};

use crate::gaussians::order::{reorder, z_order};
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};

/// One edit of a model.
#[derive(Clone, Debug, PartialEq)]
pub enum Edit {
    /// A similarity of the whole model, including spherical harmonics.
    Transform(Similarity),
    /// Keeps the Gaussians with their centre in a region, or outside of it.
    Crop {
        /// The region.
        region: Region,
        /// True to keep the Gaussians outside.
        outside: bool,
    },
    /// Drops the bands above this SH degree.
    ShDegree(usize),
    /// Removes Gaussians with a lower opacity, 0 to 1.
    MinOpacity(f64),
    /// Removes Gaussians whose longest axis has a larger standard deviation, in world units.
    MaxSize(f64),
    /// Removes Gaussians of a kind.
    Remove(Unwanted),
    /// Orders Gaussians along a Z-order curve of 21 bits an axis, so that neighbours in space are neighbours in the file.
    MortonOrder,
}

impl Edit {
    /// The flags of the Gaussians that this edit keeps, n; `None` if it cannot remove.
    pub fn kept(&self, model: &Gaussians) -> Option<Vec<bool>> {
        match self {
            Self::Crop { region, outside } => Some(region.kept(&model.means, *outside)),
            Self::MinOpacity(least) => Some(unwanted::at_least(model, *least)),
            Self::MaxSize(most) => Some(unwanted::at_most(model, *most)),
            Self::Remove(unwanted) => Some(unwanted.kept(model)),
            Self::Transform(_) | Self::ShDegree(_) | Self::MortonOrder => None,
        }
    }

    /// Edits a model; returns the flags of [`Edit::kept`], by the Gaussians' indices before.
    ///
    /// # Errors [`Error::Overflow`] if a position or size leaves the range of float32; the model is then invalid.
    pub fn apply(&self, model: &mut Gaussians) -> Result<Option<Vec<bool>>, Error> {
        let kept = self.kept(model);
        if let Some(kept) = &kept {
            model.compact(kept);
        }
        match self {
            Self::Transform(similarity) => transform::transform(model, similarity)?,
            Self::ShDegree(degree) => model.sh.truncate((*degree).min(MAX_SH_DEGREE) + 1),
            Self::MortonOrder => reorder(model, &z_order(model)),
            _ => {}
        }
        Ok(kept)
    }
}
