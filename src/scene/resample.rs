//! Resampling of 8-bit images: exact area average, and undistortion.
//!
//! Both work in the stored values (no gamma is undone, as in every published evaluation) with float32 sums and round to
//! the nearest 8-bit value. Colours are weighted by their alpha where there is one, so that compositing after
//! resampling gives the same as resampling after compositing; and by their mask, so that what it hides stays hidden.

use glam::{DVec2, Vec2};
use rayon::prelude::*;

use super::camera::Camera;
use super::faces::Face;
use super::lens::{Lens, LensModel};

/// An image of `C` interleaved 8-bit channels, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Raster<const C: usize> {
    pub width: u32,
    pub height: u32,
    /// width x height x C bytes.
    pub pixels: Vec<u8>,
}

/// Source pixels along a pixel's side for each of its cubic samples, and the most such samples: cubic ones read 36
/// pixels, bilinear ones 4.
const CUBIC: (f64, usize) = (1.5, 2);

/// Number of channels of colours, alpha and mask.
pub(crate) const MASKED: usize = 5;

/// One pixel as float32, colours times alpha / 255 if the image is RGBA with transparency, and all times the mask if it has one.
/// Hidden pixels keep a little of their weight: they are all that there is amid others.
fn lift<const C: usize>(pixel: &[u8; C], alpha: bool) -> [f32; C] {
    let mut lifted = pixel.map(f32::from);
    if alpha && C >= 4 {
        let a = lifted[3] / 255.0;
        lifted[..3].iter_mut().for_each(|c| *c *= a);
    }
    if C == MASKED {
        let weight = (lifted[4] + 0.25) / 255.25;
        lifted[..4].iter_mut().for_each(|c| *c *= weight);
        lifted[4] = weight;
    }
    lifted
}

/// The inverse of [`lift`], rounded.
fn lower<const C: usize>(mut sum: [f32; C], alpha: bool) -> [u8; C] {
    if C == MASKED {
        let weight = sum[4];
        sum[..4].iter_mut().for_each(|c| *c /= weight);
    }
    if alpha && C >= 4 {
        let a = sum[3] / 255.0;
        sum[..3].iter_mut().for_each(|c| *c = if a > 0.0 { *c / a } else { 0.0 });
    }
    sum.map(|c| (c + 0.5).clamp(0.0, 255.0) as u8)
}

impl Raster<4> {
    /// The image with a mask of its shape as a fifth channel, which weights the others.
    pub fn masked(&self, mask: &Raster<1>) -> Raster<MASKED> {
        let same = (mask.width, mask.height) == (self.width, self.height);
        let resized = (!same).then(|| area_average(mask, self.width, self.height, false));
        let mask = resized.as_ref().unwrap_or(mask);
        let both = self.pixels.as_chunks::<4>().0.iter().zip(&mask.pixels);
        let pixels = both.flat_map(|([r, g, b, a], mask)| [*r, *g, *b, *a, *mask]).collect();
        Raster { width: self.width, height: self.height, pixels }
    }
}

impl Raster<MASKED> {
    /// The image without its mask.
    pub fn unmasked(&self) -> Raster<4> {
        let pixels = self.pixels.as_chunks::<MASKED>().0.iter().flat_map(|[r, g, b, a, _]| [*r, *g, *b, *a]).collect();
        Raster { width: self.width, height: self.height, pixels }
    }
}

/// For each output index: the first source index it overlaps and the weights of it and the following, sum 1.
fn overlaps(from: u32, to: u32) -> Vec<(usize, Vec<f32>)> {
    let (from, to) = (u64::from(from), u64::from(to));
    (0..to)
        .map(|i| {
            // In units of 1 / to of a source pixel, output i covers [i from, (i + 1) from).
            let (start, end) = (i * from, (i + 1) * from);
            let first = start / to;
            let weights = (first..end.div_ceil(to))
                .map(|s| (end.min((s + 1) * to) - start.max(s * to)) as f32 / from as f32)
                .collect();
            (first as usize, weights)
        })
        .collect()
}

