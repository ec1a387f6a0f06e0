//! The training loop. A whole iteration, from projection to Adam, runs on the device without waiting for the host.
//! Every few iterations the host checks, grows buffers that were too small, and repeats the iterations that did not
//! count.

mod attrition;
mod keep;
mod method;
mod record;

use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{self, Device, Recording, Ticket, Timings};
use crate::random::permutation;
use crate::render::{Settings, TrainingRenderer};
use crate::response::ResidentResponses;
use crate::scene::Photo;
use crate::scene::camera::{self, Camera};
use crate::train::density::{self, Step, densify};
use crate::train::depth_loss::DepthLoss;
use crate::train::device_photos::{DevicePhotos, UNDER_WAY};
use crate::train::error::{Error, Result};
use crate::train::halve::{self, Halve};
use crate::train::host_check::HostCheck;
use crate::train::loss::Loss;
use crate::train::objective::Objective;
use crate::train::options::{Exposures, Options};
use crate::train::poses::Poses;
use crate::train::rates::Rates;
use crate::train::smoothing::Smoothing;
use crate::train::state::TrainState;
use crate::train::training_model::{Array, TrainingModel};
use std::collections::VecDeque;
use std::mem;
use std::ops::ControlFlow;

/// Iterations between two checks by the host.
const LOOK_EVERY: u32 = 16;
/// Largest opacity after a reset.
const RESET_OPACITY: f64 = 0.01;

/// Progress of a run.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Iterations done.
    pub iteration: u32,
    /// Loss of the last iteration that the host checked; NaN before the first check.
    pub loss: f32,
    /// Gaussians.
    pub gaussians: usize,
}

/// A model in training.
pub struct Trainer {
    pub(in crate::train) device: Device,
    pub(in crate::train) options: Options,
    pub(in crate::train) training: TrainingModel,
    /// Averaged responses, while there are any.
    pub(in crate::train) responses: Option<ResidentResponses>,
    pub(in crate::train) iteration: u32,
    /// Events so far.
    pub(in crate::train) state: TrainState,
    /// Rows skipped so far because a gradient was not finite.
    pub(in crate::train) skipped_rows: u64,
    last_loss: f32,
    pub(in crate::train) photos: Vec<Photo>,
    pub(in crate::train) device_photos: DevicePhotos,
    extent: f64,
    cameras: [f32; 3],
    pub(in crate::train) renderer: TrainingRenderer,
    pub(in crate::train) objective: Objective,
    /// Room for a photo at half its size, if the run begins with those.
    half: Option<Halve>,
    /// Keeps Gaussians from becoming too thin; only with anti-aliasing.
    smoothing: Option<Smoothing>,
    /// The photos' depth maps, if pictures are compared with them.
    depth_loss: Option<DepthLoss>,
    /// Corrections of the photos' cameras, if they are learnt.
    pub(in crate::train) poses: Option<Poses>,
    order: (u32, Vec<usize>),
    host_check: HostCheck,
    /// Work between stretches, which runs while the next one is recorded.
    between: VecDeque<Ticket>,
    is_whole: bool,
    timings: Timings,
}

impl Trainer {
    /// A run from its beginning.
    ///
    /// # Panics
    /// If the tail of the options is longer than the model.
    pub fn new(device: &Device, model: &Gaussians, photos: Vec<Photo>, extent: f64, options: Options) -> Result<Self> {
        let training = TrainingModel::with_tail(device, model, options.tail)?;
        let mut trainer = Self::assemble(device, training, photos, extent, options)?;
        if let Some(poses) = &mut trainer.poses {
            poses.look(model, extent);
        }
        Ok(trainer)
    }

