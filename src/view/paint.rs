//! Pictures of other quantities than colours: a model in false colours, drawn by the same kernels, and the conversion
//! of the result.

use super::protocol::Picture;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::job::diagnostics::{self, Diagnostics, NO_BLOCK};
use crate::kernels::constants::sh::float64::SH_C0;
use crate::metrics::{self, psnr, round_trip_8bit};
use crate::qirf::partition::Partition;
use crate::random::mix;
use crate::render::Image;
use crate::sample::evenly;
use crate::scene::camera::Camera;
use glam::DVec3;

/// Quantiles, over the Gaussians in front of the camera, of the depths at the ends of a depth picture's scale.
const DEPTHS: [f64; 2] = [0.02, 0.98];
/// Number of Gaussians sampled for that scale.
const SAMPLES: usize = 5_000;
/// Number of Gaussians at the upper end of a count picture's logarithmic scale.
const MOST_BLENDED: f32 = 255.0;
/// Difference at the upper end of an error picture's scale.
const LARGEST_ERROR: f32 = 0.25;

/// SH coefficient of degree 0 for a colour.
fn coefficient(colour: f32) -> f32 {
    ((f64::from(colour) - 0.5) / SH_C0) as f32
}

/// The same Gaussians in other colours, 3 numbers per Gaussian in [0, 1]. The model shares all buffers except the
/// colours.
pub fn painted(device: &Device, model: &Resident, colours: &[f32]) -> Result<Resident, Error> {
    let coefficients: Vec<f32> = colours.iter().map(|c| coefficient(*c)).collect();
    let mut parameters = model.parameters.clone();
    parameters.sh[0] = device.upload("painted", &coefficients)?;
    Ok(Resident::new(device, parameters, 0, model.len)?)
}

/// A view of a model with fewer SH bands.
pub fn of_degree(device: &Device, model: &Resident, degree: usize) -> Result<Resident, Error> {
    Ok(Resident::new(device, model.parameters.clone(), degree.min(model.degree), model.len)?)
}

/// Depth of each Gaussian as a share of a scale, as 3 equal numbers, and the scale's ends in world units.
pub fn depths(means: &[[f32; 3]], camera: &Camera) -> (Vec<f32>, [f64; 2]) {
    let depth = |m: &[f32; 3]| camera.depth(DVec3::from_array(m.map(f64::from)));
    let mut sample: Vec<f64> = evenly(means, SAMPLES).map(depth).filter(|z| *z > 0.0).collect();
    sample.sort_by(f64::total_cmp);
    let at = |share: f64| sample.get((share * sample.len() as f64) as usize).or(sample.last()).copied();
    let [near, far] = DEPTHS.map(|share| at(share).unwrap_or(1.0));
    let range = (far - near).max(1e-9 * far.abs()).max(f64::MIN_POSITIVE);
    let share = |m: &[f32; 3]| ((depth(m) - near) / range).clamp(0.0, 1.0) as f32;
    (means.iter().flat_map(|m| [share(m); 3]).collect(), [near, far])
}

fn block_colour(block: u32) -> [f32; 3] {
    let bits = mix(u64::from(block));
    let colour = std::array::from_fn(|c| 0.15 + 0.8 * ((bits >> (16 * c)) & 0xffff) as f32 / 65535.0);
    if block == NO_BLOCK { PLAIN } else { colour }
}

/// A colour for each block of the default partition.
pub fn blocks(means: &[[f32; 3]]) -> Vec<f32> {
    let mut colours = vec![0.0; 3 * means.len()];
    for (members, b) in Partition::default().of(means).blocks.iter().zip(0..) {
        for i in members {
            colours[3 * *i as usize..][..3].copy_from_slice(&block_colour(b));
        }
    }
    colours
}

/// Colours for Gaussians outside the prune, kept, kept in place of merged ones, and dropped.
const PLAIN: [f32; 3] = [0.35, 0.37, 0.40];
const KEPT: [f32; 3] = [0.20, 0.75, 0.30];
const MERGED: [f32; 3] = [0.95, 0.80, 0.20];
const DROPPED: [f32; 3] = [0.85, 0.15, 0.12];
/// Colours of guards; the first that applies is used.
const GUARDS: [(u8, [f32; 3]); 4] = [
    (diagnostics::REPAIRED, [0.90, 0.20, 0.75]),
    (diagnostics::CANONICAL, [0.95, 0.60, 0.15]),
    (diagnostics::UNSEEN, [0.20, 0.45, 0.95]),
    (diagnostics::DETAIL, [0.30, 0.85, 0.85]),
];

