//! Held-out views: rendered, scored, and written as pictures.

use super::exposure_fit::{exposed, right_half};
use super::pictures::{self, Format};
use crate::gpu::{Device, staging_bytes};
use crate::job::records::ViewScores;
use crate::job::{Error, Watcher};
use crate::metrics::{self, Networks, Scores};
use crate::pipeline::pair_capacity;
use crate::pipeline::prepare::Prepared;
use crate::render::{Image, Painter, Renderer, Settings, Source, Style, Uses};
use crate::scene::{AlphaRole, Names, Photo, camera};
use crate::train;
use crate::wording::counted;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// Number of frames timed for the frame rate.
const TIMED_FRAMES: usize = 20;
/// Bytes of pictures that are judged while as many are drawn, unless one alone has more.
const GROUP_BYTES: u64 = 1 << 28;
/// Alpha below which a whole view counts as empty.
const EMPTY: f32 = 1e-3;

/// Red, green, blue of a photo in [0, 1] over a background, row by row.
pub fn truth(view: &Photo, background: [f32; 3]) -> Result<Vec<f32>, Error> {
    let mut out = Vec::with_capacity(view.pixels.len() / 4 * 3);
    for p in view.pixels.read().map_err(train::Error::Photos)?.chunks_exact(4) {
        let alpha = f32::from(p[3]) / 255.0;
        for c in 0..3 {
            out.push(f32::from(p[c]) / 255.0 * alpha + background[c] * (1.0 - alpha));
        }
    }
    Ok(out)
}

/// Puts the background in a rendered picture (red, green, blue of each pixel) where its photo's mask hides the photo: where
/// these [`weights`] are below 1.
pub fn hide(rendered: &mut [f32], weights: Option<&[f32]>, background: [f32; 3]) {
    let Some(weights) = weights else { return };
    for (x, counts) in rendered.chunks_exact_mut(3).zip(weights.chunks_exact(3)) {
        for c in 0..3 {
            x[c] = x[c] * counts[c] + background[c] * (1.0 - counts[c]);
        }
    }
}

/// Share of each value of its picture that a photo's mask lets count, 0 to 1; none without a mask.
pub fn weights(view: &Photo) -> Result<Option<Vec<f32>>, Error> {
    if view.alpha_role != AlphaRole::Mask {
        return Ok(None);
    }
    let bytes = view.pixels.read().map_err(train::Error::Photos)?;
    Ok(Some(bytes.chunks_exact(4).flat_map(|p| [f32::from(p[3]) / 255.0; 3]).collect()))
}

/// Returns true if something of a photo's pixels in these columns and rows counts: masks hide the rest.
pub fn counts(view: &Photo, compared: impl Fn(usize, usize) -> bool) -> Result<bool, Error> {
    if view.alpha_role != AlphaRole::Mask {
        return Ok(true);
    }
    let (bytes, width) = (view.pixels.read().map_err(train::Error::Photos)?, view.camera.width as usize);
    Ok(bytes.chunks_exact(4).enumerate().any(|(n, p)| p[3] > 0 && compared(n % width, n / width)))
}

/// Red, green, blue of a rendered picture, clamped to [0, 1].
pub fn rgb(image: &Image) -> Vec<f32> {
    image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]].map(|v| v.clamp(0.0, 1.0))).collect()
}

/// The held-out views of a model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Their scores.
    pub views: Vec<ViewScores>,
    /// Views that rendered empty.
    pub empty: usize,
}

impl HeldOut {
    /// Mean scores; none without views that count.
    pub fn mean(&self) -> Option<Scores> {
        metrics::mean(&self.views.iter().map(|v| v.scores.clone()).collect::<Vec<_>>())
    }

    /// Reports views that rendered empty, and those without a score.
    pub fn warn(&self, watcher: &dyn Watcher) {
        let mut hidden = Names::default();
        self.views.iter().filter(|view| !view.scores.counts()).for_each(|view| hidden.add(&view.name));
        if hidden.count > 0 {
            let all = self.views.len();
            watcher.lost(&format!(
                "{} of {all} held-out views have no score, because masks hide them: {hidden}",
                hidden.count
            ));
        }
        if self.empty > 0 {
            let views = counted(self.empty, "held-out view");
            watcher.lost(&format!(
                "{views} rendered empty: the model shows nothing there; if they are photos, check the poses and the scene's \
                 scale"
            ));
        }
    }
}

