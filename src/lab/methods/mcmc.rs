//! Growth by relocation at a fixed count ("3DGS as Markov Chain Monte Carlo", Kheradmand et al. 2024): instead of being
//! removed, a dead Gaussian moves to a live one and shares its place, so that the picture changes little. The fair
//! alternative to pruning a larger model.

use crate::gaussians::opacity;
use crate::gpu::Recording;
use crate::job::config::MethodConfig;
use crate::job::config::ranges::{SHARE, WEIGHT, within};
use crate::kernels::constants::mcmc::{NOISE, REGULARISE};
use crate::kernels::lab::{Mcmc as Kernel, McmcPush as Push, McmcSpec as Spec};
use crate::primitives::WORKGROUP;
use crate::random;
use crate::render::TrainingRenderer;
use crate::train::density::replace;
use crate::train::method::{Changed, Iteration, Method, Pause};
use crate::train::schedule::Schedule;
use crate::train::{Result, TrainingModel};
use serde::{Deserialize, Serialize};

/// Its name in `config.toml`, and the profiler's scope.
pub const NAME: &str = "mcmc";

/// Largest number of Gaussians that share a place: the paper's limit.
const MOST_COPIES: usize = 51;

/// Growth by relocation, as written to `config.toml`; the plan of growth sets the number of Gaussians. The values are
/// the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mcmc {
    /// Share of the run after which Gaussians are no longer relocated.
    pub until: f64,
    /// Opacity at which a Gaussian is dead.
    pub dead: f64,
    /// Factor from the positions' learning rate to the noise.
    pub noise: f64,
    /// Weight of the mean opacity in the loss.
    pub opacity: f64,
    /// Weight of the mean scale in the loss, in world units.
    pub scale: f64,
}

impl Default for Mcmc {
    fn default() -> Self {
        Self { until: 25.0 / 30.0, dead: 0.005, noise: 5e5, opacity: 0.01, scale: 0.01 }
    }
}

/// The opacity of `copies` Gaussians that share the place of one with opacity `opacity`, and the factor of their
/// scales: together they let as much light through, and have the same mass along a ray.
pub fn shared(opacity: f64, copies: usize) -> (f64, f64) {
    let each = 1.0 - (1.0 - opacity).powf(1.0 / copies as f64);
    let mut mass = 0.0;
    for i in 0..copies {
        let mut term = each;
        for k in 0..=i {
            mass += term / ((k + 1) as f64).sqrt();
            term *= -each * (i - k) as f64 / (k + 1) as f64;
        }
    }
    (each, opacity / mass)
}

/// A relocation: the source of every row, and how many rows share it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moves {
    /// By new row: the old row that it takes its parameters from.
    pub sources: Vec<u32>,
    /// By old row: number of new rows that take their parameters from it; 0 for dead Gaussians.
    pub copies: Vec<usize>,
}

impl Mcmc {
    /// Moves dead Gaussians to live ones, and adds others until there are `count`. Probabilities are proportional to
    /// opacities, which are given as logits. Without live Gaussians nothing moves.
    pub fn choose(&self, logits: &[f32], count: usize, key: [u32; 2]) -> Moves {
        let live = |l: f32| !l.is_nan() && opacity(l) > self.dead;
        let mut sources: Vec<u32> = (0..logits.len() as u32).collect();
        let mut copies: Vec<usize> = logits.iter().map(|l| usize::from(live(*l))).collect();
        let mut sums: Vec<f64> = Vec::with_capacity(logits.len());
        for l in logits {
            sums.push(sums.last().unwrap_or(&0.0) + if live(*l) { opacity(*l) } else { 0.0 });
        }
        let whole = sums.last().copied().unwrap_or(0.0);
        if whole <= 0.0 {
            return Moves { sources, copies: vec![1; logits.len()] };
        }
        sources.resize(count.max(logits.len()), u32::MAX);
        for row in 0..sources.len() {
            if copies.get(row).is_some_and(|c| *c > 0) {
                continue;
            }
            let at = random::uniform(&[u64::from(key[0]), u64::from(key[1]), row as u64]) * whole;
            // The first whose sum exceeds it: a live one, since dead ones add nothing.
            let from = sums.partition_point(|sum| *sum <= at).min(logits.len() - 1);
            sources[row] = from as u32;
        }
        sources.iter().enumerate().filter(|(row, from)| *row != **from as usize).for_each(|(_, from)| {
            copies[*from as usize] += 1;
        });
        Moves { sources, copies }
    }
}