/// Colours, 3 numbers per Gaussian, of a prune's diagnostics in this picture; `None` for pictures without any.
pub fn told(picture: Picture, facts: &Diagnostics) -> Option<Vec<f32>> {
    let fate = |flags: &u8| match flags {
        f if f & diagnostics::KEPT != 0 => KEPT,
        f if f & diagnostics::MERGED != 0 => MERGED,
        _ => DROPPED,
    };
    let guard = |flags: &u8| GUARDS.iter().find(|(flag, _)| flags & flag != 0).map_or(PLAIN, |(_, colour)| *colour);
    Some(match picture {
        Picture::Blocks => facts.block.iter().flat_map(|b| block_colour(*b)).collect(),
        Picture::Kept => facts.flags.iter().flat_map(fate).collect(),
        Picture::Score => shares(&facts.score).into_iter().flat_map(scale).collect(),
        Picture::Participation if facts.participation.is_empty() => return None,
        Picture::Participation => shares(&facts.participation).into_iter().flat_map(scale).collect(),
        Picture::Guards => facts.flags.iter().flat_map(guard).collect(),
        _ => return None,
    })
}

/// For each score the share of all that are lower, 0 to 1; NaN is the lowest.
fn shares(scores: &[f32]) -> Vec<f32> {
    let key = |s: &f32| if s.is_nan() { f32::NEG_INFINITY } else { *s + 0.0 };
    let mut sorted: Vec<f32> = scores.iter().map(key).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let others = scores.len().saturating_sub(1).max(1) as f32;
    scores.iter().map(|s| sorted.partition_point(|x| *x < key(s)) as f32 / others).collect()
}

/// Colours of the scale from 0 to 1: dark blue, blue, green, yellow, red.
const SCALE: [[f32; 3]; 5] =
    [[0.09, 0.07, 0.35], [0.12, 0.45, 0.85], [0.25, 0.75, 0.45], [0.95, 0.85, 0.25], [0.80, 0.12, 0.10]];

/// The scale's colour for a share; NaN counts as the largest.
fn scale(share: f32) -> [f32; 3] {
    let share = if share.is_nan() { 1.0 } else { share };
    let at = share.clamp(0.0, 1.0) * (SCALE.len() - 1) as f32;
    let below = (at as usize).min(SCALE.len() - 2);
    let part = at - below as f32;
    std::array::from_fn(|c| SCALE[below][c] * (1.0 - part) + SCALE[below + 1][c] * part)
}

/// A picture of depths, from one whose red channel holds them, weighted by opacity.
pub fn depth_picture(mut image: Image) -> Image {
    for pixel in &mut image.pixels {
        let [value, _, _, alpha] = *pixel;
        let [r, g, b] = if alpha > 1e-3 { scale(value / alpha).map(|c| c * alpha) } else { [0.0; 3] };
        *pixel = [r, g, b, alpha];
    }
    image
}

/// A picture of the number of Gaussians that each pixel blends, and their mean.
pub fn count_picture([width, height]: [u32; 2], counts: &[u32]) -> (Image, f32) {
    let colour = |count: &u32| {
        let [r, g, b] = scale((1.0 + *count as f32).ln() / (1.0 + MOST_BLENDED).ln());
        [r, g, b, 1.0]
    };
    let mean = counts.iter().map(|c| f64::from(*c)).sum::<f64>() / counts.len().max(1) as f64;
    (Image { width, height, pixels: counts.iter().map(colour).collect() }, mean as f32)
}

/// A grey picture of opacity.
pub fn alpha_picture(mut image: Image) -> Image {
    for pixel in &mut image.pixels {
        *pixel = [pixel[3], pixel[3], pixel[3], 1.0];
    }
    image
}