/// Every output pixel is the mean of the source over exactly the area that it covers.
pub(crate) fn area_average<const C: usize>(source: &Raster<C>, width: u32, height: u32, alpha: bool) -> Raster<C> {
    let (columns, rows) = (overlaps(source.width, width), overlaps(source.height, height));
    let mut pixels = vec![0; width as usize * height as usize * C];
    let in_rows = source.pixels.as_chunks::<C>().0;
    let stride = source.width as usize;
    pixels.par_chunks_mut(width as usize * C).zip(&rows).for_each_init(
        || vec![[0.0_f32; C]; stride],
        |column_sums, (out, (first, weights))| {
            column_sums.fill([0.0; C]);
            for (row, weight) in in_rows.chunks(stride).skip(*first).zip(weights) {
                for (sum, pixel) in column_sums.iter_mut().zip(row) {
                    let value = lift(pixel, alpha);
                    (0..C).for_each(|c| sum[c] += weight * value[c]);
                }
            }
            for (pixel, (first, weights)) in out.as_chunks_mut::<C>().0.iter_mut().zip(&columns) {
                let mut sum = [0.0; C];
                for (value, weight) in column_sums[*first..].iter().zip(weights) {
                    (0..C).for_each(|c| sum[c] += weight * value[c]);
                }
                *pixel = lower(sum, alpha);
            }
        },
    );
    Raster { width, height, pixels }
}

/// The image that `camera` (any size) sees through an ideal pinhole, taken from a photo through `lens`.
///
/// One resampling does both undistortion and reduction: each output pixel averages n x n bilinear samples, n about the
/// number of source pixels along its side. The lens is evaluated at the output pixels' corners and interpolated
/// between: within one pixel its map is practically linear. `lens` must have the photo's size.
pub(crate) fn undistort<const C: usize>(source: &Raster<C>, lens: &Lens, camera: &Camera, alpha: bool) -> Raster<C> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let ratio = (lens.focal / camera.focal).max_element();
    let n = (ratio - 0.25).ceil().clamp(1.0, 64.0) as usize;
    let corner = |x: usize, y: usize| {
        let pixel = DVec2::new(x as f64, y as f64);
        lens.project((pixel - camera.principal) / camera.focal).as_vec2()
    };
    let mut pixels = vec![0; width * height * C];
    pixels.par_chunks_mut(width * C).enumerate().for_each(|(y, out)| {
        let (mut upper, mut under) = (corner(0, y), corner(0, y + 1));
        for (x, pixel) in out.as_chunks_mut::<C>().0.iter_mut().enumerate() {
            let (upper_next, under_next) = (corner(x + 1, y), corner(x + 1, y + 1));
            let mut sum = [0.0_f32; C];
            for j in 0..n {
                let v = (j as f32 + 0.5) / n as f32;
                let (start, end) = (upper.lerp(under, v), upper_next.lerp(under_next, v));
                for i in 0..n {
                    let value = bilinear(source, start.lerp(end, (i as f32 + 0.5) / n as f32), alpha, false);
                    (0..C).for_each(|c| sum[c] += value[c]);
                }
            }
            *pixel = lower(sum.map(|s| s / (n * n) as f32), alpha);
            (upper, under) = (upper_next, under_next);
        }
    });
    Raster { width: camera.width, height: camera.height, pixels }
}

