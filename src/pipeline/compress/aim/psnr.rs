//! The smallest file of at least a PSNR.

use super::{MOST, ON_A_RUNG, Search, Trials};
use crate::job::records::Point;

/// Tolerance of the target PSNR, in dB.
const NEAR: f64 = 0.04;

impl<T: Trials> Search<'_, T> {
    pub(super) fn by_psnr(&mut self, wanted: f64) -> Result<Point, T::Error> {
        self.most = 2 * MOST;
        let start = (self.steps.len() - 1).div_ceil(3);
        let mut guess = self.whole as f64 / 3.0;
        let mut best: Option<Point> = None;
        let keep = |best: &mut Option<Point>, point: Option<Point>| {
            let better = point.is_some_and(|p| best.is_none_or(|b| p.bytes < b.bytes));
            if better {
                *best = point;
            }
            better
        };
        // Up as long as that needs fewer bytes, or as coarser rungs cannot reach the PSNR at all; else down.
        for step in start..self.steps.len() {
            let point = self.reach(self.steps[step], wanted, guess)?;
            guess = point.map_or(self.whole as f64, |p| p.gaussians as f64);
            if !keep(&mut best, point) && best.is_some() {
                break;
            }
        }
        if best.is_none_or(|b| b.rung == self.steps[start]) {
            for step in (0..start).rev() {
                let point = self.reach(self.steps[step], wanted, guess)?;
                if !keep(&mut best, point) {
                    break;
                }
            }
        }
        let between = self.whole_at(wanted)?;
        keep(&mut best, between);
        match best {
            Some(best) => Ok(best),
            None => self.scored(self.last(), self.whole),
        }
    }

    /// The file of the whole model that just reaches the target PSNR, if it is known to miss it at one step: by bisection of
    /// the rungs up to the next step.
    fn whole_at(&mut self, wanted: f64) -> Result<Option<Point>, T::Error> {
        let whole = self.whole;
        let below = |p: &&Point| p.gaussians == whole && p.psnr.is_some_and(|psnr| psnr < wanted);
        let Some(mut low) = self.tried.values().filter(below).map(|p| p.rung).max() else { return Ok(None) };
        let Some(mut high) = self.steps.iter().copied().find(|rung| *rung > low) else { return Ok(None) };
        let mut found = None;
        while self.left() > 0 {
            let rung = if found.is_none() { high } else { low.midpoint(high) };
            let point = self.scored(rung, whole)?;
            if point.psnr < Some(wanted) {
                low = rung;
            } else {
                (high, found) = (rung, Some(point));
            }
            if found.is_none() || high <= low + 1 {
                break;
            }
        }
        Ok(found)
    }

    /// The file at this rung with the target PSNR; none if the whole model has less, or no attempts are left.
    fn reach(&mut self, rung: usize, wanted: f64, guess: f64) -> Result<Option<Point>, T::Error> {
        let mut known: Vec<Point> = Vec::new();
        let mut next = guess;
        for _ in 0..(ON_A_RUNG + 2).min(self.left()) {
            let below = known.iter().filter(|p| p.psnr < Some(wanted)).map(|p| p.gaussians).max();
            let above = known.iter().filter(|p| p.psnr >= Some(wanted)).map(|p| p.gaussians).min();
            if below == Some(self.whole) || above == Some(1) || below.zip(above).is_some_and(|(b, a)| a <= b + 1) {
                break;
            }
            let gaussians =
                (next.round() as usize).clamp(below.map_or(1, |n| n + 1), above.map_or(self.whole, |n| n - 1));
            let point = self.scored(rung, gaussians)?;
            known.push(point);
            if point.psnr.is_some_and(|psnr| (psnr - wanted).abs() <= NEAR) {
                return Ok(Some(point));
            }
            // Where the PSNR jumps, a secant stays on one side: then halving is better.
            next = match bracket(&known, wanted) {
                Some([low, high]) if known.len() > 3 && high.gaussians as f64 > 1.2 * low.gaussians as f64 => {
                    (low.gaussians as f64 * high.gaussians as f64).sqrt()
                }
                Some(ends) => secant(&ends, wanted),
                None => secant(&known, wanted),
            };
        }
        known.retain(|p| p.psnr >= Some(wanted));
        Ok(known.into_iter().min_by_key(|p| p.bytes))
    }
}

/// The nearest files on both sides of a PSNR.
fn bracket(known: &[Point], wanted: f64) -> Option<[Point; 2]> {
    let low = known.iter().filter(|p| p.psnr < Some(wanted)).max_by_key(|p| p.gaussians)?;
    let high = known.iter().filter(|p| p.psnr >= Some(wanted)).min_by_key(|p| p.gaussians)?;
    Some([*low, *high])
}

/// The number of Gaussians for a PSNR, which is about linear in its logarithm: by the two known points that are nearest.
fn secant(known: &[Point], wanted: f64) -> f64 {
    /// dB for twice as many Gaussians, if only one number is known.
    const AN_OCTAVE: f64 = 4.5;
    let mut near: Vec<(f64, f64)> =
        known.iter().filter_map(|p| Some(((p.gaussians as f64).ln(), p.psnr.filter(|v| v.is_finite())?))).collect();
    near.sort_by(|a, b| (a.1 - wanted).abs().total_cmp(&(b.1 - wanted).abs()));
    let slope = AN_OCTAVE / std::f64::consts::LN_2;
    match near[..] {
        // Equal pictures: far fewer.
        [] => known.iter().map(|p| p.gaussians as f64).fold(f64::INFINITY, f64::min) / 3.0,
        [a] => (a.0 + (wanted - a.1) / slope).exp(),
        [a, b, ..] => {
            let own = (a.1 - b.1) / (a.0 - b.0);
            let own = if own.is_finite() { own.clamp(0.2 * slope, 5.0 * slope) } else { slope };
            (a.0 + (wanted - a.1) / own).exp()
        }
    }
}
