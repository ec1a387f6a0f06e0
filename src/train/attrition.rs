//! Attrition: Gaussians compete for opacity until a given number is left, instead of being cut at once ("natural
//! selection" in GNS). A constant pressure lowers every opacity logit; the loss holds up those that pictures need.
//! Every few iterations the faintest Gaussians are removed, and a controller sets the pressure so that the last of the
//! survivors would fade as time runs out.

use super::rates::Pressure;
use crate::gaussians::opacity;
use crate::scene::median;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Distance, in logits, that the initial pressure moves an opacity which no picture holds up.
const DRIFT: f64 = 10.0;
/// Target of the marginal opacity, as a share of its first value at the start.
const MARGIN: f64 = 0.8;
/// Share of the time after which the target is 0.
const FADED: f64 = 0.875;
/// The pressure changes if the marginal opacity is outside these multiples of its target.
const TOLERATED: RangeInclusive<f64> = 0.9..=1.1;
/// Factors of such a change.
const LESS: f32 = 0.8;
const MORE: f32 = 1.2;
/// Attrition is over once the number of Gaussians is at most this multiple of the survivors.
const NEARLY: f64 = 1.05;
/// Pressure is divided by 1 - opacity, but by no less than this.
const LEAST_THROUGH: f32 = 0.05;
/// Share of the run for which this lower limit holds, and for which the opacities' learning rate stays raised after the
/// end.
const SETTLING: f64 = 1.0 / 30.0;
/// Share of the run between two steps of the controller, and the least number of iterations between them.
const BETWEEN: (f64, u32) = (1.0 / 300.0, 4);

/// Settings of attrition, as written to `config.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Attrition {
    /// Share of the run after which it ends at the latest.
    pub until: f64,
    /// Learning rate of opacity logits during attrition.
    pub opacity_rate: f64,
    /// Opacity below which a Gaussian is removed.
    pub faint: f64,
}

impl Default for Attrition {
    fn default() -> Self {
        Self { until: 0.75, opacity_rate: 0.1, faint: 0.005 }
    }
}

/// The attrition of a run, in progress or over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttritionState {
    /// Its settings.
    pub settings: Attrition,
    /// Gaussians at its start.
    pub before: usize,
    /// Number of Gaussians to keep.
    pub survivors: usize,
    /// Iterations done at its start.
    pub from: u32,
    /// Iterations done at its end, at the latest.
    pub last: u32,
    /// Iterations of the run.
    pub length: u32,
    /// Initial target of the marginal opacity, that of the last survivor.
    pub marginal: f32,
    /// Pressure on opacity logits, in units of the loss per logit.
    pub pressure: f32,
    /// Iterations done at its end, if it is over.
    pub ended: Option<u32>,
}

/// The `count`-th greatest opacity; 0 if there are fewer. NaN counts as 0.
fn greatest(logits: &[f32], count: usize) -> f64 {
    // Opacity rises with its logit.
    let mut logits: Vec<f32> = logits.iter().copied().filter(|l| !l.is_nan()).collect();
    if count == 0 || count > logits.len() {
        return 0.0;
    }
    opacity(*logits.select_nth_unstable_by(count - 1, |a, b| b.total_cmp(a)).1)
}

impl AttritionState {
    /// Begins after iteration `from` of `length`. `logits` are all opacity logits and `moments` their moments; second
    /// moments decay by `decay` per iteration.
    pub fn new(
        settings: Attrition,
        survivors: usize,
        [from, length]: [u32; 2],
        logits: &[f32],
        (moments, decay): (&[[f32; 2]], f64),
    ) -> Self {
        // The rest is cut before the run's end, or never.
        let last = ((f64::from(length) * settings.until).round() as u32).min(length.saturating_sub(1)).max(from);
        let correction = 1.0 - decay.powf(f64::from(from.max(1)));
        // The size of a typical gradient. Adam's steps do not depend on its unit, so without gradients any value will
        // do.
        let mut sizes: Vec<f64> = moments.iter().map(|m| f64::from(m[1])).filter(|v| v.is_normal()).collect();
        let size = median(&mut sizes).map_or(1e-9, |median| (median / correction).sqrt());
        let steps = settings.opacity_rate.max(1e-6) * f64::from((last - from).max(1));
        Self {
            settings,
            before: logits.len(),
            survivors,
            from,
            last,
            length,
            marginal: (MARGIN * greatest(logits, survivors)) as f32,
            pressure: (size * DRIFT / steps) as f32,
            ended: None,
        }
    }