/// A picture of the mean absolute difference of two pictures (red, green, blue of each pixel), and their PSNR in dB, of 8-bit values as in
/// `eval`. `weights` are the shares of the values that count where a mask hides some; if it hides all, there is no PSNR.
pub fn error_picture(
    mut image: Image,
    rendered: &[f32],
    truth: &[f32],
    weights: Option<&[f32]>,
) -> Result<(Image, Option<f32>), metrics::Error> {
    for ((pixel, x), y) in image.pixels.iter_mut().zip(rendered.chunks_exact(3)).zip(truth.chunks_exact(3)) {
        let apart: [f32; 3] = std::array::from_fn(|c| x[c].clamp(0.0, 1.0) - y[c].clamp(0.0, 1.0));
        let [r, g, b] = scale(apart.iter().map(|d| d.abs()).sum::<f32>() / 3.0 / LARGEST_ERROR);
        *pixel = [r, g, b, 1.0];
    }
    if weights.is_some_and(|weights| weights.iter().all(|w| *w == 0.0)) {
        return Ok((image, None));
    }
    let (width, height) = (image.width as usize, image.height as usize);
    let [rendered, truth] = [rendered, truth].map(round_trip_8bit);
    let truth = metrics::Image::new(width, height, &truth)?;
    let truth = weights.map_or(Ok(truth), |weights| truth.weighted(weights))?;
    let db = psnr(&metrics::Image::new(width, height, &rendered)?, &truth)?;
    Ok((image, Some(db as f32)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_and_differences() {
        assert_eq!((scale(-1.0), scale(2.0), scale(f32::NAN)), (SCALE[0], SCALE[4], SCALE[4]));
        let pixels = vec![[0.5, 0.5, 0.5, 1.0]; 4];
        let image = Image { width: 2, height: 2, pixels };
        let (picture, db) = error_picture(image.clone(), &[0.6; 12], &[0.4; 12], None).unwrap();
        assert!((db.unwrap() - 13.9794).abs() < 1e-4, "{db:?}");
        assert!(picture.pixels[0].iter().zip(scale(0.8)).all(|(a, b)| (a - b).abs() < 1e-5));
        assert_eq!(error_picture(image, &[0.5; 12], &[0.5; 12], None).unwrap().1, Some(f32::INFINITY));
    }

    #[test]
    fn what_a_mask_hides_is_no_part_of_an_errors_psnr() {
        let image = Image { width: 2, height: 2, pixels: vec![[0.0; 4]; 4] };
        let [half, none] = [6, 0].map(|seen| (0..12).map(|k| if k < seen { 1.0 } else { 0.0 }).collect::<Vec<f32>>());
        // Both pictures have the background where the mask hides the photo.
        let rendered: Vec<f32> = half.iter().map(|w| 0.4 + 0.2 * w).collect();
        let db = |weights: &[f32]| error_picture(image.clone(), &rendered, &[0.4; 12], Some(weights)).unwrap().1;
        assert!((db(&half).unwrap() - 13.9794).abs() < 1e-4, "{:?}", db(&half));
        assert_eq!(db(&none), None);
    }

    #[test]
    fn counts_and_scores_have_scales() {
        let (picture, mean) = count_picture([2, 2], &[0, 255, 15, 4000]);
        let colour = |i: usize| [picture.pixels[i][0], picture.pixels[i][1], picture.pixels[i][2]];
        assert_eq!([0, 1, 2, 3].map(colour), [SCALE[0], SCALE[4], SCALE[2], SCALE[4]]);
        assert!((mean - 1067.5).abs() < 1e-3, "{mean}");
        assert_eq!(shares(&[3.0, f32::NAN, 3.0, 9.0, -0.0]), [0.5, 0.0, 0.5, 1.0, 0.25]);
        assert_eq!((shares(&[]).len(), shares(&[7.0])), (0, vec![0.0]));
    }

    #[test]
    fn a_prune_is_told_in_colours() {
        use diagnostics::{CANONICAL, DETAIL, KEPT as STAYS, MERGED as JOINED, REPAIRED, UNSEEN};
        let flags = vec![STAYS | DETAIL, JOINED, UNSEEN, STAYS | CANONICAL | UNSEEN, REPAIRED | CANONICAL, STAYS];
        let block = vec![0, 0, NO_BLOCK, 1, 1, 1];
        let facts = Diagnostics { block, score: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], flags, ..Diagnostics::default() };
        let of = |picture| -> Vec<[f32; 3]> {
            told(picture, &facts).unwrap().chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
        };
        assert_eq!(of(Picture::Kept), [KEPT, MERGED, DROPPED, KEPT, DROPPED, KEPT]);
        let [repaired, canonical, unseen, detail] = GUARDS.map(|(_, colour)| colour);
        assert_eq!(of(Picture::Guards), [detail, PLAIN, unseen, canonical, repaired, PLAIN]);
        let blocks = of(Picture::Blocks);
        assert!(blocks[0] == blocks[1] && blocks[3] == blocks[5] && blocks[0] != blocks[3] && blocks[2] == PLAIN);
        let participation = vec![5.0, 4.0, 3.0, 2.0, 1.0, 0.0];
        let solved = Diagnostics { participation, ..facts.clone() };
        let participations = told(Picture::Participation, &solved).expect("participations");
        assert_eq!(
            (participations[..3].to_vec(), participations[15..].to_vec()),
            (SCALE[4].to_vec(), SCALE[0].to_vec())
        );
        assert_eq!(told(Picture::Participation, &facts), None, "a prune without eigenproblems");
        let scores = of(Picture::Score);
        assert_eq!((scores[0], scores[5]), (SCALE[0], SCALE[4]));
        assert_eq!(told(Picture::Depth, &facts), None);
    }

    #[test]
    fn depths_are_shares_of_what_lies_in_front() {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, 8, 8);
        let means: Vec<[f32; 3]> = (0..=100).map(|i| [0.0, 0.0, i as f32]).chain([[0.0, 0.0, -5.0]]).collect();
        let (shares, [near, far]) = depths(&means, &camera);
        assert!((near - 3.0).abs() <= 1.0 && (far - 99.0).abs() <= 1.0, "{near} {far}");
        assert_eq!((shares[0], shares[300], shares[303]), (0.0, 1.0, 0.0));
        assert!(shares.windows(2).take(299).all(|w| w[0] <= w[1]));
        assert!(depths(&[], &camera).0.is_empty());
        assert!(depths(&[[0.0, 0.0, 2.0]], &camera).0.iter().all(|s| s.is_finite()));
    }
}