impl Mcmc {
    /// Reads the settings from a configuration.
    pub fn read(config: &MethodConfig) -> std::result::Result<Self, String> {
        let read: Self = config.read()?;
        within("method.until", read.until, &(0.0..=1000.0))?;
        within("method.dead", read.dead, &SHARE)?;
        for (field, value) in [("noise", read.noise), ("opacity", read.opacity), ("scale", read.scale)] {
            within(&format!("method.{field}"), value, &WEIGHT)?;
        }
        Ok(read)
    }

    /// Its configuration.
    pub fn config(&self) -> MethodConfig {
        MethodConfig::new(NAME, self)
    }

    /// Records the slopes of opacities and scales into the rows of [`TrainingRenderer::record_backward`], before Adam.
    pub fn regularise(&self, recording: &mut Recording, renderer: &TrainingRenderer, model: &TrainingModel) {
        let n = model.trained().max(1) as f64;
        let push =
            Push { opacity: (self.opacity / n) as f32, scale: (self.scale / (3.0 * n)) as f32, ..Push::default() };
        record(recording, renderer, model, REGULARISE, push);
    }

    /// Records the random steps of faint Gaussians, after Adam. `rate` is the positions' learning rate; `key` the run's
    /// seed and the iteration.
    pub fn noise(
        &self,
        recording: &mut Recording,
        renderer: &TrainingRenderer,
        model: &TrainingModel,
        rate: f32,
        [seed, iteration]: [u32; 2],
    ) {
        let noise = (self.noise * f64::from(rate)) as f32;
        record(recording, renderer, model, NOISE, Push { seed, iteration, noise, ..Push::default() });
    }
}

fn record(recording: &mut Recording, renderer: &TrainingRenderer, training: &TrainingModel, phase: u32, push: Push) {
    let (model, rows) = (&training.model, renderer.gradient_rows());
    let kernel = Kernel {
        pairs: rows.pairs,
        count: &training.count().value,
        logits: &model.parameters.opacity_logits,
        log_scales: &model.parameters.log_scales,
        rotations: &model.quaternions(),
        rows: rows.values,
        means: &model.parameters.means,
        push: Push { pair_limit: rows.limit, ..push },
        spec: Spec { workgroup: WORKGROUP, phase },
    };
    recording.scope(NAME, |r| r.dispatch(&kernel, training.count().groups(WORKGROUP)));
}