    fn settling(&self) -> u32 {
        (f64::from(self.length) * SETTLING).round() as u32
    }

    /// Returns true if the controller acts after iteration `iteration`.
    pub fn acts(&self, iteration: u32) -> bool {
        let every = ((f64::from(self.length) * BETWEEN.0).round() as u32).max(BETWEEN.1);
        self.ended.is_none() && iteration > self.from && (iteration - self.from).is_multiple_of(every)
    }

    /// Returns true if the rest is to be cut after iteration `iteration`, given this number of Gaussians.
    pub fn over(&self, iteration: u32, gaussians: usize) -> bool {
        iteration >= self.last || gaussians as f64 <= NEARLY * self.survivors as f64
    }

    /// Pressure in iteration `iteration`; `None` once attrition is over.
    pub fn pressure(&self, iteration: u32) -> Option<Pressure> {
        let first = iteration <= self.from + self.settling();
        let least_through = if first { LEAST_THROUGH } else { 1.0 };
        self.ended.is_none().then_some(Pressure { pressure: self.pressure, least_through })
    }

    /// Learning rate of opacity logits in iteration `iteration`, if it differs from the schedule's.
    pub fn opacity_rate(&self, iteration: u32) -> Option<f64> {
        let raised = self.ended.is_none_or(|ended| iteration <= ended + self.settling());
        raised.then_some(self.settings.opacity_rate)
    }

