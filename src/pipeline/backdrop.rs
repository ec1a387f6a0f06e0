//! The colour around an object in opaque photos: a backdrop, or the background of rendered pictures. Where Gaussians need not draw it, they
//! draw the object: 2 to 5 dB more in short runs (docs/decisions.md, 204).

use crate::sample::evenly;
use crate::scene::{AlphaRole, Photo};
use rayon::prelude::*;
use std::io;

/// Largest number of photos that are looked at.
const PHOTOS: usize = 64;
/// Share of the pixels at the photos' edges that must have the colour.
const SHARE: f64 = 0.9;
/// How far a channel may be from the colour, of 255; a colour as near to black is black.
const ALIKE: u8 = 3;

/// The colour, red, green and blue in 0..1, that nearly all pixels at the edges of photos have, and their share; hidden pixels have none.
/// None for black, for photos with alpha, and where edges differ.
///
/// # Errors
/// Photos in a file that cannot be read.
pub fn backdrop(photos: &[Photo]) -> io::Result<Option<([f32; 3], f64)>> {
    let role = AlphaRole::of(photos);
    if role == AlphaRole::Alpha {
        return Ok(None);
    }
    let ring = |photo: &&Photo| -> io::Result<Vec<[u8; 4]>> {
        let pixels = photo.pixels.read()?;
        let mut rows = pixels.as_chunks::<4>().0.chunks_exact((photo.camera.width as usize).max(1));
        let mut ring = [rows.next(), rows.next_back()].into_iter().flatten().flatten().copied().collect::<Vec<_>>();
        ring.extend(rows.flat_map(|row| [row[0], row[row.len() - 1]]));
        Ok(ring)
    };
    let sampled: Vec<&Photo> = evenly(photos, PHOTOS).collect();
    let rings = sampled.par_iter().map(ring).collect::<io::Result<Vec<_>>>()?;
    let pixels: usize = rings.iter().map(Vec::len).sum();
    let mut edge: Vec<[u8; 3]> = Vec::with_capacity(pixels);
    for (photo, ring) in sampled.iter().zip(&rings) {
        let seen = ring.iter().filter(|p| photo.alpha_role != AlphaRole::Mask || p[3] == u8::MAX);
        edge.extend(seen.map(|p| [p[0], p[1], p[2]]));
    }
    if edge.is_empty() {
        return Ok(None);
    }
    let middle = edge.len() / 2;
    let colour = [0, 1, 2].map(|c| *edge.iter().map(|p| p[c]).collect::<Vec<u8>>().select_nth_unstable(middle).1);
    let is_alike = |p: &&[u8; 3]| p.iter().zip(&colour).all(|(a, b)| a.abs_diff(*b) <= ALIKE);
    let share = edge.iter().filter(is_alike).count() as f64 / pixels as f64;
    let found = share >= SHARE && colour.iter().any(|channel| *channel > ALIKE);
    Ok(found.then(|| (colour.map(|channel| f32::from(channel) / 255.0), share)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;
    use glam::DVec3;

    #[test]
    fn the_colour_of_the_edges_is_found() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.5, 12, 10);
        let photo = |at: &dyn Fn(usize, usize) -> [u8; 4], role| {
            let pixels: Vec<u8> = (0..120).flat_map(|k| at(k % 12, k / 12)).collect();
            Photo { alpha_role: role, ..Photo::opaque(camera.clone(), pixels) }
        };
        let object = |x: usize, y: usize| (3..9).contains(&x) && (3..8).contains(&y);
        let white = |x, y| if object(x, y) { [200, 30, 30, 255] } else { [254, 255, 253, 255] };
        let black = |x, y| if object(x, y) { [200, 30, 30, 255] } else { [2, 0, 1, 255] };
        let room = |x: usize, y: usize| [20 * x as u8, 20 * y as u8, 90, 255];
        let half =
            |x: usize, y: usize| if x < 6 { [9, 90, 9, 255] } else { [50, 60, 70, if y == 5 { 255 } else { 0 }] };
        let few = |x: usize, _: usize| [9, 90, 9, if x == 5 { 0 } else { 255 }];
        let of =
            |at: &dyn Fn(usize, usize) -> [u8; 4], role| backdrop(&[photo(at, role)]).unwrap().map(|found| found.0);
        assert_eq!(of(&white, AlphaRole::Opaque), Some([254, 255, 253].map(|v: u8| f32::from(v) / 255.0)));
        assert_eq!(of(&few, AlphaRole::Mask), Some([9, 90, 9].map(|v: u8| f32::from(v) / 255.0)), "few are hidden");
        for (at, role) in [
            (&white as &dyn Fn(usize, usize) -> [u8; 4], AlphaRole::Alpha),
            (&black, AlphaRole::Opaque),
            (&room, AlphaRole::Opaque),
            (&half, AlphaRole::Opaque),
            (&half, AlphaRole::Mask),
        ] {
            assert_eq!(of(at, role), None);
        }
        assert_eq!(backdrop(&[]).unwrap(), None);
    }
}
