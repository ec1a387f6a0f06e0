//! Depths of a model's pictures: expected and median, along the camera's axis.

use std::path::Path;

use glam::DVec3;
use image::{ColorType, ImageEncoder, codecs::png};

use super::evaluate::pictures;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::write_atomically;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::kernels::constants::sh::float64::SH_C0;
use crate::render::{Image, Painter, Settings, Source};
use crate::scene::camera::Camera;

/// Steps of the 16-bit files by near plane: in usual scenes, whose near plane is 0.2, a step is a thousandth of a unit.
const STEPS_BY_NEAR: f64 = 200.0;

/// Depths of one picture in world units, row by row: of Gaussians' centres along the camera's axis, as they are blended.
#[derive(Clone, Debug, PartialEq)]
pub struct Depths {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The mean, weighted by each Gaussian's contribution to the pixel; infinite without any.
    pub expected: Vec<f32>,
    /// The depth at which the transmittance falls to a half; infinite if it does not.
    pub median: Vec<f32>,
}

/// Colours of degree 0 by which a picture of Gaussians with these means shows their depths, in near planes. No colour has an upper
/// bound, so that all depths have the precision of float32, whatever the largest is.
fn colours(means: &[[f32; 3]], camera: &Camera, near: f64) -> Vec<f32> {
    let depth = |mean: &[f32; 3]| camera.depth(DVec3::from_array(mean.map(f64::from)));
    means.iter().flat_map(|mean| [((depth(mean) / near - 0.5) / SH_C0) as f32; 3]).collect()
}

/// A model of the same shapes with these colours of degree 0, a red, a green and a blue for each Gaussian.
pub(crate) fn coloured(model: &Gaussians, colours: Vec<f32>) -> Gaussians {
    let Gaussians { means, log_scales, rotations, opacity_logits, .. } = model;
    let [means, log_scales] = [means, log_scales].map(Clone::clone);
    let sh = vec![colours];
    Gaussians { means, log_scales, rotations: rotations.clone(), opacity_logits: opacity_logits.clone(), sh }
}

/// Draws depths of one model.
pub struct DepthPainter {
    device: Device,
    /// The model with depths as colours.
    model: Gaussians,
    /// The same on the device, if that holds the whole model.
    resident: Option<Resident>,
    painter: Painter,
    /// The near plane in world units.
    near: f64,
}

impl DepthPainter {
    /// A painter of pictures of at most `size`; `whole` if the device can hold the whole model.
    pub fn new(
        device: &Device,
        model: &Gaussians,
        settings: Settings,
        size: [u32; 2],
        whole: bool,
    ) -> Result<Self, Error> {
        let settings = Settings { background: [0.0; 3], ..settings };
        let model = coloured(model, vec![0.0; 3 * model.len()]);
        let resident = whole.then(|| Resident::upload(device, &model)).transpose()?;
        let painter = if whole {
            Painter::new(device, settings, model.len(), size)?
        } else {
            Painter::of(device, settings, Source::Host(&model), size)?
        };
        Ok(Self {
            device: device.clone(),
            model,
            resident,
            painter: painter.with_medians(),
            near: settings.near.into(),
        })
    }

    /// The depths that a camera sees.
    pub fn draw(&mut self, camera: &Camera) -> Result<Depths, Error> {
        let colours = colours(&self.model.means, camera, self.near);
        let source = if let Some(resident) = &self.resident {
            resident.parameters.sh[0].write(&self.device, &colours)?;
            Source::Device(resident)
        } else {
            self.model.sh[0] = colours;
            Source::Host(&self.model)
        };
        let Image { width, height, pixels } = self.painter.render(source, camera)?;
        let depth = |share: f32, over: f32| {
            if share > 0.0 && over > 0.0 {
                (f64::from(share) / f64::from(over) * self.near) as f32
            } else {
                f32::INFINITY
            }
        };
        let expected = pixels.iter().map(|[sum, _, _, alpha]| depth(*sum, *alpha)).collect();
        let median = pixels.iter().map(|[_, median, ..]| depth(*median, 1.0)).collect();
        Ok(Depths { width, height, expected, median })
    }
}

/// The length of a step of 16-bit files in world units: a power of ten.
pub fn unit(near: f32) -> f64 {
    10_f64.powf((f64::from(near) / STEPS_BY_NEAR).log10().round())
}

impl Depths {
    /// Writes the depths beside `picture`: x.depth.npy, x.depth.png, x.median.npy and x.median.png of x.png.
    pub fn write(&self, picture: &Path, unit: f64) -> Result<(), Error> {
        for (name, depths) in [("depth", &self.expected), ("median", &self.median)] {
            let file = |extension: &str| picture.with_extension(format!("{name}.{extension}"));
            let shape = [u64::from(self.height), u64::from(self.width)];
            write_atomically(&file("npy"), |out| pictures::npy(out, &shape, depths)).map_err(Error::writing)?;
            let steps = depths.iter().flat_map(|depth| step(*depth, unit).to_ne_bytes());
            let bytes: Vec<u8> = steps.collect();
            write_atomically(&file("png"), |out| {
                png::PngEncoder::new(out)
                    .write_image(&bytes, self.width, self.height, ColorType::L16.into())
                    .map_err(std::io::Error::other)
            })
            .map_err(Error::writing)?;
        }
        Ok(())
    }
}

/// A depth in steps of `unit`: 0 for none, at most 65,535.
fn step(depth: f32, unit: f64) -> u16 {
    if depth.is_finite() { (f64::from(depth) / unit).round().max(1.0) as u16 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_thousandths_of_usual_units_and_saturate() {
        assert_eq!([0.2, 0.002, 20.0].map(unit), [1e-3, 1e-5, 0.1]);
        let steps = [1.2345, 1e-9, 70.0, f32::INFINITY].map(|depth| step(depth, 1e-3));
        assert_eq!(steps, [1235, 1, u16::MAX, 0]);
    }
}
