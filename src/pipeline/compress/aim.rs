//! The search for the best file: a number of Gaussians and a rung of the format's ladder of settings.
//!
//! Bytes and PSNR grow with both. On one rung, a secant over numbers finds the file of the wanted size or PSNR; of the rungs, the one
//! whose file is best is found by climbing from one to the next.

use serde::Serialize;
use std::collections::BTreeMap;

/// What is asked of a file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aim {
    /// The best picture in at most so many bytes.
    Bytes(u64),
    /// The fewest bytes for a PSNR in dB, the mean over views.
    Psnr(f64),
}

/// A file that was tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Rung of the ladder, from 0, the coarsest.
    pub rung: usize,
    /// Gaussians.
    pub gaussians: usize,
    /// Bytes of the file.
    pub bytes: u64,
    /// PSNR in dB, if it was measured; null if pictures are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr: Option<f64>,
}

/// Files of a model.
pub trait Trials {
    /// The reason why a file cannot be made.
    type Error;

    /// Bytes of the file with this many Gaussians at this rung.
    ///
    /// # Errors
    /// Those of making it.
    fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, Self::Error>;

    /// PSNR of a file's pictures in dB.
    ///
    /// # Errors
    /// Those of making the file or the pictures.
    fn psnr(&mut self, rung: usize, gaussians: usize) -> Result<f64, Self::Error>;
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// The best file.
    Best(Point),
    /// Even one Gaussian at the coarsest rung takes this many bytes.
    TooSmall(u64),
}

/// A file is as large as asked from this share of the size on.
const LEAST_SHARE: f64 = 0.95;
/// The share that the secant aims at.
const SHARE: f64 = 0.983;
/// A file is not enlarged further from this share of the size on.
const CLOSE: f64 = 0.992;
/// Largest number of files that are tried, without those of one Gaussian.
const MOST: usize = 9;
/// Trials on one rung.
const ON_A_RUNG: usize = 4;
/// Bytes of a Gaussian before anything is known of the model.
const GUESS: f64 = 10.0;
/// Largest distance from the PSNR wanted, in dB.
const NEAR: f64 = 0.04;

/// The search, and what it has tried.
pub struct Search<'a, T> {
    trials: &'a mut T,
    /// Gaussians of the whole model.
    whole: usize,
    rungs: usize,
    /// Bytes of a file without Gaussians, about.
    fixed: f64,
    /// Files tried, by rung and Gaussians.
    tried: BTreeMap<(usize, usize), Point>,
    most: usize,
}

impl<'a, T: Trials> Search<'a, T> {
    /// A search over a model of `whole` Gaussians and a ladder of so many rungs.
    pub fn new(trials: &'a mut T, whole: usize, rungs: usize) -> Self {
        Self { trials, whole, rungs, fixed: 0.0, tried: BTreeMap::new(), most: MOST }
    }

    /// The files tried, in order of rung and Gaussians.
    pub fn tried(&self) -> Vec<Point> {
        self.tried.values().copied().collect()
    }

    /// Finds the best file.
    ///
    /// # Errors
    /// Those of the trials.
    pub fn find(&mut self, aim: Aim) -> Result<Found, T::Error> {
        let smallest = self.trials.bytes(0, 1)?;
        self.fixed = smallest as f64;
        match aim {
            Aim::Bytes(size) if size < smallest => Ok(Found::TooSmall(smallest)),
            Aim::Bytes(size) => self.by_size(size).map(Found::Best),
            Aim::Psnr(psnr) => self.by_psnr(psnr).map(Found::Best),
        }
    }

    fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, T::Error> {
        if let Some(point) = self.tried.get(&(rung, gaussians)) {
            return Ok(point.bytes);
        }
        let bytes = self.trials.bytes(rung, gaussians)?;
        self.tried.insert((rung, gaussians), Point { rung, gaussians, bytes, psnr: None });
        Ok(bytes)
    }

    fn scored(&mut self, rung: usize, gaussians: usize) -> Result<Point, T::Error> {
        self.bytes(rung, gaussians)?;
        let psnr = self.trials.psnr(rung, gaussians)?;
        let point = self.tried.get_mut(&(rung, gaussians)).expect("a file that was tried");
        point.psnr = Some(psnr);
        Ok(*point)
    }

    fn left(&self) -> usize {
        self.most.saturating_sub(self.tried.len())
    }