impl Method for Mcmc {
    fn name(&self) -> &'static str {
        NAME
    }

    fn replaces_density_control(&self) -> bool {
        true
    }

    fn acts(&self, schedule: &Schedule, iteration: u32) -> bool {
        let (from, _) = schedule.growing();
        let last = (f64::from(schedule.iterations) * self.until).round() as u32;
        let every = schedule.interval();
        iteration > from && iteration < last && iteration.is_multiple_of(every)
    }

    fn before_adam(&self, recording: &mut Recording, now: &Iteration<'_>) {
        self.regularise(recording, now.renderer, now.model);
    }

    fn after_adam(&self, recording: &mut Recording, now: &Iteration<'_>) {
        self.noise(recording, now.renderer, now.model, now.rates.means, now.key);
    }

    /// Moves dead Gaussians, and adds the planned number.
    fn between(&self, pause: &mut Pause<'_>) -> Result<Changed> {
        let Pause { device, model, schedule, key, most } = pause;
        let parameters = &model.model.parameters;
        let (mut logits, mut scales) = (parameters.opacity_logits.read(device)?, parameters.log_scales.read(device)?);
        // The tail stays unchanged.
        logits.truncate(model.trained());
        scales.truncate(3 * logits.len());
        let planned = schedule.planned(key[1]).min(*most);
        let Moves { sources, copies } = self.choose(&logits, planned, *key);
        for (i, copies) in copies.iter().enumerate().filter(|(_, copies)| **copies > 1) {
            let was = opacity(logits[i]);
            let (each, factor) = shared(was.min(1.0 - 1e-6), (*copies).min(MOST_COPIES));
            let each = each.max(self.dead);
            logits[i] = (each / (1.0 - each)).ln() as f32;
            (0..3).for_each(|c| scales[3 * i + c] += factor.ln() as f32);
        }
        let moved: Vec<bool> = (0..sources.len()).map(|row| copies[sources[row] as usize] > 1).collect();
        let from = |row: &u32| *row as usize;
        let logits: Vec<f32> = sources.iter().map(|row| logits[from(row)]).collect();
        let scales: Vec<f32> = sources.iter().flat_map(|row| scales[3 * from(row)..][..3].to_vec()).collect();
        replace(device, model, &sources, &moved)?;
        let parameters = &model.model.parameters;
        parameters.opacity_logits.write(device, &logits)?;
        parameters.log_scales.write(device, &scales)?;
        Ok(Changed { rows: true, cut: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Copies let as much light through as the Gaussian whose place they share, and have its mass along a ray through
    /// the middle.
    #[test]
    fn sharing_keeps_light_and_mass() {
        for opacity in [0.006, 0.1, 0.5, 0.9, 0.999] {
            assert!((shared(opacity, 1).0 - opacity).abs() < 1e-12 && (shared(opacity, 1).1 - 1.0).abs() < 1e-12);
            for copies in [2, 3, 10, 51] {
                let (each, factor) = shared(opacity, copies);
                assert!(((1.0 - each).powi(copies as i32) - (1.0 - opacity)).abs() < 1e-12);
                // The integral over x of 1 - (1 - each exp(-x^2 / 2 factor^2))^copies, by the midpoint rule.
                let mass = |each: f64, factor: f64, copies: i32| -> f64 {
                    let at = |k: i32| f64::from(k) * 1e-3 * factor;
                    (-10_000..10_000)
                        .map(|k| 1.0 - (1.0 - each * (-0.5 * (at(k) / factor).powi(2)).exp()).powi(copies))
                        .sum::<f64>()
                        * 1e-3
                        * factor
                };
                let (one, many) = (mass(opacity, 1.0, 1), mass(each, factor, copies as i32));
                assert!((one - many).abs() < 1e-6 * one, "{opacity} {copies}: {one} {many}");
            }
        }
    }

    #[test]
    fn the_dead_move_to_the_live_by_opacity() {
        let logit = |o: f64| (o / (1.0 - o)).ln() as f32;
        // Dead at 0.001; live ones of 0.1, 0.3 and 0.6; one NaN.
        let logits: Vec<f32> = (0..4000)
            .map(|i| match i % 4 {
                0 => logit(0.001),
                1 => logit(0.1),
                2 => logit(0.3),
                _ => logit(0.6),
            })
            .chain([f32::NAN])
            .collect();
        let moves = Mcmc::default().choose(&logits, 6001, [1, 2]);
        assert_eq!(moves, Mcmc::default().choose(&logits, 6001, [1, 2]));
        assert_ne!(moves, Mcmc::default().choose(&logits, 6001, [1, 3]));
        assert_eq!((moves.sources.len(), moves.copies.iter().sum::<usize>()), (6001, 6001));
        assert!((0..4001).all(|i| (moves.copies[i] == 0) == (i % 4 == 0)));
        assert!(moves.sources.iter().all(|from| from % 4 != 0));
        assert!((0..4000).filter(|i| i % 4 != 0).all(|i| moves.sources[i] == i as u32), "the live stay");
        // 3,001 draws, expected 300, 900, 1,801; five standard deviations.
        let to = |kind: usize| (kind..4000).step_by(4).map(|i| moves.copies[i] - 1).sum::<usize>();
        assert!((218..382).contains(&to(1)) && (774..1026).contains(&to(2)) && (1666..1936).contains(&to(3)));
    }

    #[test]
    fn nothing_to_move() {
        let all_dead = Mcmc::default().choose(&[-20.0, f32::NAN], 9, [1, 2]);
        assert_eq!((all_dead.sources, all_dead.copies), (vec![0, 1], vec![1, 1]));
        assert!(Mcmc::default().choose(&[], 9, [1, 2]).sources.is_empty());
        let full = Mcmc::default().choose(&[1.0; 5], 3, [1, 2]);
        assert_eq!((full.sources, full.copies), (vec![0, 1, 2, 3, 4], vec![1; 5]));
    }

    #[test]
    fn relocation_continues_after_growth() {
        let schedule = Schedule::of(3000);
        let at: Vec<u32> = (1..=3000).filter(|i| Mcmc::default().acts(&schedule, *i)).collect();
        assert_eq!((at[0], *at.last().unwrap(), at.len()), (100, 2400, 24));
    }
}