/// A rendered picture and its photo, as they are compared.
struct Compared {
    size: [usize; 2],
    /// Red, green, blue in [0, 1].
    rendered: Vec<f32>,
    photo: Vec<f32>,
    /// Share of each value that a mask lets count, 0 to 1.
    weights: Option<Vec<f32>>,
}

impl Compared {
    fn images(&self) -> Result<[metrics::Image<'_>; 2], Error> {
        let [w, h] = self.size;
        let photo = metrics::Image::new(w, h, &self.photo)?;
        let photo = self.weights.as_ref().map_or(Ok(photo), |weights| photo.weighted(weights))?;
        Ok([metrics::Image::new(w, h, &self.rendered)?, photo])
    }
}

/// Renders views of a model one after the other, and compares them with their photos on all cores meanwhile.
pub struct Evaluator {
    painter: Painter,
    comparison: Comparison,
}

/// Comparison of rendered views and photos.
#[derive(Clone, Copy)]
pub struct Comparison {
    /// Colour behind the Gaussians.
    pub background: [f32; 3],
    /// True if photos have exposures of their own.
    pub fits_exposure: bool,
}

impl Comparison {
    /// A rendered picture as it is compared with its photo, red, green and blue in [0, 1]: exposed like the photo, if photos have
    /// exposures, with the background where a mask hides it. `truth` and `weights` are the photo's.
    pub fn picture(self, image: &Image, truth: &[f32], weights: Option<&[f32]>) -> Vec<f32> {
        let mut rendered = rgb(image);
        if self.fits_exposure {
            let mut seen = rendered.clone();
            hide(&mut seen, weights, self.background);
            rendered = exposed(&seen, truth, &rendered, image.width as usize);
        }
        hide(&mut rendered, weights, self.background);
        rendered
    }

    /// A rendered view and its photo, as they are compared; none if nothing of them counts.
    fn pair(self, image: &Image, view: &Photo) -> Result<Option<Compared>, Error> {
        if !counts(view, |x, _| !self.fits_exposure || x >= view.camera.width as usize / 2)? {
            return Ok(None);
        }
        let (photo, weights) = (truth(view, self.background)?, weights(view)?);
        let rendered = self.picture(image, &photo, weights.as_deref());
        let (w, h) = (image.width as usize, image.height as usize);
        if !self.fits_exposure {
            return Ok(Some(Compared { size: [w, h], rendered, photo, weights }));
        }
        let (half, rendered) = right_half(&rendered, w);
        let weights = weights.map(|weights| right_half(&weights, w).1);
        Ok(Some(Compared { size: [half, h], rendered, photo: right_half(&photo, w).1, weights }))
    }

    fn score(self, image: &Image, view: &Photo, networks: &Networks) -> Result<Scores, Error> {
        let Some(compared) = self.pair(image, view)? else { return Ok(Scores::hidden()) };
        let [rendered, photo] = compared.images()?;
        Ok(metrics::evaluate(&rendered, &photo, networks)?)
    }

    fn psnr(self, image: &Image, view: &Photo) -> Result<Option<f64>, Error> {
        let Some(mut compared) = self.pair(image, view)? else { return Ok(None) };
        compared.rendered = metrics::round_trip_8bit(&compared.rendered);
        compared.photo = metrics::round_trip_8bit(&compared.photo);
        let [rendered, photo] = compared.images()?;
        Ok(Some(metrics::psnr(&rendered, &photo)?))
    }
}

