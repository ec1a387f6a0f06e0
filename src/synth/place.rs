//! A scene: its ground, and the objects on it.

use super::{
    Effect, Kind, SynthOptions,
    bvh::Bvh,
    geometry::Solid,
    materials::{Gloss, Paint},
    noise::rgb,
    plaza, sky, terrain,
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
    /// Which painting.
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

/// A scene without floor and sky.
pub(super) struct Place {
    pub solids: Vec<Solid>,
    pub surfaces: Vec<Surface>,
    pub bvh: Bvh,
    /// Indices of the solids that are large enough to darken their surroundings.
    pub shading: Vec<u32>,
    pub floor_gloss: Option<Gloss>,
    pub ground: Ground,
}

/// The polish of everything else if every surface reflects.
const VARNISH: Gloss = Gloss { f0: 0.08, shininess: 60.0 };

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

impl Place {
    /// The scene that the options ask for.
    pub fn new(options: &SynthOptions) -> Self {
        let mut b = Builder { solids: Vec::new(), surfaces: Vec::new() };
        let ground = match options.kind {
            Kind::Plaza | Kind::Panorama => {
                plaza::build(&mut b, options.seed);
                Ground::PLAZA
            }
            Kind::Terrain => terrain::build(&mut b, options),
        };
        let mut floor_gloss = None;
        if options.has(Effect::Matte) {
            b.surfaces.iter_mut().for_each(|look| look.gloss = None);
        } else if options.has(Effect::Glossy) {
            b.surfaces.iter_mut().for_each(|look| look.gloss = look.gloss.or(Some(VARNISH)));
            floor_gloss = Some(VARNISH);
        }
        let large = |i: &u32| {
            let (low, high) = b.solids[*i as usize].bounds();
            (high - low).min_element() > 0.23
        };
        let shading = (0..b.solids.len() as u32).filter(large).collect();
        Self { bvh: Bvh::new(&b.solids), solids: b.solids, surfaces: b.surfaces, shading, floor_gloss, ground }
    }
}
