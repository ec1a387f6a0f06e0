//! Search for the tuning that trains fastest on a device: all variants in turns, on a built-in scene.

use crate::gaussians::Gaussians;
use crate::gpu::{Device, DeviceKind, Tuning, Variant, variants};
use crate::job::Error;
use crate::random::Random;
use crate::scene::Photo;
use crate::scene::camera::Camera;
use crate::train::schedule::Schedule;
use crate::train::{Options, Trainer};
use glam::DVec3;
use std::cmp::Ordering;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// Another tuning must be faster than the class's row by this share to be chosen: noise is of that order.
const WORTH: f64 = 0.03;
/// Share of rounds in which it must be faster.
const OFTEN: f64 = 0.75;
/// Tunings that are measured once more, the class's row among them.
const FINALISTS: usize = 4;
/// Rounds in which all variants take turns, at most.
const ROUNDS: usize = 15;

/// The built-in scene's size, and iterations of a turn.
struct Scale {
    gaussians: usize,
    size: [u32; 2],
    turn: u32,
}

impl Scale {
    fn of(device: &Device) -> Self {
        if device.info().kind == DeviceKind::Cpu {
            Self { gaussians: 10_000, size: [256, 144], turn: 4 }
        } else {
            Self { gaussians: 100_000, size: [1280, 720], turn: 16 }
        }
    }
}

/// A tuning that was measured.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Tried {
    /// Its difference from the class's row.
    pub name: String,
    /// The tuning.
    pub tuning: Tuning,
    /// Median of its times for an iteration, in milliseconds: of the device where it has timestamps, else of the host.
    pub ms: f64,
    /// Median of its times divided by those of the class's row in the same rounds; absent if it was put together afterwards.
    pub ratio: Option<f64>,
    /// `ratio` in a second measurement, which only the fastest get.
    pub again: Option<f64>,
}

/// The measurements.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Tuned {
    /// All tunings, the class's row first.
    pub tried: Vec<Tried>,
    /// Variants for which there was no time.
    pub left: Vec<String>,
    /// Number in `tried` of the one to use: the fastest, or the class's row if none is faster beyond noise.
    pub best: usize,
}

struct Subject {
    variant: Variant,
    trainer: Trainer,
    seconds: Vec<f64>,
    /// Times divided by the first subject's, by round.
    ratios: Vec<f64>,
    /// The same in the rounds of the fastest.
    again: Vec<f64>,
}

impl Subject {
    /// A trainer under a variant, its kernels made.
    fn new(device: &Device, variant: Variant, scale: &Scale) -> Result<Self, Error> {
        let device = device.with_tuning(variant.tuning.clone())?;
        let (model, photo) = scene(scale);
        let schedule = Schedule { half_until: 0.0, ..Schedule::still() };
        let pairs = 8 * scale.gaussians as u32;
        let options = Options { schedule, degree: 3, pairs, ..Options::default() };
        let mut trainer = Trainer::new(&device, &model, vec![photo], 1.0, options)?;
        trainer.run_until(2, |_, _| ControlFlow::Continue(()))?;
        Ok(Self { variant, trainer, seconds: Vec::new(), ratios: Vec::new(), again: Vec::new() })
    }

    /// Seconds of an iteration, by a turn.
    fn turn(&mut self, iterations: u32) -> Result<f64, Error> {
        let (begun, before) = (Instant::now(), self.trainer.timings().total());
        self.trainer.run_until(self.trainer.iteration() + iterations, |_, _| ControlFlow::Continue(()))?;
        let device = self.trainer.timings().total() - before;
        let seconds = if device > 0.0 { device } else { begun.elapsed().as_secs_f64() };
        Ok(seconds / f64::from(iterations))
    }

    fn tuning(&self) -> Tuning {
        self.variant.tuning.clone()
    }

    /// Whether it is faster than the first subject by these ratios, beyond noise.
    fn is_faster(ratios: &[f64]) -> bool {
        let won = ratios.iter().filter(|r| **r < 1.0).count();
        median(ratios).is_some_and(|m| m < 1.0 - WORTH) && won as f64 >= OFTEN * ratios.len() as f64
    }
}

/// A ball of discs and needles, most of them faint, as trained models have them, and a photo that it does not resemble.
fn scene(scale: &Scale) -> (Gaussians, Photo) {
    let (n, degree, mut random) = (scale.gaussians, 3, Random(1));
    let base = (1.5 / (n as f64).sqrt()).ln();
    let mut model = Gaussians { sh: vec![Vec::new(); degree + 1], ..Gaussians::default() };
    for _ in 0..n {
        let direction = DVec3::new(random.within(-1.0, 1.0), random.within(-1.0, 1.0), random.within(-1.0, 1.0));
        model.means.push((2.0 * direction).as_vec3().to_array());
        model.log_scales.push([0; 3].map(|_| (base + random.within(-2.0, 1.0)) as f32));
        model.rotations.push([0; 4].map(|_| random.within(-1.0, 1.0) as f32));
        model.opacity_logits.push(random.within(-5.0, 3.0) as f32);
        for (l, band) in model.sh.iter_mut().enumerate() {
            band.extend((0..Gaussians::band_width(l)).map(|_| random.within(-0.5, 0.5) as f32));
        }
    }
    let [width, height] = scale.size;
    let camera = Camera::look_at(DVec3::new(0.6, -0.8, -4.6), DVec3::ZERO, DVec3::NEG_Y, 0.9, width, height);
    let pixels: Vec<u8> = (0..width * height).flat_map(|p| [p as u8, (p / width) as u8, 99, 255]).collect();
    (model, Photo::opaque(camera, pixels))
}

