//! The parts of a scene, and the collection of its solids.

use super::{
    Kind,
    geometry::Solid,
    materials::{Gloss, Paint},
    noise::rgb,
    sky,
};

/// Material of a solid.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub paint: Paint,
    pub gloss: Option<Gloss>,
    /// About a pixel wide in the default photos.
    pub thin: bool,
}

/// The ground at z = 0, and the radius within which objects cast light and shadow on it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ground {
    /// Kind of scene whose ground is painted.
    pub kind: Kind,
    /// Radius of the dome about the origin, in metres.
    pub dome: f32,
    /// Square of the distance from the origin beyond which no shadow falls.
    pub shadows: f32,
    /// Square of the distance from the z axis beyond which nothing hides the sky.
    pub walls: f32,
}

impl Ground {
    /// The plaza's: nothing stands outside its fence.
    pub const PLAZA: Self = Self { kind: Kind::Plaza, dome: sky::DOME, shadows: 49.0, walls: 12.0 };
}

/// Solids and surfaces of a scene under construction.
pub(super) struct Builder {
    pub solids: Vec<Solid>,
    pub surfaces: Vec<Surface>,
}

impl Builder {
    pub fn put(&mut self, solid: Solid, paint: Paint) {
        self.solids.push(solid);
        self.surfaces.push(Surface { paint, gloss: None, thin: false });
    }

    pub fn thin(&mut self, solid: Solid, colour: u32) {
        self.solids.push(solid);
        self.surfaces.push(Surface { paint: Paint::Plain(rgb(colour)), gloss: None, thin: true });
    }
}
