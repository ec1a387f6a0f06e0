//! The schedule of a run by iteration: milestones scale with the length of the run, intervals do not.

use super::growth::Growth;
use super::rates::Rates;
use crate::kernels::constants::adam::float64::{BETA1, BETA2};
use serde::{Deserialize, Serialize};

/// Least number of iterations between the steps of a plan: gradients need some views.
const LEAST_EVERY: u32 = 20;

/// The schedule of a run, as written to `config.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Schedule {
    /// Length of the run.
    pub iterations: u32,
    /// Position learning rate at the start, times the scene's extent.
    pub position_rate: f64,
    /// Position learning rate at the end, times the scene's extent; log-linear between.
    pub position_rate_end: f64,
    /// Learning rate of SH band 0.
    pub dc_rate: f64,
    /// Learning rate of the higher SH bands.
    pub rest_rate: f64,
    /// Learning rate of opacity logits.
    pub opacity_rate: f64,
    /// Learning rate of log scales.
    pub scale_rate: f64,
    /// Learning rate of quaternions.
    pub rotation_rate: f64,
    /// Exponent applied to the reference's decays of Adam's moments, 0.9 and 0.999: 1, or more if one iteration stands
    /// for several.
    pub forgetting: f64,
    /// Density control begins after this share of the run.
    pub densify_from: f64,
    /// Density control ends after this share of the run.
    pub densify_until: f64,
    /// Iterations between density steps.
    pub densify_every: u32,
    /// Mean gradient by the 2D mean, in NDC units, from which a Gaussian grows, if growth has no plan.
    pub densify_gradient: f64,
    /// Growing Gaussians whose largest axis exceeds this share of the reach are split, others are cloned. The reach is the
    /// scene's extent, or the Gaussian's distance from the cameras' mean if that is greater.
    pub clone_scale: f64,
    /// Opacity below which a Gaussian is pruned.
    pub prune_opacity: f64,
    /// Gaussians whose largest axis exceeds this share of the reach are pruned, after `prune_scale_from`, if growth has no plan.
    pub prune_scale: f64,
    /// Share of the run after which large Gaussians are pruned.
    pub prune_scale_from: f64,
    /// Iterations between opacity resets.
    pub opacity_reset_every: u32,
    /// Share of the run between steps of the SH degree.
    pub degree_every: f64,
    /// Share of the run that uses pictures of half their size.
    pub half_until: f64,
    /// Share of the run after which up to 20 iterates, evenly spaced, are averaged for the result; with 1, the result
    /// is the last iterate.
    pub mean_from: f64,
    /// Growth to a planned number; without it, all Gaussians grow whose gradient reaches the threshold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub growth: Option<Growth>,
}

impl Default for Schedule {
    fn default() -> Self {
        // The 3DGS reference's values; see docs/decisions.md where they differ.
        Self {
            iterations: 30_000,
            position_rate: 1.6e-4,
            position_rate_end: 1.6e-6,
            dc_rate: 2.5e-3,
            rest_rate: 1.25e-4,
            opacity_rate: 0.05,
            scale_rate: 5e-3,
            rotation_rate: 1e-3,
            forgetting: 1.0,
            densify_from: 1.0 / 60.0,
            densify_until: 0.5,
            densify_every: 100,
            densify_gradient: 2e-4,
            clone_scale: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            prune_scale_from: 0.1,
            opacity_reset_every: 3000,
            degree_every: 1.0 / 30.0,
            half_until: 0.0,
            mean_from: 1.0,
            growth: None,
        }
    }
}

/// Share of a run after which iterates are averaged, except in the reference's schedule (docs/decisions.md).
pub const MEAN_FROM: f64 = 0.95;

/// Length of the run that the reference's rates are meant for.
const REFERENCE: f64 = 30_000.0;

impl Schedule {
    /// A schedule on which the model hardly moves, so that every iteration does the same work: for measurements.
    pub fn still() -> Self {
        let (never, still) = (u32::MAX, 1e-30);
        Self {
            iterations: never,
            position_rate: still,
            position_rate_end: still,
            dc_rate: still,
            rest_rate: still,
            opacity_rate: still,
            scale_rate: still,
            rotation_rate: still,
            densify_every: never,
            opacity_reset_every: never,
            ..Self::default()
        }
    }

