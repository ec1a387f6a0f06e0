//! Options of the synthetic scene.

use super::{Error, lens::Calibration};
use crate::wording::named;

named! {
    /// A part of image formation that the scene can require.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
    #[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
    pub enum Effect {
        /// Every photo has its own gain (±15 %) and white balance
        Exposure = "exposure",
        /// The lens bends the picture by several pixels (OPENCV: k1, k2, p1, p2)
        Distortion = "distortion",
        /// A fisheye lens (OPENCV_FISHEYE: k1..k4)
        Fisheye = "fisheye",
        /// Photos carry alpha: sky and floor are transparent
        Alpha = "alpha",
        /// Something moves between photos; masks/ hides it and its shadow (black = ignore)
        Masks = "masks",
        /// Near and far cameras: pixel footprints differ by a factor of 4 and more
        Scales = "scales",
        /// All surfaces are glossy: all colours are view-dependent
        Glossy = "glossy",
        /// No surface reflects: no colour depends on the view
        Matte = "matte",
        /// Three cameras with their own focal lengths and picture sizes
        Cameras = "cameras",
    }
}

named! {
    /// The subject of the photos.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    #[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
    pub enum Kind {
        /// A plaza with objects, photographed from all sides
        #[default]
        Plaza = "plaza",
        /// A strip of land, photographed from a drone; its length grows with the number of photos
        Terrain = "terrain",
        /// The plaza in equirectangular panoramas, from a walk among its objects
        Panorama = "panorama",
        /// White dots on black on all sides, for measuring lenses; the points are the centres of the dots
        Dots = "dots",
    }
}

impl Kind {
    /// True if an effect belongs to objects, cameras or lenses that scenes of this kind do not have.
    const fn lacks(self, effect: Effect) -> bool {
        match self {
            Self::Plaza => false,
            Self::Dots => true,
            Self::Terrain => matches!(effect, Effect::Masks | Effect::Scales | Effect::Alpha | Effect::Fisheye),
            // One lens, which is no other, on one path.
            Self::Panorama => {
                matches!(
                    effect,
                    Effect::Scales | Effect::Cameras | Effect::Distortion | Effect::Fisheye | Effect::Masks
                )
            }
        }
    }
}

/// Options of the synthetic scene: equal options give equal bytes, on any number of threads.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthOptions {
    /// The subject of the photos.
    pub kind: Kind,
    /// Number of photos, 1..=9999.
    pub views: usize,
    /// Width of a photo in pixels, 16..=8192.
    pub width: u32,
    /// Height of a photo in pixels, 16..=8192.
    pub height: u32,
    /// Seed of all random numbers: camera jitter, sampling, scattered objects.
    pub seed: u64,
    /// The lens of all photos; by default that of the kind and the effects.
    pub lens: Option<Calibration>,
    /// Greatest number of points in `points3D.txt`, 0..=1,000,000; there are fewer if cameras see too little.
    pub points: usize,
    /// True to write depth maps, too.
    pub depth: bool,
    /// Effects that the scene requires; order and repetitions do not matter.
    pub effects: Vec<Effect>,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            kind: Kind::Plaza,
            views: 48,
            width: 240,
            height: 180,
            seed: 1,
            lens: None,
            points: 6000,
            depth: false,
            effects: Vec::new(),
        }
    }
}

impl SynthOptions {
    /// True if the scene requires `effect`.
    pub fn has(&self, effect: Effect) -> bool {
        self.effects.contains(&effect)
    }

    /// The requested effects, each once, in the order of [`Effect::ALL`].
    pub(super) fn sorted_effects(&self) -> Vec<Effect> {
        Effect::ALL.into_iter().filter(|&e| self.has(e)).collect()
    }

    /// Refuses numbers out of range and effects that exclude each other.
    pub(super) fn check(&self) -> Result<(), Error> {
        let range = |what, value: u64, low, high| {
            if (low..=high).contains(&value) { Ok(()) } else { Err(Error::Range { what, value, low, high }) }
        };
        range("the number of views", self.views as u64, 1, 9999)?;
        range("the photos' width", self.width.into(), 16, 8192)?;
        range("the photos' height", self.height.into(), 16, 8192)?;
        range("the number of points", self.points as u64, 0, 1_000_000)?;
        for (a, b) in [(Effect::Glossy, Effect::Matte), (Effect::Distortion, Effect::Fisheye)] {
            if self.has(a) && self.has(b) {
                return Err(Error::Conflict(a, b));
            }
        }
        if let Some(effect) = self.effects.iter().find(|effect| self.kind.lacks(**effect)) {
            return Err(Error::NotThere { effect: *effect, kind: self.kind });
        }
        if self.kind == Kind::Dots && self.depth {
            return Err(Error::NoDepth);
        }
        if self.lens.is_some() {
            let lenses = [Effect::Distortion, Effect::Fisheye, Effect::Cameras];
            if let Some(effect) = lenses.into_iter().find(|effect| self.has(*effect)) {
                return Err(Error::Lenses(format!("the effect \"{effect}\"")));
            }
            if self.kind == Kind::Panorama {
                return Err(Error::Lenses("the kind panorama".to_owned()));
            }
        }
        if self.kind == Kind::Panorama && self.width != 2 * self.height {
            return Err(Error::NoPanorama { width: self.width, height: self.height });
        }
        Ok(())
    }
}