fn median(values: &[f64]) -> Option<f64> {
    crate::scene::median(&mut values.to_vec())
}

/// Rounds of turns of some subjects, forth and back, until enough or until the time is over, one at least: their times divided by
/// the first one's, by subject.
fn rounds(subjects: &mut [&mut Subject], turn: u32, until: Instant) -> Result<Vec<Vec<f64>>, Error> {
    let n = subjects.len();
    let mut ratios = vec![Vec::new(); n];
    for round in 0..ROUNDS {
        let mut seconds = vec![0.0; n];
        for k in 0..n {
            let at = if round % 2 == 0 { k } else { n - 1 - k };
            seconds[at] = subjects[at].turn(turn)?;
            subjects[at].seconds.push(seconds[at]);
        }
        ratios.iter_mut().zip(&seconds).for_each(|(ratios, s)| ratios.push(s / seconds[0]));
        if Instant::now() > until {
            break;
        }
    }
    Ok(ratios)
}

/// Measures the variants that fit the device within about this time. `follow` receives what is done.
///
/// Faster variants are joined, and the fastest are measured once more: of many, one is always lucky the first time.
pub fn tune(device: &Device, within: Duration, mut follow: impl FnMut(&str)) -> Result<Tuned, Error> {
    let begun = Instant::now();
    let until = |share: f64| begun + within.mul_f64(share);
    let scale = Scale::of(device);
    let (mut subjects, mut left) = (Vec::new(), Vec::new());
    for variant in variants(device.info()) {
        if subjects.is_empty() || Instant::now() < until(0.5) {
            follow(&format!("making kernels: {}", variant.name));
            subjects.push(Subject::new(device, variant, &scale)?);
        } else {
            left.push(variant.name);
        }
    }
    if subjects.len() == 1 {
        return Ok(Tuned { tried: subjects.iter().map(Tried::of).collect(), left, best: 0 });
    }
    follow(&format!("{} tunings take turns", subjects.len()));
    let ratios = rounds(&mut subjects.iter_mut().collect::<Vec<_>>(), scale.turn, until(0.7))?;
    subjects.iter_mut().zip(ratios).for_each(|(subject, ratios)| subject.ratios = ratios);
    // The class's row stays first; then the faster ones, the fastest first.
    subjects[1..].sort_by(|a, b| median(&a.ratios).partial_cmp(&median(&b.ratios)).unwrap_or(Ordering::Equal));
    let faster: Vec<Tuning> = subjects.iter().filter(|s| Subject::is_faster(&s.ratios)).map(Subject::tuning).collect();
    if !faster.is_empty() {
        let joined = subjects[0].variant.tuning.with_differences(faster.iter());
        if faster.len() > 1 && device.with_tuning(joined.clone()).is_ok() {
            let variant = Variant { name: "all that are faster, together".to_owned(), tuning: joined };
            subjects.insert(1, Subject::new(device, variant, &scale)?);
        }
        let finalists = subjects.len().min(FINALISTS);
        follow(&format!("the fastest {} take turns again", finalists - 1));
        let mut fastest: Vec<&mut Subject> = subjects.iter_mut().take(finalists).collect();
        let again = rounds(&mut fastest, scale.turn, until(1.0))?;
        subjects.iter_mut().zip(again).for_each(|(subject, again)| subject.again = again);
    }
    let won = (1..subjects.len()).filter(|k| Subject::is_faster(&subjects[*k].again));
    let by_time = |a: &usize, b: &usize| {
        median(&subjects[*a].again).partial_cmp(&median(&subjects[*b].again)).unwrap_or(Ordering::Equal)
    };
    let best = won.min_by(by_time).unwrap_or_default();
    Ok(Tuned { tried: subjects.iter().map(Tried::of).collect(), left, best })
}

impl Tried {
    fn of(subject: &Subject) -> Self {
        let Variant { name, tuning } = subject.variant.clone();
        let ms = 1e3 * median(&subject.seconds).unwrap_or(f64::NAN);
        Self { name, tuning, ms, ratio: median(&subject.ratios), again: median(&subject.again) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faster_means_often_and_by_more_than_noise() {
        assert!(Subject::is_faster(&[0.9, 0.92, 0.95, 1.3]));
        assert!(!Subject::is_faster(&[0.9, 0.92, 1.01, 1.3]), "half of the rounds");
        assert!(!Subject::is_faster(&[0.98; 9]), "within noise");
        assert!(!Subject::is_faster(&[]));
    }
}
