//! Corrections of the training cameras, learnt with the model: poses from structure from motion are wrong by a pixel
//! now and then, and a model that fits every photo as posed fits the errors.

use super::error::Result;
use super::training_model::TrainingModel;
use crate::gaussians::Gaussians;
use crate::gpu::{Buffer, Device, Groups, Recording, Ticket};
use crate::kernels::constants::poses as shader;
use crate::kernels::train::{Poses as Kernel, PosesPush, PosesSpec};
use crate::primitives::WORKGROUP;
use crate::render::TrainingRenderer;
use crate::scene::camera::{Camera, mean_centre};
use crate::scene::{Photo, median};
use crate::solve;
use glam::{DVec2, DVec3};

/// Numbers of a correction: a turn about the camera's centre (an axis times an angle in radians), and a shift, both of
/// what the camera sees, in world axes and units.
const SIZE: usize = shader::SIZE as usize;
/// Numbers that a checkpoint holds of each photo: the correction, its first and second moments, the gradient so far, and
/// the depth.
pub const STORED: usize = 4 * SIZE + 1;
/// Share of the run after which cameras move: before it the model is too coarse to tell.
const FROM: f64 = 0.05;
/// Way that a correction can go in a run, in pixels, and the longest step.
const REACH: (f64, f64) = (10.0, 0.2);
/// Final step as a share of the first.
const LEFT: f64 = 0.1;
/// Decay of the mean gradient: a photo is drawn a few dozen to a few hundred times, while the model changes.
const DECAY: f32 = 0.8;
/// Pull towards the given pose, in steps for each pixel: keeps what a photo hardly tells where it is.
const PULL: f64 = 2.0;
/// Largest mean gradient that counts, in usual ones: with the pull, no camera goes further than a pixel from its pose.
const STEEPEST: f64 = 2.0;
/// Largest number of workgroups that sum gradients.
const GROUPS: u32 = 64;
/// The profiler's scope.
const SCOPE: &str = "poses";

/// The corrections of all training cameras.
pub struct Poses {
    given: Vec<Camera>,
    corrections: Vec<Correction>,
    /// Distance of the scene from each camera, in world units.
    depths: Vec<f64>,
    /// Photo x 6: the gradients of the round so far.
    gradients: Buffer<f32>,
    partials: Buffer<f32>,
}

/// A camera's correction, with its moments.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Correction {
    motion: [f32; SIZE],
    moments: [[f32; SIZE]; 2],
}

impl Correction {
    /// The turn and the shift.
    fn parts(&self) -> [DVec3; 2] {
        let [a, b, c, x, y, z] = self.motion.map(f64::from);
        [DVec3::new(a, b, c), DVec3::new(x, y, z)]
    }

    /// A camera with the correction.
    fn of(&self, camera: &Camera) -> Camera {
        let [turn, shift] = self.parts();
        camera.moved(turn, shift)
    }

    /// Adds the `number`-th gradient to the moments.
    fn learn(&mut self, gradient: &[f32], number: u32) {
        let [first, second] = &mut self.moments;
        for (k, g) in gradient.iter().enumerate() {
            first[k] = DECAY * first[k] + (1.0 - DECAY) * g;
            second[k] += (g * g - second[k]) / number as f32;
        }
    }

    /// Takes a step of about `rate` pixels against the mean gradient. `units` are the turn and the shift of a pixel,
    /// `usual` the root mean square of all photos' gradients by them so far.
    fn step(&mut self, (number, rate): (u32, f64), units: [f64; 2], usual: [f64; 2]) {
        let left = 1.0 - f64::from(DECAY).powf(f64::from(number));
        for (k, motion) in self.motion.iter_mut().enumerate() {
            let (unit, usual) = (units[k / 3], usual[k / 3]);
            let direction = f64::from(self.moments[0][k]) / left / usual.max(f64::MIN_POSITIVE);
            let pull = PULL * f64::from(*motion) / unit;
            *motion -= (rate * unit * (direction.clamp(-STEEPEST, STEEPEST) + pull)) as f32;
        }
    }
}

/// Places in a picture where corrections are compared, in halves of its width and height from its middle.
const PLACES: [[f64; 2]; 5] = [[0.0, 0.0], [-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]];

/// Motions of the whole world that change no picture but those of views that are not trained on: turn, shift, growth.
const SHARED: usize = 7;

/// The displacement, seen from the world point `at`, by each of the shared motions about `middle`.
fn shared(at: DVec3, middle: DVec3) -> [DVec3; SHARED] {
    let from = at - middle;
    let [x, y, z] = DVec3::AXES;
    [x.cross(from), y.cross(from), z.cross(from), x, y, z, from]
}

