//! A scene: its ground, and the objects on it.

use super::{
    Effect, Kind, SynthOptions,
    builder::{Builder, Ground, Surface},
    bvh::Bvh,
    geometry::Solid,
    materials::Gloss,
    plaza, terrain,
};

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

impl Place {
    /// The scene that the options ask for.
    pub fn new(options: &SynthOptions) -> Self {
        let mut b = Builder { solids: Vec::new(), surfaces: Vec::new() };
        let ground = match options.kind {
            Kind::Plaza | Kind::Panorama | Kind::Dots => {
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