/// The part of a photo that `camera`, of a face, sees: each output pixel averages n x n samples; n follows the number
/// of source pixels along its side in the middle. `lens` must have the photo's size.
pub(crate) fn cut<const C: usize>(
    source: &Raster<C>,
    (lens, face): (&Lens, &Face),
    camera: &Camera,
    alpha: bool,
) -> Raster<C> {
    let width = camera.width as usize;
    let ratio = (lens.focal / camera.focal).max_element();
    let few = (ratio / CUBIC.0).ceil().max(1.0) as usize;
    let sharp = few <= CUBIC.1;
    let n = if sharp { few } else { (ratio - 0.25).ceil().min(64.0) as usize };
    let back = face.turn.transpose();
    let closed = lens.model == LensModel::Equirectangular;
    let at = |place: DVec2| {
        let pixel = lens.pixel_of(back * camera.ray(place)).as_vec2();
        let value = sharp.then(|| cubic(source, pixel, alpha, closed)).filter(|value| counts_fully(value, alpha));
        value.unwrap_or_else(|| bilinear(source, pixel, alpha, closed))
    };
    let mut pixels = vec![0; width * camera.height as usize * C];
    pixels.par_chunks_mut(width * C).enumerate().for_each(|(y, out)| {
        for (x, pixel) in out.as_chunks_mut::<C>().0.iter_mut().enumerate() {
            let mut sum = [0.0_f32; C];
            for k in 0..n * n {
                let within = DVec2::new((k % n) as f64 + 0.5, (k / n) as f64 + 0.5) / n as f64;
                let value = at(DVec2::new(x as f64, y as f64) + within);
                (0..C).for_each(|c| sum[c] += value[c]);
            }
            *pixel = lower(sum.map(|s| s / (n * n) as f32), alpha);
        }
    });
    Raster { width: camera.width, height: camera.height, pixels }
}

/// The image's value at a position in pixels (centres at + 0.5), edges repeated; if it is `closed`, its first
/// column follows its last one.
fn bilinear<const C: usize>(source: &Raster<C>, at: Vec2, alpha: bool, closed: bool) -> [f32; C] {
    let (width, height) = (source.width as usize, source.height as usize);
    let last = Vec2::new((width - 1) as f32, (height - 1) as f32);
    let turned = if closed { Vec2::new((at.x - 0.5).rem_euclid(width as f32) + 0.5, at.y) } else { at };
    let most = if closed { last + Vec2::X } else { last };
    let at = (turned - 0.5).clamp(Vec2::ZERO, most);
    let (x, y) = ((at.x as usize).min(width - 1), at.y as usize);
    let share = at - Vec2::new(x as f32, y as f32);
    let right = if closed { (x + 1) % width } else { (x + 1).min(width - 1) };
    let below = (y + 1).min(height - 1);
    let pixels = source.pixels.as_chunks::<C>().0;
    let get = |x: usize, y: usize| lift(&pixels[y * width + x], alpha);
    let (a, b, c, d) = (get(x, y), get(right, y), get(x, below), get(right, below));
    std::array::from_fn(|i| {
        let upper = a[i] + share.x * (b[i] - a[i]);
        let under = c[i] + share.x * (d[i] - c[i]);
        upper + share.y * (under - upper)
    })
}

/// Keys' cubic of fourth order (Keys 1981): the weight of a pixel at this distance.
fn keys(distance: f32) -> f32 {
    let x = distance.abs();
    if x < 1.0 {
        (4.0 / 3.0 * x - 7.0 / 3.0) * x * x + 1.0
    } else if x < 2.0 {
        ((-7.0 / 12.0 * x + 3.0) * x - 59.0 / 12.0) * x + 2.5
    } else {
        ((x / 12.0 - 2.0 / 3.0) * x + 1.75) * x - 1.5
    }
}

/// True if all pixels of a cubic count in full: at the edges of masks and of alpha, its negative weights would show.
fn counts_fully<const C: usize>(value: &[f32; C], alpha: bool) -> bool {
    let weight = match C {
        1 => value[0] / 255.0,
        MASKED => value[4],
        _ => 1.0,
    };
    let opacity = if alpha && C >= 4 { value[3] / 255.0 } else { 1.0 };
    [weight, opacity].iter().all(|share| (share - 1.0).abs() < 1e-3)
}