    /// Adapts the pressure after iteration `iteration`, and returns the rows that stay, rising: those that are not
    /// faint, but never fewer than the survivors, unless too few logits are numbers.
    pub fn judge(&mut self, iteration: u32, logits: &[f32]) -> Vec<u32> {
        let passed = f64::from(iteration - self.from) / f64::from((self.last - self.from).max(1));
        let wanted = f64::from(self.marginal) * (1.0 - passed / FADED).max(0.0);
        let marginal = greatest(logits, self.survivors);
        if marginal < TOLERATED.start() * wanted {
            self.pressure *= LESS;
        } else if marginal > TOLERATED.end() * wanted {
            self.pressure *= MORE;
        }
        let mut stay: Vec<u32> = (0..logits.len() as u32).filter(|i| !logits[*i as usize].is_nan()).collect();
        let sound = stay.len();
        stay.retain(|i| opacity(logits[*i as usize]) >= self.settings.faint);
        if stay.len() < self.survivors.min(sound) {
            stay = (0..logits.len() as u32).filter(|i| !logits[*i as usize].is_nan()).collect();
            // Stable: of equal ones the first stay.
            stay.sort_by(|a, b| logits[*b as usize].total_cmp(&logits[*a as usize]));
            stay.truncate(self.survivors);
            stay.sort_unstable();
        }
        stay
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::constants::adam::float64::BETA2;

    /// The logit of an opacity.
    fn logit(opacity: f64) -> f32 {
        (opacity / (1.0 - opacity)).ln() as f32
    }

    fn attrition(survivors: usize, opacities: &[f64], moments: &[[f32; 2]]) -> AttritionState {
        let logits: Vec<f32> = opacities.iter().map(|o| logit(*o)).collect();
        AttritionState::new(Attrition::default(), survivors, [500, 1000], &logits, (moments, BETA2))
    }

    /// The initial pressure moves an opacity by ten logits until the end: Adam's step is the rate times the gradient
    /// over its typical size.
    #[test]
    fn it_begins_with_the_usual_gradient() {
        let moments = [0.0, 4e-6, 1e-6, 9e-6].map(|v| [1.0, v * (1.0 - BETA2.powf(500.0)) as f32]);
        let c = attrition(2, &[0.9, 0.5, 0.2, 0.1], &moments);
        assert_eq!((c.before, c.survivors, c.from, c.last), (4, 2, 500, 750));
        assert!((c.marginal - 0.4).abs() < 1e-6);
        let steps = 0.1 * 250.0;
        assert!((f64::from(c.pressure) / (2e-3 * 10.0 / steps) - 1.0).abs() < 1e-5, "{}", c.pressure);
        assert!([500, 550, 501].map(|i| c.pressure(i).unwrap().least_through) == [0.05, 1.0, 0.05]);
        // Without gradients there is still a pressure.
        assert!(attrition(2, &[0.9; 3], &[[0.0; 2]; 3]).pressure > 0.0);
        assert!(attrition(2, &[0.9; 3], &[[0.0, f32::NAN]; 3]).pressure > 0.0);
    }

    #[test]
    fn it_acts_until_the_survivors_are_left_or_the_time_is_over() {
        let mut c = attrition(100, &[0.5; 300], &[]);
        assert_eq!((501..=520).filter(|i| c.acts(*i)).collect::<Vec<_>>(), [504, 508, 512, 516, 520]);
        assert!(!c.acts(500));
        assert_eq!([105, 106].map(|n| c.over(600, n)), [true, false]);
        assert_eq!([749, 750].map(|i| c.over(i, 300)), [false, true]);
        c.ended = Some(600);
        assert!(!c.acts(604) && c.pressure(601).is_none());
        assert_eq!([601, 633, 634].map(|i| c.opacity_rate(i)), [Some(0.1), Some(0.1), None]);
    }

    #[test]
    fn the_pressure_follows_the_marginal_opacity() {
        let mut c = attrition(2, &[0.9, 0.5, 0.2], &[]);
        let begun = c.pressure;
        let after = |c: &mut AttritionState, iteration: u32, marginal: f64| {
            c.judge(iteration, &[0.9, marginal, 0.01].map(logit));
            (f64::from(c.pressure / begun) * 100.0).round()
        };
        // Target: 0.4 at the start, falling to 0 at 500 + 0.875 * 250.
        assert_eq!(after(&mut c, 504, 0.39), 100.0);
        assert_eq!(after(&mut c, 508, 0.5), 120.0, "too slow");
        assert_eq!(after(&mut c, 512, 0.1), 96.0, "too fast");
        assert_eq!(after(&mut c, 740, 0.01), 115.0, "time is short");
    }

    #[test]
    fn the_faint_go_but_never_too_many() {
        let mut c = attrition(2, &[0.5; 5], &[]);
        let stays = |c: &mut AttritionState, logits: &[f32]| c.judge(504, logits);
        assert_eq!(stays(&mut c, &[0.9, 0.004, 0.3, 0.006, 0.0].map(logit)), [0, 2, 3]);
        assert_eq!(stays(&mut c, &[f32::NAN, 1.0, f32::INFINITY, -f32::NAN, f32::NEG_INFINITY]), [1, 2]);
        // All faint: the first of equal ones stay.
        assert_eq!(stays(&mut c, &[-9.0; 5]), [0, 1]);
        assert_eq!(stays(&mut c, &[-9.0, -8.0, f32::NAN, -7.0, -9.0]), [1, 3]);
        assert_eq!(stays(&mut c, &[f32::NAN, -9.0, f32::NAN]), [1], "what is not a number never stays");
        assert_eq!(stays(&mut c, &[]), [0; 0]);
        // More survivors than Gaussians.
        let mut all = attrition(9, &[0.5; 5], &[]);
        assert!(all.marginal == 0.0 && all.over(500, 5));
        assert_eq!(stays(&mut all, &[-9.0; 5]).len(), 5);
    }
}