    /// A run on this model, before any iteration.
    pub(in crate::train) fn assemble(
        device: &Device,
        mut training: TrainingModel,
        photos: Vec<Photo>,
        extent: f64,
        mut options: Options,
    ) -> Result<Self> {
        if photos.is_empty() {
            return Err(Error::NoViews);
        }
        let pixels: Vec<u64> = photos.iter().map(|p| p.camera.pixels()).collect();
        let schedule = &mut options.schedule;
        schedule.growth = schedule.growth.map(|plan| plan.for_photos(&pixels, schedule.iterations));
        let size = camera::largest(photos.iter().map(|p| &p.camera));
        if training.arrays.is_empty() {
            for kind in options.method.as_ref().map(|method| method.arrays()).unwrap_or_default() {
                let values = vec![kind.first; training.trained() * kind.width];
                training.arrays.push(Array::with(device, *kind, &values)?);
            }
        }
        let renderer = TrainingRenderer::new(device, options.settings, training.model.len, size, options.pairs)?;
        // Photos first: their staging memory is free again before the loss allocates its pictures.
        let device_photos = DevicePhotos::new(device, &photos)?;
        let objective = Objective::new(device, &photos, size, &options)?;
        let half = options.schedule.halves(1).then(|| Halve::new(device, size)).transpose()?;
        let antialias = options.settings.style.antialias;
        let smoothing = antialias.then(|| Smoothing::new(device, &photos, &options.settings)).transpose()?;
        let poses = options.poses.then(|| Poses::new(device, &photos)).transpose()?;
        let depth_loss = options.depth_loss.then(|| DepthLoss::new(device, &photos)).transpose()?.flatten();
        Ok(Self {
            half,
            depth_loss,
            smoothing,
            poses,
            cameras: options
                .cameras
                .unwrap_or_else(|| camera::mean_centre(photos.iter().map(|p| &p.camera)).as_vec3().to_array()),
            device_photos,
            objective,
            device: device.clone(),
            training,
            responses: None,
            iteration: 0,
            state: TrainState::default(),
            skipped_rows: 0,
            last_loss: f32::NAN,
            photos,
            extent,
            renderer,
            options,
            order: (u32::MAX, Vec::new()),
            host_check: HostCheck::new(device)?,
            between: VecDeque::new(),
            is_whole: true,
            timings: Timings::default(),
        })
    }

    /// Iterations done.
    pub fn iteration(&self) -> u32 {
        self.iteration
    }

    /// Current number of Gaussians.
    pub fn len(&self) -> usize {
        self.training.model.len
    }

    /// Number of trained Gaussians: those before [`Options::tail`].
    pub fn trained(&self) -> usize {
        self.training.trained()
    }

    /// Returns true if no Gaussian is left.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The model in device memory.
    pub fn model(&self) -> &Resident {
        &self.training.model
    }

    /// Device time of each stage so far.
    pub fn timings(&self) -> &Timings {
        &self.timings
    }

    /// Number of rows whose update was skipped because a gradient was not finite.
    pub fn skipped_rows(&self) -> u64 {
        self.skipped_rows
    }

    /// Trains until `until` iterations are done, or until `follow` breaks. `follow` is called after each stretch that
    /// the host checks; a stretch may contain no step if a picture's pairs did not fit.
    pub fn run_until(
        &mut self,
        until: u32,
        mut follow: impl FnMut(&Self, Progress) -> ControlFlow<()>,
    ) -> Result<Progress> {
        while self.iteration < until {
            let progress = self.advance(until)?;
            if follow(self, progress).is_break() {
                break;
            }
        }
        self.catch_up()?;
        Ok(self.progress())
    }