    fn by_size(&mut self, size: u64) -> Result<Point, T::Error> {
        let last = self.rungs - 1;
        let start = last.div_ceil(3);
        let mut guess = (size as f64 - self.fixed) / GUESS;
        let mut best = None;
        // If the whole model is small enough at one rung, only finer ones can be better.
        let (mut rung, mut up) = (start, true);
        loop {
            if let Some(gaussians) = self.fill(rung, size, guess)? {
                let point = self.scored(rung, gaussians)?;
                let whole = gaussians == self.whole;
                // Files of the whole model may be smaller than asked: any other is nearer to the wish.
                let full = |p: &Point| p.bytes as f64 >= LEAST_SHARE * size as f64;
                let better = best.is_none_or(|b: Point| (full(&point), point.psnr) > (full(&b), b.psnr));
                guess = gaussians as f64
                    * if whole && up {
                        1.0
                    } else if up {
                        0.8
                    } else {
                        1.2
                    };
                if better {
                    best = Some(point);
                }
                if whole && rung < last && self.bytes(last, self.whole)? <= size {
                    return self.scored(last, self.whole);
                }
                // The first step up was no better: go down from the start.
                if !better && up && rung == start + 1 && !whole {
                    (rung, up) = (start, false);
                } else if !better {
                    break;
                }
            } else if up && rung > start {
                (rung, up) = (start, false);
            }
            match (up, rung) {
                (true, r) if r < last => rung += 1,
                (true, _) if best.is_none_or(|b| b.rung == start) => (rung, up) = (start.saturating_sub(1), false),
                (false, r) if r > 0 => rung -= 1,
                _ => break,
            }
            if rung == start || (self.left() < 2 && best.is_some()) {
                break;
            }
        }
        match best {
            Some(best) => self.polish(best, size),
            // One Gaussian at the coarsest rung is small enough.
            None => self.scored(0, 1),
        }
    }

    /// One more step towards the size, if a trial is left.
    fn polish(&mut self, best: Point, size: u64) -> Result<Point, T::Error> {
        if self.left() == 0 || best.gaussians == self.whole || best.bytes as f64 > CLOSE * size as f64 {
            return Ok(best);
        }
        let each = (best.bytes as f64 - self.fixed).max(1.0) / best.gaussians as f64;
        let more = ((CLOSE * size as f64 - best.bytes as f64) / each) as usize;
        let gaussians = (best.gaussians + more).min(self.whole);
        if more == 0 || self.bytes(best.rung, gaussians)? > size {
            return Ok(best);
        }
        let point = self.scored(best.rung, gaussians)?;
        Ok(if point.psnr > best.psnr { point } else { best })
    }

    /// The number of Gaussians with which a file at this rung is as large as asked, if trials are left; the largest that is small
    /// enough, if none is found.
    fn fill(&mut self, rung: usize, size: u64, guess: f64) -> Result<Option<usize>, T::Error> {
        let (mut low, mut high) = (None::<(usize, f64)>, None::<(usize, f64)>);
        let mut next = guess;
        for _ in 0..ON_A_RUNG.min(self.left()) {
            let gaussians = (next.round() as usize)
                .clamp(low.map_or(1, |(n, _)| n + 1).min(self.whole), high.map_or(self.whole, |(n, _)| n - 1).max(1));
            let bytes = self.bytes(rung, gaussians)?;
            let here = (gaussians, bytes as f64);
            if bytes <= size {
                if bytes as f64 >= LEAST_SHARE * size as f64 || gaussians == self.whole {
                    return Ok(Some(gaussians));
                }
                low = Some(here);
            } else if gaussians == 1 {
                return Ok(None);
            } else {
                high = Some(here);
            }
            let (from, to) = match (low, high) {
                (Some(low), Some(high)) if high.0 - low.0 < 2 => break,
                (Some(low), Some(high)) => (low, high),
                _ => ((0, self.fixed.min(0.9 * here.1)), here),
            };
            let slope = (to.1 - from.1).max(1.0) / (to.0 - from.0) as f64;
            next = from.0 as f64 + (SHARE * size as f64 - from.1) / slope;
        }
        Ok(low.map(|(gaussians, _)| gaussians))
    }

    fn by_psnr(&mut self, wanted: f64) -> Result<Point, T::Error> {
        self.most = 2 * MOST;
        let last = self.rungs - 1;
        let start = last.div_ceil(3);
        let mut guess = self.whole as f64 / 3.0;
        let mut best: Option<Point> = None;
        let keep = |best: &mut Option<Point>, point: Option<Point>| {
            let better = point.is_some_and(|p| best.is_none_or(|b| p.bytes < b.bytes));
            if better {
                *best = point;
            }
            better
        };
        let mut rung = start;
        // Up as long as that needs fewer bytes, or as coarser rungs cannot reach the PSNR at all; else down.
        loop {
            let point = self.reach(rung, wanted, guess)?;
            guess = point.map_or(self.whole as f64, |p| p.gaussians as f64);
            let better = keep(&mut best, point);
            if rung == last || (!better && best.is_some()) {
                break;
            }
            rung += 1;
        }
        if best.is_none_or(|b| b.rung == start) {
            for rung in (0..start).rev() {
                let point = self.reach(rung, wanted, guess)?;
                if !keep(&mut best, point) {
                    break;
                }
            }
        }
        match best {
            Some(best) => Ok(best),
            None => self.scored(last, self.whole),
        }
    }

