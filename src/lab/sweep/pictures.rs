//! The axes of drawing: culling, and the end of blending.

use super::records::AxisRecord;
use super::rung::Rung;
use super::subject::Context;
use super::timing::{Sample, interleaved};
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::render::{Culling, Image, Renderer, STAGES, Settings};
use crate::scene::camera::{self, Camera};
use std::time::Instant;

/// Largest number of (tile, Gaussian) pairs without culling: more take minutes on a CPU device.
const MOST_PAIRS: usize = 1 << 20;
/// Number of views whose pixels are compared if the rung without culling is drawn on a crop.
const CROPS: usize = 2;

/// Distance of pictures from the reference.
#[derive(Clone, Copy, Debug, Default)]
struct Far {
    largest: f64,
    squares: f64,
    values: usize,
    pairs: f64,
}

impl Far {
    fn add(&mut self, image: &Image, truth: &Image) {
        for (a, b) in image.pixels.iter().zip(&truth.pixels) {
            for c in 0..3 {
                let d = f64::from((a[c] - b[c]).abs());
                self.largest = self.largest.max(d);
                self.squares += d * d;
            }
        }
        self.values += 3 * image.pixels.len();
    }

    /// PSNR in dB; `None` for equal pictures.
    fn psnr(&self) -> Option<f64> {
        let mean = self.squares / self.values.max(1) as f64;
        (mean > 0.0).then(|| -10.0 * mean.log10())
    }
}

fn renderer(context: &Context<'_>, way: Settings, cameras: &[Camera]) -> Result<Renderer, Error> {
    let [width, height] = camera::largest(cameras);
    Ok(Renderer::new(context.session.device, way, context.subject.model.len(), width, height)?)
}

/// Each way's distance from the pictures of `truth`. Also returns every way's renderer, grown for its pairs.
fn compare(
    context: &Context<'_>,
    model: &Resident,
    ways: impl Iterator<Item = Settings>,
    truth: Settings,
    cameras: &[Camera],
) -> Result<Vec<(Renderer, Far)>, Error> {
    let mut exact = renderer(context, truth, cameras)?;
    let images: Vec<Image> = cameras.iter().map(|c| exact.render(model, c)).collect::<Result<_, _>>()?;
    drop(exact);
    let mut out = Vec::new();
    for way in ways {
        let mut renderer = renderer(context, way, cameras)?;
        let mut far = Far::default();
        for (camera, truth) in cameras.iter().zip(&images) {
            let (image, _, pairs) = renderer.render_timed(model, camera)?;
            far.add(&image, truth);
            far.pairs += f64::from(pairs) / cameras.len() as f64;
            context.session.watcher.unless_stopped()?;
        }
        out.push((renderer, far));
    }
    Ok(out)
}

fn frame(context: &Context<'_>, renderer: &Renderer, model: &Resident, camera: &Camera) -> Result<Sample, Error> {
    let started = Instant::now();
    let timings = renderer.draw(model, camera)?;
    Ok(Sample::of(context.session.device, &timings, &STAGES, started))
}

/// The centre of a view, at the view's own scale.
fn crop(camera: &Camera, width: u32, height: u32) -> Camera {
    let (width, height) = (width.min(camera.width), height.min(camera.height));
    camera.part([(camera.width - width) / 2, (camera.height - height) / 2], [width, height])
}