    /// One stretch of [`Trainer::run_until`]: trains until `until` iterations are done, or until the host's next check
    /// if that comes first.
    ///
    /// # Errors
    /// Device memory; device errors; photos that cannot be read. Some steps of the stretch may have changed the model by
    /// then: training continues from a snapshot, not from here. See [`Trainer::is_whole`].
    pub fn advance(&mut self, until: u32) -> Result<Progress> {
        let first = self.iteration;
        if until <= first {
            // Density control has already acted after this iteration, and must not act twice.
            return Ok(self.progress());
        }
        self.is_whole = false;
        self.raise_degree(first + 1)?;
        let averages = self.options.averaged.contains(&(first + 1));
        if averages {
            self.renderer.make_room_for_responses()?;
        }
        if averages && self.responses.is_none() {
            self.responses = Some(ResidentResponses::zeros(&self.device, self.training.model.len)?);
        }
        let last = self.boundary(until);
        let mut flight = mem::take(&mut self.between);
        for iteration in first + 1..=last {
            while flight.len() >= UNDER_WAY
                && let Some(ticket) = flight.pop_front()
            {
                self.timings.merge(&ticket.wait()?);
            }
            let mut recording = Recording::new();
            if iteration == first + 1 {
                HostCheck::begin(&mut recording, &self.renderer);
            }
            self.record(&mut recording, iteration, iteration == last)?;
            if iteration < last {
                flight.push_back(self.device.submit(recording)?);
            } else {
                self.host_check.submit(&self.device, recording, &self.renderer, &self.objective.loss)?;
            }
        }
        for ticket in flight {
            self.timings.merge(&ticket.wait()?);
        }
        let seen = self.host_check.wait()?;
        self.timings.merge(&seen.timings);

        self.skipped_rows += u64::from(seen.counts.skipped_rows);
        // Without Gaussians no kernel runs to count passes.
        self.iteration = if self.training.model.len == 0 { last } else { first + seen.counts.passes };
        self.is_whole = self.iteration < last;
        if self.renderer.make_room_for_pairs(seen.pairs)? {
            tracing::debug!("{} pairs did not fit: iterations from {} are repeated", seen.pairs, self.iteration + 1);
        }
        if self.iteration == last {
            let view = self.view_of(last);
            let halved = self.halved(view, last);
            let Camera { width, height, .. } = *halved.as_ref().unwrap_or(&self.photos[view].camera);
            self.last_loss = Loss::value_of(seen.sums, [width, height], self.objective.weights);
            self.after(last)?;
        }
        self.is_whole = true;
        Ok(self.progress())
    }

    /// True if the state is that after a whole iteration, even where the last [`Trainer::advance`] failed: a snapshot of it is
    /// then sound. A prune that failed does not change it.
    pub fn is_whole(&self) -> bool {
        self.is_whole
    }

    fn progress(&self) -> Progress {
        Progress { iteration: self.iteration, loss: self.last_loss, gaussians: self.training.model.len }
    }

    /// Learning rates of the last iteration.
    pub fn rates(&self) -> Rates {
        self.state.step(&self.options.schedule, self.iteration, self.extent).rates
    }

    /// The photos trained on, with their cameras as corrected so far.
    pub fn photos(&self) -> &[Photo] {
        &self.photos
    }

    /// How far each photo's camera was moved, in pixels; none if cameras are not corrected.
    pub fn moved_cameras(&self) -> Option<Vec<f64>> {
        self.poses.as_ref().map(Poses::moved)
    }

    /// The settings that pictures of the model are drawn with.
    pub fn settings(&self) -> &Settings {
        &self.options.settings
    }

    /// The current model, on the host.
    pub fn download(&self) -> Result<Gaussians> {
        Ok(self.training.model.download(&self.device)?)
    }

    /// The last iteration that may run before the host must check.
    fn boundary(&self, until: u32) -> u32 {
        let schedule = &self.options.schedule;
        let grows = |i: u32| self.densifies(i) || self.resets_opacity(i) || self.wants_degree(i + 1);
        let method = |i: u32| self.method().is_some_and(|m| m.acts(schedule, i));
        let fades = |i: u32| method(i) || self.attrition().is_some_and(|a| a.acts(i));
        let acts = |i: u32| {
            grows(i)
                || self.moves_cameras(i)
                || self.centres_exposures(i)
                || fades(i)
                || schedule.averages_iterates(i)
                || self.smoothing_after(i).is_some()
        };
        let averages = |i: u32| self.options.averaged.start == i + 1 && !self.options.averaged.is_empty();
        (self.iteration + 1..=until.min(self.iteration + LOOK_EVERY))
            .find(|i| acts(*i) || averages(*i))
            .unwrap_or_else(|| until.min(self.iteration + LOOK_EVERY))
    }