impl Evaluator {
    /// An evaluator of models on the device, for views of at most the size of the largest given one.
    pub fn new<'a>(
        device: &Device,
        settings: Settings,
        gaussians: usize,
        views: impl Iterator<Item = &'a Photo>,
    ) -> Result<Self, Error> {
        let painter = Painter::new(device, settings, gaussians, camera::largest(views.map(|v| &v.camera)))?;
        Ok(Self::with(painter, settings))
    }

    fn with(painter: Painter, settings: Settings) -> Self {
        Self { painter, comparison: Comparison { background: settings.background, fits_exposure: false } }
    }

    /// An evaluator of models on the device that has no room for any yet, and grows to what it draws.
    pub fn empty(device: &Device, settings: Settings) -> Result<Self, Error> {
        Ok(Self::with(Painter::new(device, settings, 1, [1, 1])?, settings))
    }

    /// An evaluator of a model wherever it is, for views of at most the size of the largest given one.
    pub fn of<'a>(
        device: &Device,
        settings: Settings,
        model: Source<'_>,
        views: impl Iterator<Item = &'a Photo>,
    ) -> Result<Self, Error> {
        let painter = Painter::of(device, settings, model, camera::largest(views.map(|v| &v.camera)))?;
        Ok(Self::with(painter, settings))
    }

    /// Sets whether photos have exposures of their own and are scored by the protocol of `exposure_fit`.
    pub fn compare_as(&mut self, fits_exposure: bool) {
        self.comparison.fits_exposure = fits_exposure;
    }

    /// Gives the painter's buffers back until the next view.
    pub fn rest(&mut self) -> Result<(), Error> {
        self.painter.renderer().release()?;
        Ok(())
    }

    /// Device memory in bytes of an evaluator for views of at most this size, readback included.
    pub fn bytes(device: &Device, gaussians: usize, size: [u32; 2], style: Style) -> u64 {
        let uses = Uses { style, ..Uses::default() };
        let picture = u64::from(size[0]) * u64::from(size[1]) * 16;
        Renderer::bytes(device, gaussians, size, pair_capacity::estimate(device, gaussians, size), uses)
            + staging_bytes(picture)
    }

    /// Renders a view.
    pub fn render<'m>(&mut self, model: impl Into<Source<'m>>, view: &Photo) -> Result<Image, Error> {
        Ok(self.painter.render(model.into(), &view.camera)?)
    }

    /// Draws views, and hands each with its picture to `judge` on all cores while the next ones are drawn. Answers are in the views'
    /// order, and `follow` receives their number so far.
    fn each<T: Send>(
        &mut self,
        model: Source<'_>,
        views: &[&Photo],
        judge: &(impl Fn(usize, &Image) -> Result<T, Error> + Sync),
        follow: &mut dyn FnMut(usize) -> Result<(), Error>,
    ) -> Result<Vec<T>, Error> {
        let picture = views.iter().map(|view| 16 * view.camera.pixels()).max().unwrap_or(0).max(1);
        let group = ((GROUP_BYTES / picture) as usize).clamp(1, rayon::current_num_threads());
        let painter = &mut self.painter;
        let mut answers = Vec::with_capacity(views.len());
        let mut drawn: Vec<Image> = Vec::new();
        while answers.len() < views.len() {
            let from = answers.len();
            let next = &views[(from + drawn.len()).min(views.len())..];
            let mut judged: Result<Vec<T>, Error> = Ok(Vec::new());
            let ahead: Result<Vec<Image>, _> = rayon::in_place_scope(|scope| {
                scope.spawn(|_| {
                    judged = drawn.par_iter().enumerate().map(|(i, image)| judge(from + i, image)).collect();
                });
                next.iter().take(group).map(|view| painter.render(model, &view.camera)).collect()
            });
            for answer in judged? {
                answers.push(answer);
                follow(answers.len())?;
            }
            drawn = ahead?;
        }
        Ok(answers)
    }

    /// PSNR in dB of each view of which something counts, without pictures or networks.
    pub fn psnr<'a, 'm>(
        &mut self,
        model: impl Into<Source<'m>>,
        views: impl Iterator<Item = &'a Photo>,
    ) -> Result<Vec<f64>, Error> {
        let model = model.into();
        let (views, comparison): (Vec<&Photo>, _) = (views.collect(), self.comparison);
        let each = self.each(model, &views, &|i, image| comparison.psnr(image, views[i]), &mut |_| Ok(()))?;
        Ok(each.into_iter().flatten().collect())
    }

    /// PSNR of each whole view as rendered, without fitted exposures; of none if exposures are not fitted.
    pub fn unfitted_psnr<'a, 'm>(
        &mut self,
        model: impl Into<Source<'m>>,
        views: impl Iterator<Item = &'a Photo>,
    ) -> Result<Vec<f64>, Error> {
        if !self.comparison.fits_exposure {
            return Ok(Vec::new());
        }
        self.comparison.fits_exposure = false;
        let psnr = self.psnr(model, views);
        self.comparison.fits_exposure = true;
        psnr
    }

    /// Renders and scores held-out views, by name; writes their pictures to the folder `renders`, if given. `follow`
    /// receives the number of views done, and may end the work.
    pub fn held_out<'m>(
        &mut self,
        model: impl Into<Source<'m>>,
        test: &[(String, Photo)],
        renders: Option<&Path>,
        networks: &Networks,
        follow: &mut dyn FnMut(usize) -> Result<(), Error>,
    ) -> Result<HeldOut, Error> {
        let model = model.into();
        let names = pictures::names(test.iter().map(|(name, _)| name.as_str()), Format::Png.extension());
        let (views, comparison): (Vec<&Photo>, _) = (test.iter().map(|(_, view)| view).collect(), self.comparison);
        let judge = |i: usize, image: &Image| {
            if let Some(folder) = renders {
                pictures::write(&folder.join(&names[i]), image, Format::Png, false)?;
            }
            let scores = comparison.score(image, views[i], networks)?;
            Ok((ViewScores { name: test[i].0.clone(), scores }, image.pixels.iter().all(|p| p[3] < EMPTY)))
        };
        let judged = self.each(model, &views, &judge, follow)?;
        let empty = judged.iter().filter(|(_, empty)| *empty).count();
        Ok(HeldOut { views: judged.into_iter().map(|(scores, _)| scores).collect(), empty })
    }

    /// Pictures per second at the views' own sizes, rendering alone; none without views.
    pub fn frames_per_second<'m>(
        &mut self,
        model: impl Into<Source<'m>>,
        prepared: &Prepared,
    ) -> Result<Option<f64>, Error> {
        let model = model.into();
        let views: Vec<_> = prepared.views().take(TIMED_FRAMES).collect();
        let Some(first) = views.first() else { return Ok(None) };
        self.render(model, first)?;
        let started = Instant::now();
        for view in &views {
            match model {
                // Without reading the picture back.
                Source::Device(model) => {
                    self.painter.renderer().draw(model, &view.camera)?;
                }
                // Its parts travel to the device for every picture.
                Source::Host(_) => drop(self.render(model, view)?),
            }
        }
        Ok(Some(views.len() as f64 / started.elapsed().as_secs_f64()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::camera::Camera;
    use glam::DVec3;

    /// Errors of 25 levels in turn, of both signs, below a mask that hides the upper rows.
    #[test]
    fn a_score_does_not_depend_on_how_much_a_mask_hides() {
        let (w, h) = (40, 40);
        let camera = Camera::look_at(-DVec3::Z, DVec3::ZERO, DVec3::Y, 1.0, w, h);
        let level = |i: u32| (80 + i * 37 % 90) as u8;
        let image =
            Image { width: w, height: h, pixels: (0..w * h).map(|i| [f32::from(level(i)) / 255.0; 4]).collect() };
        for (hidden, fits_exposure) in [(0, false), (20, false), (36, false), (0, true), (20, true), (36, true)] {
            let photo = (0..w * h).flat_map(|i| {
                let value = if (i / w + i).is_multiple_of(2) { level(i) + 25 } else { level(i) - 25 };
                [value, value, value, if i < hidden * w { 0 } else { 255 }]
            });
            let pixels = photo.collect::<Vec<u8>>();
            let view = Photo { alpha_role: AlphaRole::Mask, ..Photo::opaque(camera.clone(), pixels) };
            let comparison = Comparison { background: [0.9, 0.9, 0.9], fits_exposure };
            let scores = comparison.score(&image, &view, &Networks::default()).unwrap();
            let psnr = comparison.psnr(&image, &view).unwrap().unwrap();
            assert!((psnr - 20.17).abs() < 0.8, "{hidden} rows hidden: {psnr}");
            assert_eq!(scores.psnr, Some(psnr));
        }
    }
}