    /// The file at this rung that has the PSNR wanted; none if the whole model has less, or no trials are left.
    fn reach(&mut self, rung: usize, wanted: f64, guess: f64) -> Result<Option<Point>, T::Error> {
        let mut known: Vec<Point> = Vec::new();
        let mut next = guess;
        for _ in 0..(ON_A_RUNG + 2).min(self.left()) {
            let below = known.iter().filter(|p| p.psnr < Some(wanted)).map(|p| p.gaussians).max();
            let above = known.iter().filter(|p| p.psnr >= Some(wanted)).map(|p| p.gaussians).min();
            if below == Some(self.whole) || below.zip(above).is_some_and(|(b, a)| a <= b + 1) {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Files whose bytes and PSNR are known functions: a Gaussian takes `bytes[rung]`, a rung costs `loss[rung]`.
    struct Model {
        bytes: Vec<f64>,
        noise: Vec<f64>,
        whole: usize,
        encodes: usize,
    }

    impl Trials for Model {
        type Error = ();

        fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, ()> {
            self.encodes += usize::from(gaussians > 1);
            // Fewer Gaussians take some more each.
            Ok((4000.0 + self.bytes[rung] * gaussians as f64 * (1.0 - 0.01 * (gaussians as f64).ln())) as u64)
        }

        fn psnr(&mut self, rung: usize, gaussians: usize) -> Result<f64, ()> {
            let merged = 10_f64.powf(-(20.0 + 6.0 * (gaussians as f64 / 1000.0).log2()) / 10.0);
            let merged = if gaussians == self.whole { 0.0 } else { merged };
            Ok(-10.0 * (merged + self.noise[rung]).log10())
        }
    }

    fn model(rungs: usize, whole: usize) -> Model {
        let bytes = (0..rungs).map(|r| 8.0 * 1.25_f64.powi(r as i32)).collect();
        let noise = (0..rungs).map(|r| 10_f64.powf(-3.2 - 0.5 * r as f64)).collect();
        Model { bytes, noise, whole, encodes: 0 }
    }

    #[test]
    fn sizes_are_met_with_the_best_rung_in_nine_encodes() {
        for (rungs, whole) in [(1, 50_000), (4, 50_000), (7, 50_000), (7, 2_000_000)] {
            for size in [9_000_u64, 50_000, 200_000, 400_000, 3_000_000] {
                let mut trials = model(rungs, whole);
                let mut search = Search::new(&mut trials, whole, rungs);
                let Ok(Found::Best(best)) = search.find(Aim::Bytes(size)) else { panic!("{size}") };
                let tried = search.tried();
                assert!(best.bytes <= size, "{best:?} of {size}");
                assert!(best.bytes as f64 >= 0.95 * size as f64 || best.gaussians == whole, "{best:?} of {size}");
                assert!(trials.encodes <= MOST, "{} encodes: {tried:?}", trials.encodes);
                // No rung has a better file of this size than 0.3 dB more.
                for rung in 0..rungs {
                    let fits = (1..=whole).rev().step_by(50).find(|n| trials.bytes(rung, *n).unwrap() <= size);
                    let psnr = fits.map(|n| trials.psnr(rung, n).unwrap());
                    assert!(
                        psnr <= best.psnr.map(|p| p + 0.4),
                        "{rungs} {size}: {best:?}, rung {rung}: {psnr:?}, {tried:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_psnr_is_met_and_sizes_that_are_impossible_are_refused() {
        for wanted in [22.0, 30.0, 35.0, 42.0] {
            let mut trials = model(7, 50_000);
            let mut search = Search::new(&mut trials, 50_000, 7);
            let Ok(Found::Best(best)) = search.find(Aim::Psnr(wanted)) else { panic!("{wanted}") };
            assert!(best.psnr.is_some_and(|p| (p - wanted).abs() < 0.1), "{best:?} for {wanted}: {:?}", search.tried());
        }
        let mut trials = model(7, 50_000);
        assert_eq!(Search::new(&mut trials, 50_000, 7).find(Aim::Bytes(4000)), Ok(Found::TooSmall(4008)));
        let mut trials = model(7, 50_000);
        let Ok(Found::Best(best)) = Search::new(&mut trials, 50_000, 7).find(Aim::Psnr(99.0)) else { panic!() };
        assert_eq!((best.rung, best.gaussians), (6, 50_000), "the finest file of the whole model is the best there is");
    }
}