    /// The reference's schedule scaled to `iterations`, the first part at a quarter of the pixels. Shorter runs have
    /// higher rates for positions, shapes and higher SH bands: with the published ones these do not converge in so few
    /// steps.
    pub fn of(iterations: u32) -> Self {
        let shorter = (REFERENCE / f64::from(iterations.max(1))).max(1.0);
        let whole = Self::default();
        Self {
            iterations,
            position_rate: whole.position_rate * shorter.powf(0.4),
            position_rate_end: whole.position_rate_end * shorter.powf(0.7),
            rest_rate: whole.rest_rate * shorter.powf(0.4),
            scale_rate: whole.scale_rate * shorter.powf(0.25),
            rotation_rate: whole.rotation_rate * shorter.powf(0.4),
            half_until: 0.2,
            mean_from: MEAN_FROM,
            ..whole
        }
    }

    fn at(&self, share: f64) -> u32 {
        (f64::from(self.iterations) * share).round() as u32
    }

    /// Position learning rate after a share of the run, times the scene's extent.
    pub fn position_rate_at(&self, share: f64) -> f64 {
        (self.position_rate.ln() * (1.0 - share) + self.position_rate_end.ln() * share).exp()
    }

    /// Learning rates of iteration `iteration` (the first is 1) in a scene of this extent.
    pub fn rates(&self, iteration: u32, extent: f64) -> Rates {
        let t = f64::from(iteration) / f64::from(self.iterations.max(1));
        let (dc, rest) = (self.dc_rate as f32, self.rest_rate as f32);
        Rates {
            means: (self.position_rate_at(t) * extent) as f32,
            log_scales: self.scale_rate as f32,
            rotations: self.rotation_rate as f32,
            opacity_logits: self.opacity_rate as f32,
            sh: [dc, rest, rest, rest],
        }
    }

    /// The schedule for a block that `views` of a scene's `all` views show. One of its iterations stands for several of
    /// the whole schedule's: it has fewer of them, in all and between density steps and opacity resets. Learning rates
    /// are multiplied by the square root of the views' ratio, and decays of Adam's moments are raised to the power of
    /// it: Adam divides by the root of the mean square of gradients, to which views that do not show a Gaussian add
    /// zeros; a block leaves most of those views out, so its steps would be shorter, and its moments would reach back
    /// over more views (docs/decisions.md).
    #[must_use]
    pub fn for_block(self, views: usize, all: usize) -> Self {
        let ratio = all.max(1) as f64 / views.max(1) as f64;
        let factor = Self::longer_steps(views, all);
        let fewer = |n: u32| (f64::from(n) * views as f64 / all.max(1) as f64).round().max(1.0) as u32;
        Self {
            iterations: fewer(self.iterations),
            densify_every: fewer(self.densify_every),
            opacity_reset_every: fewer(self.opacity_reset_every),
            forgetting: ratio * self.forgetting,
            position_rate: factor * self.position_rate,
            position_rate_end: factor * self.position_rate_end,
            dc_rate: factor * self.dc_rate,
            rest_rate: factor * self.rest_rate,
            opacity_rate: factor * self.opacity_rate,
            scale_rate: factor * self.scale_rate,
            rotation_rate: factor * self.rotation_rate,
            ..self
        }
    }

    /// Factor of the learning rates in [`Schedule::for_block`].
    pub fn longer_steps(views: usize, all: usize) -> f64 {
        (all.max(1) as f64 / views.max(1) as f64).sqrt()
    }

    /// Decays of Adam's first and second moments.
    pub fn decays(&self) -> [f64; 2] {
        [BETA1, BETA2].map(|decay| decay.powf(self.forgetting))
    }

    /// Returns true if iteration `iteration` uses pictures of half their size.
    pub fn halves(&self, iteration: u32) -> bool {
        iteration <= self.at(self.half_until)
    }

    /// SH degree that iteration `iteration` uses, given the highest allowed.
    pub fn degree(&self, iteration: u32, highest: usize) -> usize {
        let every = self.at(self.degree_every).max(1);
        ((iteration / every) as usize).min(highest)
    }

    /// Returns true if gradients are gathered for density control.
    pub fn gathers(&self, iteration: u32) -> bool {
        iteration <= self.at(self.densify_until)
    }

    /// Iterations between which density control acts.
    pub fn growing(&self) -> (u32, u32) {
        (self.at(self.densify_from), self.at(self.densify_until))
    }