/// Takes out of all corrections what they share, by least squares in the pictures: see [`SHARED`].
fn stay(corrections: &mut [Correction], given: &[Camera], depths: &[f64]) {
    let middle = mean_centre(given.iter());
    let mut a = [[0.0; SHARED]; SHARED];
    let mut b = [0.0; SHARED];
    for ((correction, camera), depth) in corrections.iter().zip(given).zip(depths) {
        let ([turn, shift], centre) = (correction.parts(), camera.centre());
        let half = DVec2::new(f64::from(camera.width), f64::from(camera.height)) / 2.0;
        for place in PLACES {
            let [x, y] = (DVec2::from(place) * half / camera.focal).to_array();
            let rows = [DVec3::new(1.0, 0.0, -x), DVec3::new(0.0, 1.0, -y)];
            let rows = rows.map(|row| camera.rotation.transpose() * row / *depth);
            let away = camera.rotation.transpose() * DVec3::new(x, y, 1.0) * *depth;
            let seen = turn.cross(away) + shift;
            let motions = shared(centre + away, middle);
            for row in rows {
                let parts = motions.map(|motion| row.dot(motion));
                for i in 0..SHARED {
                    (0..SHARED).for_each(|j| a[i][j] += parts[i] * parts[j]);
                    b[i] += parts[i] * row.dot(seen);
                }
            }
        }
    }
    // What no picture tells apart stays as it is.
    let trace: f64 = (0..SHARED).map(|i| a[i][i]).sum();
    (0..SHARED).for_each(|i| a[i][i] += 1e-9 * trace + f64::MIN_POSITIVE);
    let found = solve::positive(a, b);
    if !found.iter().all(|v| v.is_finite()) {
        return;
    }
    for (correction, camera) in corrections.iter_mut().zip(given) {
        let motions = shared(camera.centre(), middle);
        let common = motions.iter().zip(found).map(|(motion, amount)| *motion * amount).sum::<DVec3>();
        let parts = [DVec3::new(found[0], found[1], found[2]), common];
        let own = correction.parts().into_iter().zip(parts).flat_map(|(own, common)| (own - common).to_array());
        correction.motion.iter_mut().zip(own).for_each(|(motion, own)| *motion = own as f32);
    }
}

/// Median depth of a model's centres in a camera's picture; `otherwise` if it shows none.
fn depth(model: &Gaussians, camera: &Camera, otherwise: f64) -> f32 {
    let seen = |mean: &[f32; 3]| {
        let mean = DVec3::from(mean.map(f64::from));
        camera.shows(mean).then(|| camera.depth(mean))
    };
    let mut depths: Vec<f64> = model.means.iter().filter_map(seen).collect();
    median(&mut depths).unwrap_or(otherwise) as f32
}

impl Poses {
    /// Bytes of [`Poses::new`].
    pub fn bytes(photos: usize) -> u64 {
        Buffer::<f32>::bytes_of(SIZE * photos) + Buffer::<f32>::bytes_of(SIZE * GROUPS as usize)
    }

    /// Starts without corrections of these photos' cameras.
    pub fn new(device: &Device, photos: &[Photo]) -> Result<Self> {
        Ok(Self {
            given: photos.iter().map(|photo| photo.camera.clone()).collect(),
            corrections: vec![Correction::default(); photos.len()],
            depths: vec![1.0; photos.len()],
            gradients: device.upload("poses' gradients", &vec![0.0; SIZE * photos.len()])?,
            partials: device.buffer("poses' sums", SIZE * GROUPS as usize)?,
        })
    }

    /// Learns from the initial model how far away each camera sees the scene; `extent` is the scene's.
    pub(super) fn look(&mut self, model: &Gaussians, extent: f64) {
        self.depths = self.given.iter().map(|camera| f64::from(depth(model, camera, extent))).collect();
    }

    /// Returns true if iteration `iteration` of `length` gathers gradients.
    pub fn gathers(iteration: u32, length: u32) -> bool {
        f64::from(iteration) > FROM * f64::from(length)
    }