/// The value of [`bilinear`], but by a cubic through six pixels a side, which is sharper. If the image is `closed`, it continues
/// beyond its upper and lower edges on the other side of the poles.
fn cubic<const C: usize>(source: &Raster<C>, at: Vec2, alpha: bool, closed: bool) -> [f32; C] {
    let (width, height) = (source.width as i64, source.height as i64);
    let at = at - 0.5;
    let first = at.floor();
    let weights = (at - first).to_array().map(|t| [-2.0, -1.0, 0.0, 1.0, 2.0, 3.0].map(|k: f32| keys(t - k)));
    let pixels = source.pixels.as_chunks::<C>().0;
    let mut sum = [0.0; C];
    for (j, down) in (-2..).zip(weights[1]) {
        let row = first.y as i64 + j;
        let beyond = closed && !(0..height).contains(&row);
        let mirrored = if row < 0 { -1 - row } else { 2 * height - 1 - row };
        let row = if beyond { mirrored } else { row }.clamp(0, height - 1);
        for (i, along) in (-2..).zip(weights[0]) {
            let column = first.x as i64 + i + if beyond { width / 2 } else { 0 };
            let column = if closed { column.rem_euclid(width) } else { column.clamp(0, width - 1) };
            let value = lift(&pixels[(row * width + column) as usize], alpha);
            (0..C).for_each(|c| sum[c] += down * along * value[c]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::faces::{CUBE, turn};
    use glam::DVec3;

    #[test]
    fn overlaps_sum_to_one_and_cover_the_source() {
        for (from, to) in [(1, 1), (7, 7), (10, 3), (1080, 144), (3, 7), (1, 5), (4097, 4096)] {
            let all = overlaps(from, to);
            let mut coverage = vec![0.0_f64; from as usize];
            for (first, weights) in &all {
                assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                weights.iter().enumerate().for_each(|(i, w)| coverage[first + i] += f64::from(*w));
            }
            let expected = f64::from(to) / f64::from(from);
            assert!(coverage.iter().all(|c| (c - expected).abs() < 1e-5), "{from} to {to}");
        }
    }

    #[test]
    fn area_average_of_halves_and_thirds() {
        let source = Raster::<1> { width: 3, height: 2, pixels: vec![0, 90, 255, 60, 30, 255] };
        let small = area_average(&source, 1, 1, false);
        assert_eq!(small.pixels, [115]); // 690 / 6
        let wide = area_average(&source, 2, 1, false);
        assert_eq!(wide.pixels, [40, 190]); // columns 30, 60, 255: (30 + 60 / 2) / 1.5, (60 / 2 + 255) / 1.5
    }

    #[test]
    fn transparent_pixels_lend_no_colour() {
        let source = Raster::<4> { width: 2, height: 1, pixels: vec![200, 100, 50, 255, 0, 255, 255, 0] };
        assert_eq!(area_average(&source, 1, 1, true).pixels, [200, 100, 50, 128]);
    }

    #[test]
    fn hidden_pixels_lend_no_colour() {
        let photo = Raster::<4> { width: 2, height: 1, pixels: vec![200, 100, 50, 255, 0, 255, 255, 255] };
        let small = |mask: [u8; 2], alpha| {
            let mask = Raster::<1> { width: 2, height: 1, pixels: mask.into() };
            area_average(&photo.masked(&mask), 1, 1, alpha).unmasked().pixels
        };
        for alpha in [false, true] {
            assert_eq!(small([255, 0], alpha), [200, 100, 50, 255]);
            assert_eq!(small([0, 0], alpha), [100, 178, 153, 255], "all there is");
        }
    }

    /// Weights of a constant sum to one, and a pixel's own centre has its own value.
    #[test]
    fn weights_of_a_cubic() {
        for t in 0..=10 {
            let t = t as f32 / 10.0;
            let sum: f32 = (-2..=3).map(|k| keys(t - k as f32)).sum();
            assert!((sum - 1.0).abs() < 1e-6, "{t}: {sum}");
        }
        assert_eq!([0.0, 1.0, 2.0, 3.0].map(|x| (keys(x) * 1e6).round()), [1e6, 0.0, 0.0, 0.0]);
    }

    /// The face of a panorama whose pixels are means of a fine pattern is near the means of that pattern.
    #[test]
    fn faces_are_as_sharp_as_their_panorama() {
        let pattern = |d: DVec3| 127.5 + 60.0 * ((45.0 * d.x).sin() + (40.0 * d.y + 25.0 * d.z).cos());
        let mean = |at: &dyn Fn(DVec2) -> DVec3, x: usize, y: usize| -> f64 {
            let within = |k: usize| DVec2::new((k % 8) as f64 + 0.5, (k / 8) as f64 + 0.5) / 8.0;
            (0..64).map(|k| pattern(at(DVec2::new(x as f64, y as f64) + within(k)).normalize())).sum::<f64>() / 64.0
        };
        let lens = Lens::from_colmap(LensModel::Equirectangular, 256, 128, &[256.0, 128.0]).unwrap();
        let along = |pixel: DVec2| {
            let [lon, lat] =
                [(pixel.x / 256.0 - 0.5) * std::f64::consts::TAU, (0.5 - pixel.y / 128.0) * std::f64::consts::PI];
            DVec3::new(lat.cos() * lon.sin(), -lat.sin(), lat.cos() * lon.cos())
        };
        let grey = |value: f64| [value.round() as u8; 4];
        let pixels = (0..128 * 256).flat_map(|i| grey(mean(&along, i % 256, i / 256))).collect();
        let source = Raster::<4> { width: 256, height: 128, pixels };
        for (_, axes) in CUBE {
            let face =
                Face { photo: String::new(), turn: turn(axes), pole: 0.0, reach: std::f64::consts::PI, masked: false };
            let camera = Camera {
                rotation: glam::DMat3::IDENTITY,
                translation: glam::DVec3::ZERO,
                focal: DVec2::splat(32.0),
                principal: DVec2::splat(32.0),
                width: 64,
                height: 64,
                whole: None,
            };
            let seen = |pixel: DVec2| face.turn.transpose() * camera.ray(pixel);
            let got = cut(&source, (&lens, &face), &camera, false);
            let errors = (0..64 * 64).map(|i| (f64::from(got.pixels[4 * i]) - mean(&seen, i % 64, i / 64)).powi(2));
            let rms = (errors.sum::<f64>() / 4096.0).sqrt();
            assert!(rms < if axes[2].y == 0.0 { 1.0 } else { 1.4 }, "{rms}");
        }
    }

    /// Beyond a pole, a panorama continues with the columns on its other side.
    #[test]
    fn panoramas_continue_beyond_their_poles() {
        let (width, height) = (8_usize, 6_usize);
        let value = |x: usize, y: usize| [(17 * x + 31 * y + 5 * x * y) as u8; 4];
        let image = |rows: &mut dyn Iterator<Item = (usize, usize)>, height: usize| {
            let pixels =
                rows.flat_map(|(y, turn)| (0..width).flat_map(move |x| value((x + turn) % width, y))).collect();
            Raster::<4> { width: width as u32, height: height as u32, pixels }
        };
        let alone = image(&mut (0..height).map(|y| (y, 0)), height);
        let below = (0..3).rev().map(|y| (y, width / 2)).chain((0..height).map(|y| (y, 0)));
        let extended = image(&mut below.chain((3..height).rev().map(|y| (y, width / 2))), height + 6);
        for at in [Vec2::new(2.3, 0.2), Vec2::new(7.9, 1.4), Vec2::new(0.1, 5.9)] {
            let [own, other] =
                [(&alone, at), (&extended, at + 3.0 * Vec2::Y)].map(|(image, at)| cubic(image, at, false, true));
            assert!(own.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-2), "{at}: {own:?} {other:?}");
        }
    }

    #[test]
    fn undistortion_by_a_pinhole_lens_changes_nothing() {
        let lens = Lens::from_colmap(LensModel::Pinhole, 5, 4, &[6.0, 6.5, 2.4, 2.1]).unwrap();
        let camera = Camera {
            rotation: glam::DMat3::IDENTITY,
            translation: glam::DVec3::ZERO,
            focal: lens.focal,
            principal: lens.principal,
            width: 5,
            height: 4,
            whole: None,
        };
        let pixels: Vec<u8> = (0..5 * 4 * 4).map(|i| (i * 37 % 256) as u8).collect();
        let source = Raster::<4> { width: 5, height: 4, pixels };
        assert_eq!(undistort(&source, &lens, &camera, false), source);
    }
}