    /// Returns true if density control acts after iteration `iteration`.
    pub fn densifies(&self, iteration: u32) -> bool {
        iteration > self.at(self.densify_from)
            && iteration < self.at(self.densify_until)
            && iteration.is_multiple_of(self.interval())
    }

    /// Iterations between density steps.
    pub fn interval(&self) -> u32 {
        let Some(plan) = self.growth else { return self.densify_every };
        let (from, until) = self.growing();
        (until.saturating_sub(from) / (plan.steps + 1).max(1)).clamp(LEAST_EVERY, self.densify_every.max(LEAST_EVERY))
    }

    /// The number of Gaussians planned after iteration `iteration`: proportional to the square root of growth's elapsed
    /// share, so that most come early and have time to learn. 0 without a plan that has a number.
    pub fn planned(&self, iteration: u32) -> usize {
        let (from, until) = self.growing();
        // The last step is one interval before the end.
        let passed = (iteration + self.interval()).saturating_sub(from);
        let share = f64::from(passed) / f64::from(until.saturating_sub(from).max(1));
        (self.growth.and_then(|plan| plan.gaussians).unwrap_or(0) as f64 * share.min(1.0).sqrt()) as usize
    }

    /// Returns true if large Gaussians are pruned at iteration `iteration`. A plan splits them instead: its many steps
    /// would remove backgrounds again and again.
    pub fn prunes_large(&self, iteration: u32) -> bool {
        self.growth.is_none() && iteration > self.at(self.prune_scale_from)
    }