    /// Records the adding of the gradient by the camera of photo `photo`, after [`TrainingRenderer::record_backward`].
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &TrainingRenderer,
        training: &TrainingModel,
        (photo, camera): (usize, &Camera),
    ) {
        let rows = renderer.gradient_rows();
        let groups = (training.trained() as u32).div_ceil(WORKGROUP).clamp(1, GROUPS);
        recording.scope(SCOPE, |r| {
            for (phase, groups_now) in [(shader::PARTS, groups), (shader::TOTAL, 1)] {
                let kernel = Kernel {
                    pairs: rows.pairs,
                    count: &training.count().value,
                    rows: rows.values,
                    means: &training.model.parameters.means,
                    rotations: &training.model.parameters.rotations,
                    partials: &self.partials,
                    gradients: &self.gradients,
                    view: renderer.slots(camera).view,
                    sh1: &training.model.parameters.sh[1],
                    sh2: &training.model.parameters.sh[2],
                    sh3: &training.model.parameters.sh[3],
                    push: PosesPush {
                        centre: camera.centre().as_vec3().to_array(),
                        photo: photo as u32,
                        groups,
                        pair_limit: rows.limit,
                    },
                    spec: PosesSpec { workgroup: WORKGROUP, phase, degree: training.model.degree as u32 },
                };
                r.dispatch(&kernel, Groups::Count(groups_now));
            }
        });
    }

    /// Moves the photos' cameras by the gradients of a round of photos, after iteration `iteration` of `length`.
    /// Returns the work that resets the gradients.
    pub(super) fn step(
        &mut self,
        device: &Device,
        photos: &mut [Photo],
        (iteration, length): (u32, u32),
    ) -> Result<Ticket> {
        let gradients = self.gradients.read(device)?;
        let mut recording = Recording::new();
        recording.fill(&self.gradients, 0);
        let reset = device.submit(recording)?;
        let rounds = |iterations: f64| (iterations / photos.len() as f64).max(1.0);
        let number = rounds(f64::from(iteration) - FROM * f64::from(length)).ceil() as u32;
        let (reach, longest) = REACH;
        let rate = (reach / rounds(f64::from(length))).min(longest)
            * LEFT.powf(f64::from(iteration) / f64::from(length.max(1)));
        let mut squares = [0.0; 2];
        for (correction, gradient) in self.corrections.iter_mut().zip(gradients.chunks_exact(SIZE)) {
            correction.learn(gradient, number);
            correction.moments[1].iter().enumerate().for_each(|(k, square)| squares[k / 3] += f64::from(*square));
        }
        let usual = squares.map(|sum| (sum / (3.0 * photos.len() as f64)).sqrt());
        for ((given, depth), correction) in self.given.iter().zip(&self.depths).zip(&mut self.corrections) {
            let pixel = 1.0 / given.focal.element_product().sqrt();
            correction.step((number, rate), [pixel, pixel * depth], usual);
        }
        stay(&mut self.corrections, &self.given, &self.depths);
        for ((photo, given), correction) in photos.iter_mut().zip(&self.given).zip(&self.corrections) {
            photo.camera = correction.of(given);
        }
        Ok(reset)
    }

    /// The state, [`STORED`] numbers of each photo.
    pub fn stored(&self, device: &Device) -> Result<Vec<f32>> {
        let gradients = self.gradients.read(device)?;
        let all = self.corrections.iter().zip(gradients.chunks_exact(SIZE)).zip(&self.depths);
        let numbers = |((c, gradient), depth): ((&Correction, &[f32]), &f64)| -> Vec<f32> {
            let [first, second] = c.moments;
            [&c.motion[..], &first, &second, gradient, &[*depth as f32]].concat()
        };
        Ok(all.flat_map(numbers).collect())
    }

    /// Continues from a stored state of as many photos.
    pub(super) fn restore(&mut self, device: &Device, photos: &mut [Photo], stored: &[f32]) -> Result<()> {
        let mut gradients = Vec::new();
        let all = photos.iter_mut().zip(&self.given).zip(&mut self.corrections).zip(&mut self.depths);
        for ((((photo, given), correction), depth), numbers) in all.zip(stored.chunks_exact(STORED)) {
            *depth = f64::from(numbers[4 * SIZE]);
            let part = |k: usize| -> [f32; SIZE] { std::array::from_fn(|i| numbers[SIZE * k + i]) };
            *correction = Correction { motion: part(0), moments: [part(1), part(2)] };
            gradients.extend(part(3));
            photo.camera = correction.of(given);
        }
        Ok(self.gradients.write(device, &gradients)?)
    }

    /// How far each camera was moved: the way, in pixels, of what its picture's middle shows.
    pub fn moved(&self) -> Vec<f64> {
        let pixels = |((given, c), depth): ((&Camera, &Correction), &f64)| {
            let ([turn, shift], ahead) = (c.parts(), given.rotation.row(2));
            let seen = turn.cross(ahead) + shift / *depth;
            given.focal.element_product().sqrt() * (seen - ahead * ahead.dot(seen)).length()
        };
        self.given.iter().zip(&self.corrections).zip(&self.depths).map(pixels).collect()
    }
}
