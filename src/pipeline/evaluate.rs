//! Held-out views: rendered, scored, and written as pictures.

use crate::error::Error;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::metrics::{self, Networks, Scores};
use crate::render::{Image, Renderer, Settings};
use crate::train::photos::TrainView;

/// Red, green, blue of a photo in [0, 1] over a background, row by row.
pub fn truth(view: &TrainView, background: [f32; 3]) -> Vec<f32> {
    let mut out = Vec::with_capacity(view.pixels.len() / 4 * 3);
    for p in view.pixels.chunks_exact(4) {
        let alpha = f32::from(p[3]) / 255.0;
        for c in 0..3 {
            out.push(f32::from(p[c]) / 255.0 * alpha + background[c] * (1.0 - alpha));
        }
    }
    out
}

/// Red, green, blue of a rendered picture, clamped to [0, 1].
pub fn rgb(image: &Image) -> Vec<f32> {
    image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]].map(|v| v.clamp(0.0, 1.0))).collect()
}

/// Renders views of a model one after the other.
pub struct Evaluator {
    renderer: Renderer,
    background: [f32; 3],
}

impl Evaluator {
    /// For views of at most the size of the largest given.
    ///
    /// # Errors
    /// Device memory.
    pub fn new<'a>(
        device: &Device,
        settings: Settings,
        gaussians: usize,
        views: impl Iterator<Item = &'a TrainView>,
    ) -> Result<Self, Error> {
        let (width, height) = views.fold((1, 1), |(w, h), v| (w.max(v.camera.width), h.max(v.camera.height)));
        let renderer = Renderer::new(device, settings, gaussians, width, height)?;
        Ok(Self { renderer, background: settings.background })
    }

    /// Renders a view.
    ///
    /// # Errors
    /// Device errors.
    pub fn render(&mut self, model: &Resident, view: &TrainView) -> Result<Image, Error> {
        Ok(self.renderer.render(model, &view.camera)?)
    }

    /// Draws a view without reading it back: what the frame rate counts.
    ///
    /// # Errors
    /// Device errors.
    pub fn draw(&mut self, model: &Resident, view: &TrainView) -> Result<(), Error> {
        self.renderer.draw(model, &view.camera)?;
        Ok(())
    }

    /// Scores a rendered view against its photo.
    ///
    /// # Errors
    /// Networks that do not fit the picture are noted in the scores, not errors; sizes always agree here.
    pub fn score(&self, image: &Image, view: &TrainView, networks: &Networks) -> Result<Scores, Error> {
        let (rendered, photo) = (rgb(image), truth(view, self.background));
        let (w, h) = (image.width as usize, image.height as usize);
        let rendered = metrics::Image::new(w, h, &rendered)?;
        let photo = metrics::Image::new(w, h, &photo)?;
        Ok(metrics::evaluate(&rendered, &photo, networks)?)
    }

    /// Mean PSNR over views in dB, without pictures or networks: a point of the quality curve. None without views.
    ///
    /// # Errors
    /// Device errors.
    pub fn psnr<'a>(
        &mut self,
        model: &Resident,
        views: impl Iterator<Item = &'a TrainView>,
    ) -> Result<Option<f64>, Error> {
        let (mut sum, mut n) = (0.0, 0);
        for view in views {
            let image = self.render(model, view)?;
            let (rendered, photo) = (metrics::round_trip_8bit(&rgb(&image)), truth(view, self.background));
            let photo = metrics::round_trip_8bit(&photo);
            let (w, h) = (image.width as usize, image.height as usize);
            sum += metrics::psnr(&metrics::Image::new(w, h, &rendered)?, &metrics::Image::new(w, h, &photo)?)?;
            n += 1;
        }
        Ok((n > 0).then(|| sum / f64::from(n)))
    }
}
