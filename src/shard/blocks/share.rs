//! Each block's share of the error in pixels that several blocks paint.
//!
//! All blocks train at once, each with the others as they were. If every block corrected a shared pixel's whole error,
//! the sum would overshoot. A block therefore trains towards the earlier picture plus its share of the difference to
//! the photo, which is the share of the picture contributed by the Gaussians it trains. To first order, the shares of
//! all blocks add up to the photo; in a margin that two blocks train, each corrects the whole error, since its copies
//! of the other's Gaussians are dropped when the blocks meet.

use crate::gaussians::Gaussians;
use crate::job::Error;
use crate::kernels::constants::sh::float64::SH_C0;
use crate::pipeline::depth::coloured;
use crate::pipeline::setup::Setup;
use crate::render::{Image, Painter, Source};
use crate::scene::{AlphaRole, Photo, camera};
use crate::train::{self, Exposures, exposure};
use std::io;

/// Turns `photo` into a block's training target: from the picture `before`, drawn over the background and exposed by
/// `map`, towards the photo by `share`, whose red channel is the block's share of each pixel.
fn mix(photo: &mut Photo, share: &Image, before: &Image, map: Option<&[f32]>, background: [f32; 3]) -> io::Result<()> {
    let mut bytes = photo.pixels.read()?.into_owned();
    for ((pixel, share), before) in bytes.chunks_exact_mut(4).zip(&share.pixels).zip(&before.pixels) {
        let share = share[0].clamp(0.0, 1.0);
        let opacity = if photo.alpha_role == AlphaRole::Alpha { f32::from(pixel[3]) / 255.0 } else { 1.0 };
        for c in 0..3 {
            let exposed = map.map_or(before[c], |map| {
                map[4 * c..4 * c + 3].iter().zip(before).map(|(m, v)| m * v).sum::<f32>() + map[4 * c + 3]
            });
            let taken = f32::from(pixel[c]) * opacity + 255.0 * background[c] * (1.0 - opacity);
            pixel[c] = (share * taken + (1.0 - share) * 255.0 * exposed).round().clamp(0.0, 255.0) as u8;
        }
        if photo.alpha_role == AlphaRole::Alpha {
            pixel[3] = 255;
        }
    }
    if photo.alpha_role == AlphaRole::Alpha {
        photo.alpha_role = AlphaRole::Opaque;
    }
    photo.pixels = bytes.into();
    Ok(())
}

/// The model with `rows` in white and the others in black.
fn in_white(model: &Gaussians, rows: &[usize]) -> Gaussians {
    let [black, white] = [-0.5, 0.5].map(|from_grey| (from_grey / SH_C0) as f32);
    let mut sh = vec![black; 3 * model.len()];
    for i in rows {
        sh[3 * i..3 * i + 3].fill(white);
    }
    coloured(model, sh)
}

impl Setup<'_> {
    /// Replaces the photos by the block's training targets. `model` is the scene as the block finds it, `rows` are the
    /// block's Gaussians in it, and `nothing` is the block's share of the light that no Gaussian contributes: 0..=1,
    /// with sum 1 over all blocks.
    pub(super) fn take_share(&mut self, model: &Gaussians, rows: &[usize], nothing: f32) -> Result<(), Error> {
        let (device, style) = (self.session.device, self.config.style);
        let size = camera::largest(self.prepared.train.iter().map(|photo| &photo.camera));
        let in_white = in_white(model, rows);
        let background = self.prepared.background;
        let mut painter = Painter::of(device, self.prepared.settings(style), Source::Host(model), size)?;
        let mut paint = |model: &Gaussians, over: [f32; 3], photo: &Photo| {
            painter.renderer().set_background(over);
            painter.render(Source::Host(model), &photo.camera)
        };
        let maps: &[f32] = match &self.exposures {
            Exposures::Known(maps) => maps,
            Exposures::Learnt(_) => &[],
        };
        for (number, photo) in self.prepared.train.iter_mut().enumerate() {
            self.session.watcher.unless_stopped()?;
            let share = paint(&in_white, [nothing; 3], photo)?;
            let before = paint(model, background, photo)?;
            let map = maps.chunks_exact(exposure::SIZE).nth(number);
            mix(photo, &share, &before, map, background).map_err(train::Error::Photos)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;
    use glam::DVec3;

    fn image(pixel: [f32; 4]) -> Image {
        Image { width: 4, height: 1, pixels: vec![pixel; 4] }
    }

    /// The picture that a block with this `share` trains towards, in bytes of red, green, blue and the fourth.
    fn mixed(alpha_role: AlphaRole, share: f32, map: Option<&[f32]>) -> [u8; 4] {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, 4, 1);
        let mut photo = Photo { camera, pixels: [200, 100, 0, 51].repeat(4).into(), alpha_role, depth: None };
        mix(&mut photo, &image([share; 4]), &image([0.4, 0.2, 0.8, 1.0]), map, [1.0, 0.0, 0.0]).unwrap();
        let bytes = photo.pixels.read().unwrap();
        assert!(bytes.chunks_exact(4).all(|pixel| pixel == &bytes[..4]));
        assert_eq!(photo.alpha_role == AlphaRole::Mask, alpha_role == AlphaRole::Mask);
        [bytes[0], bytes[1], bytes[2], bytes[3]]
    }

    #[test]
    fn the_shares_of_all_blocks_make_good_the_whole_error() {
        let before = [102, 51, 204];
        for (alpha_role, photo) in [(AlphaRole::Opaque, [200, 100, 0]), (AlphaRole::Alpha, [244, 20, 0])] {
            assert_eq!(mixed(alpha_role, 1.0, None)[..3], photo);
            assert_eq!(mixed(alpha_role, 0.0, None)[..3], before.map(|byte| byte as u8));
            let parts = [0.2, 0.3, 0.5].map(|share| mixed(alpha_role, share, None));
            for c in 0..3 {
                let sum: i32 = parts.iter().map(|part| i32::from(part[c]) - before[c]).sum();
                assert!((sum - (i32::from(photo[c]) - before[c])).abs() <= 2, "{sum} of channel {c}");
            }
        }
        // Masks stay. Transparent photos become opaque: they are drawn over the background.
        assert_eq!([AlphaRole::Mask, AlphaRole::Alpha].map(|byte| mixed(byte, 0.5, None)[3]), [51, 255]);
    }

    #[test]
    fn pictures_are_exposed_before_they_are_mixed() {
        let map = [0.5, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        assert_eq!(mixed(AlphaRole::Opaque, 0.0, Some(&map))[..3], [77, 51, 51]);
    }

    #[test]
    fn what_a_block_paints_is_white() {
        let model = in_white(&Gaussians::zeroed(3, 3), &[1]);
        let brightness = |i: usize| 0.5 + SH_C0 * f64::from(model.sh[0][3 * i]);
        assert!(brightness(0).abs() < 1e-7 && (brightness(1) - 1.0).abs() < 1e-7 && brightness(2).abs() < 1e-7);
        assert!(model.degree() == 0 && model.validate().is_ok());
    }
}