    /// Returns true if a round of photos ends with iteration `iteration`, and their cameras are corrected.
    fn moves_cameras(&self, iteration: u32) -> bool {
        let gathered = Poses::gathers(iteration, self.options.schedule.iterations);
        self.poses.is_some() && gathered && iteration.is_multiple_of(self.photos.len() as u32)
    }

    /// Returns true if rounds of photos end with iteration `iteration`, and their exposures, which began without measured gains, may have
    /// drifted together. Each time the host waits for the device: a few photos have several rounds between.
    fn centres_exposures(&self, iteration: u32) -> bool {
        let gains = self.options.exposure.as_ref().and_then(Exposures::learnt);
        let photos = self.photos.len() as u32;
        gains.is_some_and(<[_]>::is_empty) && iteration.is_multiple_of(photos * LOOK_EVERY.div_ceil(photos))
    }

    fn wants_degree(&self, iteration: u32) -> bool {
        self.options.schedule.degree(iteration, self.options.degree.min(MAX_SH_DEGREE)) > self.training.model.degree
    }

    /// Allocates the arrays of an SH band when the run first uses it.
    fn raise_degree(&mut self, iteration: u32) -> Result<()> {
        while self.wants_degree(iteration) {
            self.between.push_back(self.training.raise_degree(&self.device)?);
        }
        Ok(())
    }

    /// Draws photos without replacement, shuffled again after each round.
    fn view_of(&mut self, iteration: u32) -> usize {
        let n = self.photos.len() as u32;
        let (round, at) = ((iteration - 1) / n, (iteration - 1) % n);
        if self.order.0 != round {
            self.order = (round, permutation(n as usize, &[u64::from(self.options.seed), u64::from(round)]));
        }
        self.order.1[at as usize]
    }

    /// The camera of a view at half its size, if iteration `iteration` uses that.
    fn halved(&self, view: usize, iteration: u32) -> Option<Camera> {
        self.options.schedule.halves(iteration).then(|| halve::camera(&self.photos[view].camera)).flatten()
    }

    /// The smoothing after iteration `iteration`, if it is due.
    fn smoothing_after(&self, iteration: u32) -> Option<&Smoothing> {
        self.smoothing.as_ref().filter(|_| Smoothing::due(iteration, self.options.schedule.iterations))
    }

    /// Runs density control, opacity reset, a method's own work, attrition, the mean of iterates and smoothing, if they
    /// are due after this iteration.
    fn after(&mut self, iteration: u32) -> Result<()> {
        let moves = self.moves_cameras(iteration);
        if self.densifies(iteration) {
            let (schedule, seed, most) = (self.options.schedule.clone(), self.options.seed, self.options.most);
            let step = Step { iteration, seed, extent: self.extent, cameras: self.cameras, most };
            self.reshaped(|device, model| densify(device, model, &schedule, step))?;
        }
        if self.resets_opacity(iteration) {
            let mut recording = Recording::new();
            density::reset_opacity(&mut recording, &self.training, RESET_OPACITY);
            self.between.push_back(self.device.submit(recording)?);
            self.training.mean = None;
        }
        if let Some(poses) = self.poses.as_mut().filter(|_| moves) {
            let length = self.options.schedule.iterations;
            self.between.push_back(poses.step(&self.device, &mut self.photos, (iteration, length))?);
        }
        if let Some(exposure) = self.objective.exposure.as_ref().filter(|_| self.centres_exposures(iteration)) {
            self.between.push_back(exposure.centre(&self.device)?);
        }
        self.follow_method(iteration)?;
        self.attrite(iteration)?;
        self.average(iteration)?;
        if let Some(smoothing) = self.smoothing_after(iteration) {
            let mut recording = Recording::new();
            smoothing.record(&mut recording, &self.training.model, self.training.count());
            self.between.push_back(self.device.submit(recording)?);
        }
        if iteration >= self.options.schedule.iterations {
            self.catch_up()?;
        }
        Ok(())
    }

    /// Waits for the work between stretches.
    fn catch_up(&mut self) -> gpu::Result<()> {
        while let Some(ticket) = self.between.pop_front() {
            self.timings.merge(&ticket.wait()?);
        }
        Ok(())
    }
}
