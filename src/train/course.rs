//! What happens in a run that its schedule cannot know in advance: attrition, and re-warming after the last prune.

use super::adam::{Rates, Step};
use super::attrition::{Attrition, Contest};
use super::density::compact;
use super::error::Result;
use super::learnt_masks::MasksCut;
use super::schedule::Schedule;
use super::trainer::Trainer;
use crate::gpu::Buffer;
use serde::{Deserialize, Serialize};

/// Re-warmed, the positions' rate is as after this share of a run.
const REWOUND: f64 = 1.0 / 6.0;
/// For this share of the run after it, scales and rotations take steps ...
const WARM: f64 = 0.1;
/// ... so many times longer.
const LONGER: f32 = 2.0;

/// Events of a run so far, as stored in its checkpoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Course {
    /// Attrition, under way or over.
    pub attrition: Option<Contest>,
    /// Iterations done when rates were re-warmed.
    pub rewarmed: Option<u32>,
    /// The cut at the end of learnt masks, if there were any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masks: Option<MasksCut>,
}

impl Course {
    /// The step of Adam in iteration `iteration` (the first is 1) in a scene of this extent.
    pub fn step(&self, schedule: &Schedule, iteration: u32, extent: f64) -> Step {
        let mut rates = schedule.rates(iteration, extent);
        if let Some(since) = self.rewarmed {
            self::rewarm(&mut rates, schedule, [since, iteration], extent);
        }
        if let Some(rate) = self.attrition.and_then(|a| a.opacity_rate(iteration)) {
            rates.opacity_logits = rate as f32;
        }
        let pressure = self.attrition.and_then(|a| a.pressure(iteration));
        Step { pressure, decays: schedule.decays(), ..Step::new(iteration, rates) }
    }

    /// The attrition that is under way.
    pub fn contest(&self) -> Option<&Contest> {
        self.attrition.as_ref().filter(|a| a.ended.is_none())
    }
}

fn rewarm(rates: &mut Rates, schedule: &Schedule, [since, iteration]: [u32; 2], extent: f64) {
    let length = schedule.iterations;
    let share = f64::from(iteration - since) / f64::from((length - since).max(1));
    rates.means = (schedule.position_rate_at(REWOUND + (1.0 - REWOUND) * share) * extent) as f32;
    if f64::from(iteration - since) <= WARM * f64::from(length) {
        rates.log_scales *= LONGER;
        rates.rotations *= LONGER;
    }
}

impl Trainer {
    /// Begins attrition, which is to leave `survivors` Gaussians.
    ///
    /// # Errors
    /// Device errors.
    pub fn begin_attrition(&mut self, settings: Attrition, survivors: usize) -> Result<()> {
        let logits = self.trained_logits()?;
        let moments = self.trainee.moments.opacity_logits.read(&self.device)?;
        let times = [self.iteration, self.options.schedule.iterations];
        let [_, decay] = self.options.schedule.decays();
        self.course.attrition = Some(Contest::new(settings, survivors, times, &logits, (&moments, decay)));
        Ok(())
    }

    /// Opacity logits of the Gaussians that are trained.
    fn trained_logits(&self) -> Result<Vec<f32>> {
        let mut logits = self.trainee.model.parameters.opacity_logits.read(&self.device)?;
        logits.truncate(self.trainee.trained());
        Ok(logits)
    }

    /// The attrition that is under way.
    pub fn attrition(&self) -> Option<&Contest> {
        self.course.contest()
    }

    /// Ends attrition: pressure stops, and opacities' learning rate falls back soon.
    pub fn end_attrition(&mut self) {
        if let Some(contest) = &mut self.course.attrition {
            contest.ended.get_or_insert(self.iteration);
        }
    }

    /// Adapts the pressure and removes what has faded.
    pub(super) fn attrite(&mut self, iteration: u32) -> Result<()> {
        let Some(contest) = self.attrition().filter(|a| a.acts(iteration)) else { return Ok(()) };
        let (mut contest, logits) = (*contest, self.trained_logits()?);
        let stay = contest.judge(iteration, &logits);
        tracing::debug!("after iteration {iteration}: {} Gaussians, pressure {:e}", stay.len(), contest.pressure);
        self.course.attrition = Some(contest);
        if stay.len() < logits.len() {
            compact(&self.device, &mut self.trainee, &stay)?;
            self.responses = None;
        }
        Ok(())
    }

    /// Takes longer steps again from here: the positions' rate is rewound and falls to the same end, scales and rotations move
    /// faster for a while, and first moments become 0.
    ///
    /// # Errors
    /// Device errors.
    pub fn rewarm(&mut self) -> Result<()> {
        let device = &self.device;
        let still = |moments: &Buffer<[f32; 2]>| -> Result<Buffer<[f32; 2]>> {
            let mut values = moments.read(device)?;
            for [first, _] in &mut values {
                *first = 0.0;
            }
            Ok(device.upload("moments", &values)?)
        };
        self.trainee.moments = self.trainee.moments.each_ref().try_map(still)?;
        self.course.rewarmed = Some(self.iteration);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Re-warmed after half a run, positions move as after a sixth of it, and reach the same end.
    #[test]
    fn rewarmed_rates() {
        let schedule = Schedule { iterations: 1200, ..Schedule::default() };
        let course = Course { rewarmed: Some(600), ..Course::default() };
        let plain = |i: u32| Course::default().step(&schedule, i, 2.0).rates;
        let warm = |i: u32| course.step(&schedule, i, 2.0).rates;
        let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-4;
        assert!(near(warm(600).means, plain(200).means) && near(warm(1200).means, plain(1200).means));
        assert!(near(warm(900).means, plain(700).means), "log-linear between");
        assert_eq!([601, 720, 721].map(|i| warm(i).log_scales / plain(i).log_scales), [2.0, 2.0, 1.0]);
        assert_eq!([601, 720, 721].map(|i| warm(i).rotations / plain(i).rotations), [2.0, 2.0, 1.0]);
        assert!(warm(700).sh == plain(700).sh && warm(700).opacity_logits == plain(700).opacity_logits);
        assert!(Course { rewarmed: Some(1200), ..course }.step(&schedule, 1200, 2.0).rates.means.is_finite());
    }

    /// Pressure and the logits' rate last as long as attrition does.
    #[test]
    fn steps_under_attrition() {
        let schedule = Schedule { iterations: 1200, ..Schedule::default() };
        let mut contest = Contest::new(Attrition::default(), 1, [600, 1200], &[0.0, 1.0], (&[[0.0, 1e-6]; 2], 0.999));
        let step =
            |contest: Contest, i: u32| Course { attrition: Some(contest), ..Course::default() }.step(&schedule, i, 1.0);
        let under = step(contest, 700);
        assert!(under.pressure.is_some() && (under.number, under.rates.opacity_logits) == (700, 0.1));
        contest.ended = Some(700);
        assert_eq!([701, 741].map(|i| step(contest, i).rates.opacity_logits), [0.1, 0.05]);
        assert_eq!(step(contest, 701).pressure, None);
        assert_eq!(Step::new(5, schedule.rates(5, 1.0)), Course::default().step(&schedule, 5, 1.0));
    }
}
