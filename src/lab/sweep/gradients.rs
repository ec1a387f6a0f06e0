//! The axis of gradient sums: in slot order, with the same bits in every run, or by float atomics, in the threads'
//! order.

use super::records::{AxisRecord, figure};
use super::rung::Rung;
use super::subject::Context;
use super::timing::{Sample, interleaved};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Feature, Recording};
use crate::job::Error;
use crate::pipeline::pair_capacity;
use crate::render::{AtomicSums, Backward, Image, Renderer, TrainingRenderer};
use crate::response::Target;
use crate::scene::camera::{self, Camera};
use crate::scene::{AlphaRole, Photo};
use crate::train::adam;
use crate::train::loss::{self, Loss, Weights};
use crate::train::rates::{Rates, Step};
use crate::train::schedule::Schedule;
use crate::train::{self, STAGES, TrainingModel};
use std::time::Instant;

/// Number of times that each rung's gradients are computed.
const RUNS: usize = 4;
/// Steps of the short trainings whose final pictures are compared.
const STEPS: u32 = 20;

/// Summation of one rung; `sums` is `None` for the ordered sums.
struct Way {
    name: String,
    sums: Option<AtomicSums>,
}

/// One training iteration with the trainer's stages, on the first views of the subject.
struct Bench<'a> {
    context: &'a Context<'a>,
    renderer: TrainingRenderer,
    loss: Loss,
    photos: Vec<Buffer<u32>>,
}

impl<'a> Bench<'a> {
    fn new(context: &'a Context<'a>, model: &Resident) -> Result<Self, Error> {
        let (device, views) = (context.session.device, &context.subject.views);
        let size @ [width, height] = camera::largest(views.iter().map(|v| &v.camera));
        let pairs = pair_capacity::initial(device, model.len);
        let mut renderer = TrainingRenderer::new(device, context.subject.settings, model.len, size, pairs)?;
        let mut photos = Vec::new();
        for (k, view) in views.iter().enumerate() {
            // The subject's own pictures have no error, so each view trains on its neighbour's picture.
            let size = |v: &Photo| (v.camera.width, v.camera.height);
            let next = &views[(k + 1) % views.len()];
            let other = context.own_pictures && size(next) == size(view);
            let bytes = if other { next.pixels.read() } else { view.pixels.read() }.map_err(train::Error::Photos)?;
            photos.push(device.upload("photo", bytemuck::pod_collect_to_vec::<u8, u32>(&bytes).as_slice())?);
            // Grows the buffers for the view's pairs.
            renderer.render(model, &view.camera)?;
        }
        Ok(Self { context, renderer, loss: Loss::new(device, width, height)?, photos })
    }

    /// Records the forward and backward pass of view `v` up to gradient rows.
    fn there_and_back(&self, way: &Way, TrainingModel { model, growth, .. }: &TrainingModel, v: usize) -> Recording {
        let subject = self.context.subject;
        let camera = &subject.views[v].camera;
        let mut recording = Recording::new();
        self.renderer.reset_overflow(&mut recording);
        self.renderer.record(&mut recording, model, camera);
        let (size, settings) = ([camera.width, camera.height], &subject.settings);
        recording.scope(loss::STAGE, |r| {
            let (image, photo) = (self.renderer.image(), &self.photos[v]);
            let (alpha_role, background) = (AlphaRole::of(&subject.views), settings.background);
            self.loss.record(r, image, Target { photo, size, alpha_role, background }, Weights::default());
        });
        let backward = Backward { atomics: way.sums.as_ref(), growth: Some(growth), ..Backward::default() };
        self.renderer.record_backward(&mut recording, model, camera, &self.loss.gradient, backward);
        recording
    }

    /// Runs one iteration on view `v` and returns its time.
    fn step(&self, way: &Way, training: &TrainingModel, v: usize, step: Step) -> Result<Sample, Error> {
        let mut recording = self.there_and_back(way, training, v);
        adam::record(&mut recording, &self.renderer, training, step);
        let started = Instant::now();
        let timings = self.context.session.device.run(recording)?;
        Ok(Sample::of(self.context.session.device, &timings, &STAGES, started))
    }

    /// All gradients from view 0, one attribute after the other.
    fn gradients(&self, way: &Way, training: &TrainingModel) -> Result<Vec<f32>, Error> {
        let mut recording = self.there_and_back(way, training, 0);
        adam::record_gradients(&mut recording, &self.renderer, &training.model, &training.moments);
        self.context.session.device.run(recording)?;
        let moments = training.moments.each_ref().try_map(|moments| moments.read(self.context.session.device))?;
        Ok(moments.into_array().into_iter().flatten().map(|[first, _]| first).collect())
    }

