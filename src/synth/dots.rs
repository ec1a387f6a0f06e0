//! White dots on black at known places on a sphere, seen from within: what a lens does to them can be measured.

use glam::{DVec2, DVec3};

use super::{path::View, render::Picture};

/// The sphere's centre and radius in metres: cameras walk around the centre as those of panoramas do.
const CENTRE: DVec3 = DVec3::new(0.0, 0.0, 1.5);
const RADIUS: f64 = 10.0;
/// Standard deviation of a dot in the photo, and the distance from its middle up to which it is drawn, in pixels.
const SIZE: f64 = 1.2;
const REACH: f64 = 6.0;

/// Places of so many dots, spread evenly (a Fibonacci lattice).
pub(super) fn places(count: usize) -> Vec<DVec3> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let place = |i: usize| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let turn = golden * i as f64;
        CENTRE + DVec3::new(turn.cos(), turn.sin(), 0.0) * (RADIUS * (1.0 - z * z).sqrt()) + DVec3::Z * (RADIUS * z)
    };
    (0..count).map(place).collect()
}

/// The photo of a view, and the pixel of each dot in it. Dots that the photo's border would cut are left out.
pub(super) fn picture(view: &View, places: &[DVec3]) -> (Picture, Vec<Option<DVec2>>) {
    let (width, height) = (view.camera.width, view.camera.height);
    let inner = DVec2::new(f64::from(width), f64::from(height)) - REACH;
    let whole = |pixel: &DVec2| pixel.cmpge(DVec2::splat(REACH)).all() && pixel.cmple(inner).all();
    let shown: Vec<_> = places.iter().map(|place| view.project(*place).filter(whole)).collect();
    let mut light = vec![0.0; width as usize * height as usize];
    for dot in shown.iter().flatten() {
        let (low, high) = (dot - REACH, dot + REACH);
        for y in low.y as u32..high.y as u32 {
            for x in low.x as u32..high.x as u32 {
                let off = DVec2::new(f64::from(x), f64::from(y)) + 0.5 - dot;
                light[y as usize * width as usize + x as usize] += (-0.5 * off.length_squared() / (SIZE * SIZE)).exp();
            }
        }
    }
    let pixel = |light: f64| {
        let grey = (255.0 * light.min(1.0)).round() as u8;
        [grey, grey, grey, 255]
    };
    let pixels = light.into_iter().map(pixel).collect();
    (Picture { width, height, pixels, mask: Vec::new(), depths: Vec::new() }, shown)
}
