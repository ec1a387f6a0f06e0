//! Events of a run that its schedule cannot know in advance: attrition, re-warming after the last prune, and the end of a method.

use super::attrition::AttritionState;
use super::method::Cut;
use super::rates::{Rates, Step};
use super::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Share of a run whose position rate re-warming returns to.
const REWOUND: f64 = 1.0 / 6.0;
/// Share of the run for which scales and rotations then take longer steps.
const WARM: f64 = 0.1;
/// Factor of these steps.
const LONGER: f32 = 2.0;

/// Events of a run so far, as stored in its checkpoints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainState {
    /// Attrition, under way or over.
    pub attrition: Option<AttritionState>,
    /// Iterations done when rates were re-warmed.
    pub rewarmed: Option<u32>,
    /// The cut that a method ended with, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut: Option<Cut>,
}

impl TrainState {
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

    /// The attrition in progress.
    pub fn under_way(&self) -> Option<&AttritionState> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::attrition::Attrition;

    /// Re-warmed after half a run, positions move as after a sixth of it, and reach the same final rate.
    #[test]
    fn rewarmed_rates() {
        let schedule = Schedule { iterations: 1200, ..Schedule::default() };
        let state = TrainState { rewarmed: Some(600), ..TrainState::default() };
        let plain = |i: u32| TrainState::default().step(&schedule, i, 2.0).rates;
        let warm = |i: u32| state.step(&schedule, i, 2.0).rates;
        let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-4;
        assert!(near(warm(600).means, plain(200).means) && near(warm(1200).means, plain(1200).means));
        assert!(near(warm(900).means, plain(700).means), "log-linear between");
        assert_eq!([601, 720, 721].map(|i| warm(i).log_scales / plain(i).log_scales), [2.0, 2.0, 1.0]);
        assert_eq!([601, 720, 721].map(|i| warm(i).rotations / plain(i).rotations), [2.0, 2.0, 1.0]);
        assert!(warm(700).sh == plain(700).sh && warm(700).opacity_logits == plain(700).opacity_logits);
        assert!(TrainState { rewarmed: Some(1200), ..state }.step(&schedule, 1200, 2.0).rates.means.is_finite());
    }

    /// Pressure and the logits' rate last as long as attrition does.
    #[test]
    fn steps_under_attrition() {
        let schedule = Schedule { iterations: 1200, ..Schedule::default() };
        let mut attrition =
            AttritionState::new(Attrition::default(), 1, [600, 1200], &[0.0, 1.0], (&[[0.0, 1e-6]; 2], 0.999));
        let step = |attrition: AttritionState, i: u32| {
            TrainState { attrition: Some(attrition), ..TrainState::default() }.step(&schedule, i, 1.0)
        };
        let under = step(attrition, 700);
        assert!(under.pressure.is_some() && (under.number, under.rates.opacity_logits) == (700, 0.1));
        attrition.ended = Some(700);
        assert_eq!([701, 741].map(|i| step(attrition, i).rates.opacity_logits), [0.1, 0.05]);
        assert_eq!(step(attrition, 701).pressure, None);
        assert_eq!(Step::new(5, schedule.rates(5, 1.0)), TrainState::default().step(&schedule, 5, 1.0));
    }
}