    /// A short training; returns a picture of its result.
    fn trained(&self, way: &Way) -> Result<Image, Error> {
        let (device, subject) = (self.context.session.device, self.context.subject);
        let training = TrainingModel::new(device, &subject.model)?;
        let schedule = Schedule::default();
        for step in 1..=STEPS {
            let v = step as usize % subject.views.len();
            self.step(way, &training, v, Step::new(step, schedule.rates(step, 1.0)))?;
            self.context.session.watcher.unless_stopped()?;
        }
        let camera = &subject.views[0].camera;
        let (n, Camera { width, height, .. }) = (training.model.len, camera);
        let mut renderer = Renderer::new(device, subject.settings, n, *width, *height)?;
        Ok(renderer.render(&training.model, camera)?)
    }
}

/// Largest difference of two lists relative to the largest value of the first, and the number of values that differ.
fn apart(a: &[f32], b: &[f32]) -> (f64, usize) {
    let most = a.iter().fold(0.0_f32, |m, v| m.max(v.abs())).max(f32::MIN_POSITIVE);
    let far = a.iter().zip(b).fold(0.0_f32, |m, (a, b)| m.max((a - b).abs()));
    (f64::from(far) / f64::from(most), a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count())
}

pub fn measure(context: &Context<'_>, rungs: &[Rung<bool>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let (device, subject) = (context.session.device, context.subject);
    let training = TrainingModel::new(device, &subject.model)?;
    let supported = device.info().has(Feature::FloatAtomics);
    let mut ways = Vec::new();
    for Rung { name, value: atomics } in rungs {
        if *atomics && !supported {
            continue;
        }
        let sums = atomics.then(|| AtomicSums::new(device, training.model.len)).transpose()?;
        ways.push(Way { name: name.clone(), sums });
    }
    let bench = Bench::new(context, &training.model)?;
    let ordered = bench.gradients(&Way { name: String::new(), sums: None }, &training)?;
    let still = Step::new(1, Rates::default());
    for way in &ways {
        let first = bench.gradients(way, &training)?;
        let (mut far, mut differing) = (0.0_f64, 0);
        for _ in 1..RUNS {
            let (f, n) = apart(&first, &bench.gradients(way, &training)?);
            (far, differing) = (far.max(f), differing.max(n));
        }
        let (one, other) = (bench.trained(way)?, bench.trained(way)?);
        let (picture, _) = apart(one.pixels.as_flattened(), other.pixels.as_flattened());
        let mut rung = axis.rung(&way.name);
        rung.accuracy = Some(far);
        rung.exact = differing == 0;
        rung.figures.insert("differing_share", differing as f64 / first.len().max(1) as f64);
        rung.figures.insert("against_ordered", apart(&ordered, &first).0);
        rung.figures.insert("picture_after_steps", picture);
        axis.rungs.push(rung);
    }
    let timed =
        interleaved(ways.len(), context.seconds, 2 * subject.views.len(), context.session.watcher, |k, round| {
            bench.step(&ways[k], &training, round % subject.views.len(), still)
        })?;
    axis.rungs = axis.rungs.into_iter().zip(&timed).map(|(rung, t)| rung.timed(t, 1e3)).collect();
    tell(&mut axis, supported);
    Ok(axis)
}

fn tell(axis: &mut AxisRecord, supported: bool) {
    if !supported {
        let why = "This device has no float atomics (VK_EXT_shader_atomic_float): the rung 'atomics' is left out.";
        axis.notes.push(why.to_owned());
    }
    let find = |name: &str| axis.rungs.iter().find(|r| r.name == name);
    if let (Some(ordered), Some(other)) = (find("ordered"), find("atomics"))
        && let (Some(a), Some(b)) = (ordered.time, other.time)
    {
        let of = |key: &str| other.figures.get(key).copied().unwrap_or(f64::NAN);
        let over = 100.0 * (a.median / b.median - 1.0);
        let cost = match over {
            _ if a.overlaps(&b) => format!("cost nothing measurable compared with {}", other.name),
            o if o > 0.0 => format!("make an iteration {o:.0} % longer than {} would", other.name),
            o => {
                format!("cost nothing: {} would make an iteration {:.0} % longer", other.name, -100.0 * o / (100.0 + o))
            }
        };
        axis.notes.push(format!(
            "Bit-identical runs {cost}. With {}, {} % of the gradients differ from one run to the \
             next, by up to {} of the largest; after {STEPS} steps of training two runs' pictures differ by up to {} of the brightest \
             value. Ordered sums differ nowhere.",
            other.name,
            figure(100.0 * of("differing_share")),
            figure(other.accuracy.unwrap_or(f64::NAN)),
            figure(of("picture_after_steps")),
        ));
    }
}