    /// Returns true if opacities are reset after iteration `iteration`.
    pub fn resets_opacity(&self, iteration: u32) -> bool {
        iteration.is_multiple_of(self.opacity_reset_every) && iteration < self.at(self.densify_until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(iterations: u32) -> Schedule {
        Schedule { iterations, ..Schedule::default() }
    }

    fn when(schedule: &Schedule, what: impl Fn(&Schedule, u32) -> bool) -> Vec<u32> {
        (1..=schedule.iterations).filter(|i| what(schedule, *i)).collect()
    }

    fn planned(iterations: u32, steps: u32) -> Schedule {
        let plan = Growth { gaussians: Some(10_000), steps, ..Growth::default() };
        Schedule { growth: Some(plan), ..of(iterations) }
    }

    /// Short runs have as many steps as asked for, if each can follow twenty views; long ones keep their interval.
    #[test]
    fn steps_of_short_runs() {
        let steps = |iterations: u32, steps: u32| when(&planned(iterations, steps), Schedule::densifies).len();
        let [some, more] = [1000, 2000].map(|iterations| steps(iterations, 15));
        assert!((15..=18).contains(&some) && (15..=18).contains(&more), "{some} {more}");
        assert_eq!((steps(30_000, 15), steps(200, 15)), (144, 4));
        assert!(steps(1000, 0) >= 4);
    }

    /// The plan rises with the square root of growth's elapsed share, and the last step reaches the full number.
    #[test]
    fn the_plan_is_reached_by_the_last_step() {
        for iterations in [1, 60, 1000, 30_000] {
            let s = planned(iterations, 15);
            let numbers: Vec<usize> = when(&s, Schedule::densifies).into_iter().map(|i| s.planned(i)).collect();
            assert!(numbers.is_sorted() && numbers.iter().all(|n| *n <= 10_000), "{numbers:?}");
            assert!(numbers.last().is_none_or(|n| *n == 10_000), "{iterations}: {numbers:?}");
        }
        assert_eq!(planned(30_000, 15).planned(500 + (15_000 - 500) / 4 - 100), 5000);
    }

    #[test]
    fn blocks_take_longer_steps_and_forget_faster() {
        let whole = Schedule::default();
        assert_eq!(whole.decays(), [BETA1, BETA2]);
        let [first, second] = whole.clone().for_block(10, 40).decays();
        assert!((first - BETA1.powi(4)).abs() < 1e-12 && (second - BETA2.powi(4)).abs() < 1e-12);
        assert_eq!(whole.clone().for_block(40, 40), whole);
        let (a, b) = (whole.rates(700, 2.0), whole.clone().for_block(10, 40).rates(175, 2.0));
        let near = |a: f32, b: f32| (b / a - 2.0).abs() < 1e-5;
        assert!(near(a.means, b.means) && near(a.log_scales, b.log_scales) && near(a.rotations, b.rotations));
        assert!(near(a.opacity_logits, b.opacity_logits) && (0..4).all(|l| near(a.sh[l], b.sh[l])));
        let times = |s: Schedule| [s.iterations, s.densify_every, s.opacity_reset_every];
        assert_eq!(times(whole.clone().for_block(10, 40)), [7500, 25, 750]);
        assert_eq!(times(whole.for_block(0, 40)), [1, 1, 1]);
    }

    /// The paper's run: density steps every 100 of 500 < i < 15,000; reset every 3,000 before 15,000; large ones pruned
    /// after 3,000.
    #[test]
    fn the_papers_run() {
        let s = of(30_000);
        let steps = when(&s, Schedule::densifies);
        assert_eq!((steps[0], *steps.last().unwrap(), steps.len()), (600, 14_900, 144));
        assert_eq!(when(&s, Schedule::resets_opacity), [3000, 6000, 9000, 12_000]);
        assert_eq!(when(&s, Schedule::prunes_large)[0], 3001);
        assert_eq!(*when(&s, Schedule::gathers).last().unwrap(), 15_000);
        assert_eq!([1, 999, 1000, 1999, 2000, 3000, 30_000].map(|i| s.degree(i, 3)), [0, 0, 1, 1, 2, 3, 3]);
        assert_eq!(s.degree(30_000, 1), 1);
    }

    /// Short runs take longer steps; runs of the published length or longer take the published steps.
    #[test]
    fn rates_scale_with_the_length() {
        for iterations in [30_000, 60_000] {
            assert_eq!(Schedule { half_until: 0.0, mean_from: 1.0, ..Schedule::of(iterations) }, of(iterations));
        }
        let short = Schedule::of(1000);
        let share = |a: f64, b: f64| (a / b * 10.0).round() / 10.0;
        assert_eq!(share(short.position_rate, 1.6e-4), 3.9);
        assert_eq!(share(short.position_rate_end, 1.6e-6), 10.8);
        assert!(Schedule::of(0).position_rate.is_finite());
    }

    /// Milestones scale with the run; intervals do not.
    #[test]
    fn a_run_of_a_tenth() {
        let s = of(3000);
        let steps = when(&s, Schedule::densifies);
        assert_eq!((steps[0], *steps.last().unwrap(), steps.len()), (100, 1400, 14));
        assert!(when(&s, Schedule::resets_opacity).is_empty(), "3,000 lies behind densification's end");
        assert_eq!(when(&s, Schedule::prunes_large)[0], 301);
        assert_eq!([99, 100, 200, 300, 400].map(|i| s.degree(i, 3)), [0, 1, 2, 3, 3]);
    }

    #[test]
    fn position_rates_are_log_linear() {
        for iterations in [30_000, 1000] {
            let s = of(iterations);
            let at = |share: f64| f64::from(s.rates((f64::from(iterations) * share) as u32, 2.0).means);
            for (share, right) in [(0.0, 3.2e-4), (0.25, 3.2e-4 * 0.01_f64.powf(0.25)), (0.5, 3.2e-5), (1.0, 3.2e-6)] {
                assert!((at(share) / right - 1.0).abs() < 1e-6, "{share}: {}", at(share));
            }
        }
        let (first, last) = (of(1000).rates(1, 1.0), of(1000).rates(1000, 5.0));
        assert_eq!(Rates { means: 0.0, ..first }, Rates { means: 0.0, ..last }, "the others stay");
        assert_eq!((first.log_scales, first.rotations, first.opacity_logits), (5e-3, 1e-3, 0.05));
        assert_eq!(first.sh, [2.5e-3, 1.25e-4, 1.25e-4, 1.25e-4]);
    }

    /// Zeros from a file of settings mean "never", and nothing divides by them.
    #[test]
    fn zeros_do_no_harm() {
        let none = Schedule { densify_every: 0, opacity_reset_every: 0, ..of(100) };
        assert!(when(&none, |s, i| s.densifies(i) || s.resets_opacity(i)).is_empty());
        assert!(of(0).rates(0, 1.0).means.is_finite() && of(1).degree(1, 3) <= 3);
        assert_eq!(Schedule { degree_every: 0.0, ..of(100) }.degree(2, 3), 2);
    }
}