pub fn culling(context: &Context<'_>, rungs: &[Rung<Culling>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let subject = context.subject;
    let model = Resident::upload(context.session.device, &subject.model)?;
    let way = |culling| Settings { culling, ..subject.settings };
    let cameras = subject.cameras();
    let first = &cameras[0];
    let tile = renderer(context, way(Culling::Exact), &cameras[..1])?.tile();
    let tiles = |c: &Camera| c.width.div_ceil(tile) as usize * c.height.div_ceil(tile) as usize;
    // A whole number of tiles in the picture's aspect ratio, as many as drawing without culling can afford.
    let affordable = MOST_PAIRS / subject.model.len().max(1);
    let whole = cameras.iter().map(tiles).max().unwrap_or(1) <= affordable;
    let crops: Vec<Camera> = if whole {
        cameras.clone()
    } else {
        let share = (affordable.max(1) as f64 / tiles(first) as f64).sqrt();
        let side = |pixels: u32| ((f64::from(pixels) * share / f64::from(tile)) as u32).max(1) * tile;
        cameras.iter().take(CROPS).map(|c| crop(c, side(c.width), side(c.height))).collect()
    };
    let ways = rungs.iter().map(|r| way(r.value));
    let on_crops = compare(context, &model, ways, way(Culling::Off), &crops)?;
    let mut full: Vec<(Renderer, f64)> = Vec::new();
    for (Rung { name, value }, (cropped, far)) in rungs.iter().zip(on_crops) {
        let mut rung = axis.rung(name);
        rung.accuracy = Some(far.largest);
        rung.exact = *value == Culling::Off;
        axis.rungs.push(rung);
        if whole || *value == Culling::Off {
            full.push((cropped, far.pairs));
            continue;
        }
        let mut renderer = renderer(context, way(*value), &cameras)?;
        let mut pairs = 0.0;
        for camera in &cameras {
            pairs += f64::from(renderer.render_timed(&model, camera)?.2) / cameras.len() as f64;
        }
        full.push((renderer, pairs));
    }
    let area = |c: &[Camera]| c.iter().map(|c| f64::from(c.width) * f64::from(c.height)).sum::<f64>() / c.len() as f64;
    let ratio = area(&cameras) / area(&crops);
    let timed = interleaved(rungs.len(), context.seconds, 2 * cameras.len(), context.session.watcher, |k, round| {
        let renderer = &full[k].0;
        if rungs[k].value == Culling::Off {
            return Ok(frame(context, renderer, &model, &crops[round % crops.len()])?.times(ratio));
        }
        frame(context, renderer, &model, &cameras[round % cameras.len()])
    })?;
    axis.rungs = axis.rungs.into_iter().zip(&timed).map(|(rung, t)| rung.timed(t, 1e3)).collect();
    for ((rung, asked), (_, pairs)) in axis.rungs.iter_mut().zip(rungs).zip(&full) {
        let factor = if asked.value == Culling::Off { ratio } else { 1.0 };
        rung.figures.insert("pairs", pairs * factor);
    }
    if !whole {
        axis.notes.push(format!(
            "Culling nothing would list {:.0} million pairs a frame: pixels are compared in the middle {} x {} of {CROPS} views, and the time \
             of off is that of such a crop times {ratio:.1}, the ratio of the areas.",
            subject.model.len() as f64 * tiles(first) as f64 / 1e6,
            crops[0].width,
            crops[0].height
        ));
    }
    Ok(axis)
}

/// Measures the axis of the transmittance at which blending stops.
pub fn stop(context: &Context<'_>, rungs: &[Rung<f32>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let subject = context.subject;
    let model = Resident::upload(context.session.device, &subject.model)?;
    let way = |stop| Settings { stop, ..subject.settings };
    let cameras = subject.cameras();
    let compared = compare(context, &model, rungs.iter().map(|r| way(r.value)), way(0.0), &cameras)?;
    let timed = interleaved(rungs.len(), context.seconds, 2 * cameras.len(), context.session.watcher, |k, round| {
        frame(context, &compared[k].0, &model, &cameras[round % cameras.len()])
    })?;
    for ((Rung { name, value }, (_, far)), timed) in rungs.iter().zip(&compared).zip(&timed) {
        let mut rung = axis.rung(name).timed(timed, 1e3);
        rung.accuracy = far.psnr();
        rung.figures.insert("largest_error", far.largest);
        rung.figures.insert("pairs", far.pairs);
        // Equal pictures are exact, however they were drawn.
        rung.exact = *value == 0.0 || rung.accuracy.is_none();
        axis.rungs.push(rung);
    }
    Ok(axis)
}
