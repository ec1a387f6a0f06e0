//! A panorama of all directions (equirectangular), from six pictures.

use super::draw_source::DrawSource;
use super::evaluate::pictures;
use super::render::{RenderConfig, RenderTimes};
use crate::gaussians::Gaussians;
use crate::job::{Error, Session, Stage};
use crate::render::{Image, Painter};
use crate::scene::camera::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::time::Instant;

/// Pixels of a panorama's width by focal length of its six pictures: enough that their middles, where they are coarsest, are finer.
const WIDTH_BY_FOCAL: u32 = 5;
/// Widest panorama in pixels.
pub const WIDEST: u32 = 16_384;

/// A panorama.
#[derive(Clone, Copy, Debug)]
pub struct Panorama {
    /// Position of the camera, in world units.
    pub eye: DVec3,
    /// Up in the world.
    pub up: DVec3,
    /// Width in pixels, [`WIDEST`] at most; the height is half of it.
    pub width: u32,
}

impl Panorama {
    /// Right, up and forward: the middle looks along z in captures' axes, and along y where z is up.
    fn axes(&self) -> [DVec3; 3] {
        let up = self.up.normalize_or(DVec3::NEG_Y);
        let level = if up.z.abs() > 0.5 { DVec3::Y } else { DVec3::Z };
        let forward = level.reject_from(up).normalize_or(up.any_orthonormal_vector());
        [forward.cross(up), up, forward]
    }

    /// The six cameras, each with a pixel more than a quarter of the horizon on each side.
    fn faces(&self) -> [Camera; 6] {
        let [right, up, forward] = self.axes();
        let focal = self.width.div_ceil(WIDTH_BY_FOCAL).max(1);
        let side = 2 * focal + 2;
        let looks = [(forward, up), (right, up), (-forward, up), (-right, up), (up, -forward), (-up, forward)];
        looks.map(|(to, up)| Camera {
            focal: DVec2::splat(f64::from(focal)),
            ..Camera::look_at(self.eye, self.eye + to, up, 1.0, side, side)
        })
    }

    /// The direction that a pixel shows.
    fn direction(&self, x: u32, y: u32) -> DVec3 {
        let [right, up, forward] = self.axes();
        let (sin, cos) = ((f64::from(x) + 0.5) / f64::from(self.width) * TAU - PI).sin_cos();
        let (high, level) = (0.5 * PI - (f64::from(y) + 0.5) / f64::from(self.height()) * PI).sin_cos();
        (forward * cos + right * sin) * level + up * high
    }

    fn height(&self) -> u32 {
        (self.width / 2).max(1)
    }

    /// The panorama of six pictures of [`Panorama::faces`].
    fn gather(&self, faces: &[Camera; 6], pictures: &[Image]) -> Image {
        let pixel = |n: usize| {
            let d = self.direction(n as u32 % self.width, n as u32 / self.width);
            let depth = |k: &usize| (faces[*k].rotation * d).z;
            let k = (0..6).max_by(|a, b| depth(a).total_cmp(&depth(b))).unwrap_or_default();
            bilinear(&pictures[k], faces[k].project(faces[k].rotation * d))
        };
        let pixels = self.width as usize * self.height() as usize;
        Image { width: self.width, height: self.height(), pixels: (0..pixels).into_par_iter().map(pixel).collect() }
    }
}

/// A picture's value at a point, in pixels.
fn bilinear(image: &Image, at: DVec2) -> [f32; 4] {
    let most = DVec2::new(f64::from(image.width - 1), f64::from(image.height - 1));
    let at = (at - 0.5).clamp(DVec2::ZERO, most);
    let [x, y] = [at.x.floor(), at.y.floor()];
    let (u, v) = ((at.x - x) as f32, (at.y - y) as f32);
    let value = |x: u32, y: u32| {
        let (x, y) = (x.min(image.width - 1), y.min(image.height - 1));
        image.pixels[y as usize * image.width as usize + x as usize]
    };
    let (x, y) = (x as u32, y as u32);
    let (a, b, c, d) = (value(x, y), value(x + 1, y), value(x, y + 1), value(x + 1, y + 1));
    std::array::from_fn(|i| (a[i] * (1.0 - u) + b[i] * u) * (1.0 - v) + (c[i] * (1.0 - u) + d[i] * u) * v)
}

/// Draws a panorama and writes it.
///
/// # Errors
/// [`Error::Usage`] for one wider than [`WIDEST`]; device memory; device errors; a full disk; [`Error::Interrupted`].
pub fn draw(
    session: &Session<'_>,
    model: &Gaussians,
    panorama: &Panorama,
    config: &RenderConfig,
    file: &Path,
) -> Result<RenderTimes, Error> {
    if !(2..=WIDEST).contains(&panorama.width) {
        return Err(Error::Usage(format!("a panorama is 2 to {WIDEST} pixels wide, not {}", panorama.width)));
    }
    let faces = panorama.faces();
    let size = [faces[0].width, faces[0].height];
    let shown = DrawSource::for_pictures(session, model, size, config.settings.style)?;
    let mut painter = Painter::of(session.device, config.settings, shown.source(), size)?;
    let begun = Instant::now();
    let mut pictures = Vec::with_capacity(faces.len());
    for (done, face) in faces.iter().enumerate() {
        session.watcher.step(Stage::Rendering, done, faces.len())?;
        pictures.push(painter.render(shown.source(), face)?);
    }
    let draw_s = begun.elapsed().as_secs_f64();
    session.watcher.progress(Stage::Rendering, faces.len(), faces.len());
    pictures::write(file, &panorama.gather(&faces, &pictures), config.format, config.transparent)?;
    Ok(RenderTimes { total_s: begun.elapsed().as_secs_f64(), draw_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six pictures of a function of the direction give that function of the direction.
    #[test]
    fn every_pixel_has_its_direction() {
        for up in [DVec3::NEG_Y, DVec3::Z, DVec3::X] {
            let panorama = Panorama { eye: DVec3::new(1.0, 2.0, 3.0), up, width: 64 };
            let faces = panorama.faces();
            let of = |d: DVec3| [d.x as f32, d.y as f32, d.z as f32, 1.0];
            let pictures: Vec<Image> = faces
                .iter()
                .map(|face| {
                    let pixel = |n: u32| {
                        let at = DVec2::new(f64::from(n % face.width) + 0.5, f64::from(n / face.width) + 0.5);
                        of((face.rotation.transpose() * face.ray(at)).normalize())
                    };
                    Image {
                        width: face.width,
                        height: face.height,
                        pixels: (0..face.width * face.height).map(pixel).collect(),
                    }
                })
                .collect();
            let whole = panorama.gather(&faces, &pictures);
            assert_eq!((whole.width, whole.height), (64, 32));
            for (n, pixel) in whole.pixels.iter().enumerate() {
                let d = of(panorama.direction(n as u32 % 64, n as u32 / 64));
                assert!(pixel.iter().zip(d).all(|(a, b)| (a - b).abs() < 3e-3), "{n}: {pixel:?} {d:?}");
            }
            // The top is up, and the right half is to the right of the middle.
            let [right, up, forward] = panorama.axes();
            assert!(panorama.direction(32, 0).dot(up) > 0.99 && panorama.direction(32, 16).dot(forward) > 0.99);
            assert!(panorama.direction(48, 16).dot(right) > 0.99);
        }
        let captures = Panorama { eye: DVec3::ZERO, up: DVec3::NEG_Y, width: 8 };
        assert_eq!(captures.axes(), [DVec3::X, DVec3::NEG_Y, DVec3::Z]);
    }
}
