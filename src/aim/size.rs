//! The best file of at most a size.

use super::psnr::SMALL;
use super::{ON_A_RUNG, Search, Trials};
use crate::job::records::Point;

/// Minimum share of the target size that counts as reached.
const LEAST_SHARE: f64 = 0.95;
/// The share of the target size at which the secant search aims.
const SHARE: f64 = 0.983;
/// Share of the target size from which a file is not enlarged further.
const CLOSE: f64 = 0.992;
/// Bytes of a Gaussian that are assumed until a file is known.
const GUESS: f64 = 10.0;
/// Bytes of a Gaussian that hardly any file is below.
const LEAST_EACH: f64 = 1.0;
/// Of two files that are too large, the line through both may lead down to this share of the number in proportion to the size, not
/// further: the first merges may save few bytes.
const DEEPEST_CUT: f64 = 0.7;
/// Share of a rung below which the next one would exceed the size.
const HARDLY_A_RUNG: f64 = 0.25;
/// The whole model is tried at a coarser rung if the number of rungs down to where it should fit is at most this many times those
/// that there are.
const SLACK: f64 = 1.5;
/// Two files are not comparable if they grow by more than this many times the usual growth from rung to rung; SOG's grow by up to three times.
const STEEPEST: f64 = 3.5;
/// A merged Gaussian takes this many times the bytes of one of the whole model where these are alike: coarser settings may then serve better.
/// Those of other models take up to 1.22 times as many (5 % of a model in SOG).
const DEARER: f64 = 1.3;
/// Growth of a file from the first rung to the last one, before two rungs are known.
const WHOLE_LADDER: f64 = 4.0;

/// PSNR in dB that a file may lose against a smaller one that does not fill the size.
const FILLING: f64 = 0.2;

/// Whether a file is about as large as asked.
fn is_full(point: &Point, size: u64) -> bool {
    point.bytes as f64 >= LEAST_SHARE * size as f64
}

/// True if a file serves the request better than another: it has a higher PSNR, or fills the size at hardly any loss.
fn is_better(point: &Point, than: &Point, size: u64) -> bool {
    let filling = f64::from(i8::from(is_full(point, size)) - i8::from(is_full(than, size)));
    point.psnr.map(|psnr| psnr + FILLING * filling) > than.psnr
}

impl<T: Trials> Search<'_, T> {
    pub(super) fn by_size(&mut self, size: u64) -> Result<Point, T::Error> {
        let start = (self.steps.len() - 1).div_ceil(3);
        let (mut best, mut first) = self.of_whole(self.steps[start], size)?;
        let better = |point: &Point, best: &Option<Point>| best.is_none_or(|b| is_better(point, &b, size));
        let mut missed = false;
        for step in start..self.steps.len() {
            let rung = self.steps[step];
            // A step below settings at which the whole model fits.
            if best.is_some_and(|b| b.rung >= rung) {
                continue;
            }
            let guess = first.take().unwrap_or_else(|| self.guess(best, rung, size));
            let point = self.on_rung(rung, size, guess)?;
            let Some(point) = point.filter(|point| better(point, &best)) else {
                // The first cut costs most: a finer rung may make up for it.
                if missed || best.is_none_or(|best| best.gaussians < self.whole) {
                    break;
                }
                missed = true;
                continue;
            };
            best = Some(self.filled_above(point, size)?);
            // Files of few Gaussians grow by leaps: two attempts may not fill the size at another rung.
            let least = if self.whole <= SMALL && best.is_some_and(|best| is_full(&best, size)) { 3 } else { 2 };
            if point.rung == self.last() || self.left() < least {
                break;
            }
        }
        if best.is_none_or(|b| b.rung == self.steps[start] && b.gaussians < self.whole) {
            for step in (0..start).rev() {
                if best.is_some() && self.left() < 2 {
                    break;
                }
                let rung = self.steps[step];
                match self.on_rung(rung, size, self.guess(best, rung, size))? {
                    Some(point) if better(&point, &best) => best = Some(point),
                    Some(_) => break,
                    None => {}
                }
            }
        }
        match best {
            Some(best) => {
                let best = self.between(best, size)?;
                self.polish(best, size)
            }
            // One Gaussian at the coarsest rung is small enough.
            None => self.scored(0, 1),
        }
    }

    /// The whole model at a rung; where it does not fit there, about how many Gaussians do, and the whole model at a coarser rung if it takes
    /// fewer bytes than merged ones.
    fn of_whole(&mut self, rung: usize, size: u64) -> Result<(Option<Point>, Option<f64>), T::Error> {
        if (size as f64) < LEAST_EACH * self.whole as f64 {
            return Ok((None, None));
        }
        let whole = self.file(rung, self.whole)?;
        if whole.bytes <= size {
            return Ok((self.on_rung(rung, size, self.whole as f64)?, None));
        }
        let fewer = self.file(rung, (self.expected(&whole, rung, size) as usize).clamp(1, self.whole))?;
        let dear = fewer.bytes >= whole.bytes || self.each(&fewer) > DEARER * self.each(&whole);
        let best = if dear { self.of_whole_below(rung, size)? } else { None };
        let filling = self.secant(&[fewer, whole].map(|file| (file.gaussians, file.bytes as f64)), size);
        Ok((best, Some(filling)))
    }

    /// A file as far as it is known.
    fn file(&mut self, rung: usize, gaussians: usize) -> Result<Point, T::Error> {
        self.bytes(rung, gaussians)?;
        Ok(self.tried[&(rung, gaussians)])
    }

    /// The whole model at a rung where it fits, down from `rung`; none if it seems to fit nowhere.
    fn of_whole_below(&mut self, mut rung: usize, size: u64) -> Result<Option<Point>, T::Error> {
        let mut before = None;
        for _ in 0..ON_A_RUNG {
            let bytes = self.bytes(rung, self.whole)?;
            if bytes <= size {
                return self.on_rung(rung, size, self.whole as f64);
            }
            let [taken, wanted] = [bytes as f64, SHARE * size as f64].map(|bytes| (bytes - self.fixed).max(1.0));
            let growth = before.map_or_else(
                || self.usual_growth(),
                |(above, more): (usize, f64)| (more / taken).ln() / (above - rung) as f64,
            );
            let rungs = (taken / wanted).ln() / growth;
            // Headers make up most of a small file: then coarser settings do not help.
            if rung == 0 || growth <= 0.0 || rungs > SLACK * rung as f64 {
                break;
            }
            before = Some((rung, taken));
            rung = rung.saturating_sub(rungs.ceil() as usize);
        }
        Ok(None)
    }

    /// About how many Gaussians fill the size at a rung: by the best file, or the one tried at the nearest rung.
    fn guess(&self, best: Option<Point>, rung: usize, size: u64) -> f64 {
        let nearest = || self.tried.values().min_by_key(|point| point.rung.abs_diff(rung)).copied();
        match best.or_else(nearest) {
            Some(point) => self.expected(&point, rung, size),
            None => (size as f64 - self.fixed) / GUESS,
        }
    }

    /// Tries fewer Gaussians one rung above if the whole model fits but leaves much of the size free, since files of
    /// few Gaussians grow by leaps. Returns the better file.
    fn filled_above(&mut self, whole: Point, size: u64) -> Result<Point, T::Error> {
        if self.whole > SMALL || whole.gaussians < self.whole || is_full(&whole, size) {
            return Ok(whole);
        }
        let Some((rung, gaussians)) = self.above(whole.rung, size)? else { return Ok(whole) };
        let point = self.scored(rung, gaussians)?;
        Ok(if is_better(&point, &whole, size) { point } else { whole })
    }

    /// Tries rungs between those tried, and the whole model where it just fits, as far as attempts are left.
    fn between(&mut self, mut best: Point, size: u64) -> Result<Point, T::Error> {
        while self.left() > 1
            && let Some((rung, guess)) = self.gap(&best, size)
        {
            let known = self.tried.len();
            if let Some(point) = self.on_rung(rung, size, guess)?.filter(|point| is_better(point, &best, size)) {
                best = point;
            }
            if self.tried.len() == known {
                break;
            }
        }
        Ok(best)
    }

    /// A rung to try beside the best one, and about how many Gaussians fill the size there: the last one at which the whole model fits, if there is
    /// such a rung; otherwise one halfway to the farther of the two that were tried next to it, or to the better one if both are equally far.
    fn gap(&self, best: &Point, size: u64) -> Option<(usize, f64)> {
        // The largest file of each rung that is small enough.
        let mut filled: Vec<Point> = Vec::new();
        for point in self.tried.values().filter(|point| point.psnr.is_some() && point.bytes <= size) {
            match filled.last_mut().filter(|last| last.rung == point.rung) {
                Some(last) => *last = *point,
                None => filled.push(*point),
            }
        }
        let ln = |point: &Point| (point.gaussians as f64).ln();
        let first = filled.first().filter(|first| first.gaussians < self.whole);
        if let Some(first) = first {
            let rung = first.rung as f64 - ((self.whole as f64).ln() - ln(first)) / self.growth(first.rung);
            if rung >= 0.0 {
                return Some((rung as usize, self.whole as f64));
            }
        }
        let at = filled.iter().position(|point| point.rung == best.rung)?;
        let beside = [at.checked_sub(1), Some(at + 1)].map(|at| at.and_then(|at| filled.get(at)));
        let apart = |point: &Point| point.rung.abs_diff(best.rung);
        let wide = beside.into_iter().flatten().filter(|point| apart(point) > 1);
        let next = wide.max_by_key(|point| (apart(point), point.psnr.map(|psnr| (1e3 * psnr) as i64)))?;
        Some((next.rung.midpoint(best.rung), (0.5 * (ln(next) + ln(best))).exp()))
    }

    /// The rung and the number of Gaussians of a file of at most `size` bytes: of all Gaussians, as fine as that allows; of fewer, but one at
    /// least, if even the coarsest rung takes more, or if rungs are far apart. `near` is a rung whose file is about as large.
    pub fn refine(&mut self, size: u64, near: usize) -> Result<(usize, usize), T::Error> {
        let whole = self.whole;
        self.fixed = self.trials.bytes(0, 1)? as f64;
        let share = |bytes: u64| size as f64 / bytes as f64;
        let from = if self.bytes(near, whole)? <= size { near } else { 0 };
        let least = self.bytes(from, whole)?;
        if least > size {
            let fewer = self.fill(from, size, share(least) * whole as f64)?.unwrap_or(1);
            return Ok((self.finest(from, fewer, size)?, fewer));
        }
        let rung = self.finest(from, whole, size)?;
        let rung = self.finest(rung, whole, size)?;
        if share(self.bytes(rung, whole)?) > 1.0 / LEAST_SHARE
            && let Some(above) = self.above(rung, size)?
        {
            return Ok(above);
        }
        Ok((rung, whole))
    }

    /// Rung and Gaussians of a file one rung above one at which the whole model fits: of the whole model, too, or one that fills the
    /// size; none if too few trials are left.
    fn above(&mut self, rung: usize, size: u64) -> Result<Option<(usize, usize)>, T::Error> {
        if rung >= self.last() || self.left() < 2 {
            return Ok(None);
        }
        let next = self.bytes(rung + 1, self.whole)?;
        let Some(fewer) = self.fill(rung + 1, size, size as f64 / next as f64 * self.whole as f64)? else {
            return Ok(None);
        };
        let full = self.bytes(rung + 1, fewer)? as f64 >= LEAST_SHARE * size as f64;
        Ok((full || fewer == self.whole).then_some((rung + 1, fewer)))
    }

    /// The file of this size at a rung; or, if the whole model takes less there, that of the whole model at a finer one.
    fn on_rung(&mut self, rung: usize, size: u64, guess: f64) -> Result<Option<Point>, T::Error> {
        let Some(gaussians) = self.fill(rung, size, guess)? else { return Ok(None) };
        let rung = if gaussians == self.whole { self.finest(rung, gaussians, size)? } else { rung };
        self.scored(rung, gaussians).map(Some)
    }

    /// The finest rung at which this number of Gaussians takes at most `size` bytes, as far as trials are left; at `from` it does.
    pub(super) fn finest(&mut self, from: usize, gaussians: usize, size: u64) -> Result<usize, T::Error> {
        let mut low = (from, self.bytes(from, gaussians)? as f64);
        let known = self.tried.values().filter(|p| p.gaussians == gaussians && p.rung > from && p.bytes > size);
        let mut high = known.map(|p| (p.rung, p.bytes as f64)).min_by_key(|(rung, _)| *rung);
        let size = size as f64;
        for _ in 0..ON_A_RUNG.min(self.left()) {
            if low.0 == self.last() || low.1 >= CLOSE * size {
                break;
            }
            // Bytes grow by about the same factor from each rung to the next.
            let growth = high.map_or_else(
                || self.growth(low.0),
                |(rung, bytes): (usize, f64)| (bytes / low.1).ln() / (rung - low.0) as f64,
            );
            let rungs = |share: f64| (share * size / low.1).ln() / growth;
            if rungs(1.0) < HARDLY_A_RUNG {
                break;
            }
            let next = match high {
                None => (low.0 + rungs(1.0).ceil() as usize).min(self.last()),
                Some((rung, _)) if rung <= low.0 + 1 => break,
                Some((rung, _)) => (low.0 + rungs(0.5 * (1.0 + CLOSE)).round() as usize).clamp(low.0 + 1, rung - 1),
            };
            let here = (next, self.bytes(next, gaussians)? as f64);
            if here.1 <= size {
                low = here;
            } else {
                high = Some(here);
            }
        }
        Ok(low.0)
    }

    /// The logarithm of the factor by which files grow from rung to rung: between the tried ones nearest to a rung, or usually.
    fn growth(&self, rung: usize) -> f64 {
        let nearest = |far: &dyn Fn(usize) -> bool| {
            self.tried.values().filter(|point| far(point.rung)).min_by_key(|point| point.rung.abs_diff(rung))
        };
        let first = nearest(&|_| true);
        let apart = self.last().div_ceil(12);
        let second = first.and_then(|first| nearest(&|other| other.abs_diff(first.rung) >= apart));
        let growth =
            first.zip(second).map(|(a, b)| (self.each(b) / self.each(a)).ln() / (b.rung as f64 - a.rung as f64));
        // In a long ladder, a file of the whole model beside one of few merged Gaussians, which take more bytes each, tells nothing; in a
        // short one, headers grow as well.
        let usual = self.usual_growth();
        let steepest = if apart > 1 { STEEPEST * usual } else { f64::INFINITY };
        growth.filter(|growth| *growth > 0.0 && *growth < steepest).unwrap_or(usual)
    }

    fn usual_growth(&self) -> f64 {
        WHOLE_LADDER.ln() / self.last().max(1) as f64
    }

    /// Bytes of a Gaussian in a file.
    fn each(&self, point: &Point) -> f64 {
        (point.bytes as f64 - self.fixed).max(1.0) / point.gaussians.max(1) as f64
    }

    /// The number of Gaussians expected to fill the size at a rung, by a file at another one.
    fn expected(&self, point: &Point, rung: usize, size: u64) -> f64 {
        let each = self.each(point) * (self.growth(rung) * (rung as f64 - point.rung as f64)).exp();
        SHARE * (size as f64 - self.fixed) / each
    }

    /// A few more steps towards the size, if attempts are left.
    fn polish(&mut self, mut best: Point, size: u64) -> Result<Point, T::Error> {
        let wanted = CLOSE * size as f64;
        if self.left() == 0 || best.gaussians == self.whole || best.bytes as f64 > wanted {
            return Ok(best);
        }
        let more = ((wanted - best.bytes as f64) / self.each(&best)) as usize;
        let (rung, gaussians) = if (best.bytes as f64) < LEAST_SHARE * size as f64 {
            // Files of few Gaussians grow by leaps: then finer settings of the same ones fill the rest.
            let finer = self.finest(best.rung, best.gaussians, size)?;
            if self.bytes(finer, best.gaussians)? as f64 >= LEAST_SHARE * size as f64 {
                (finer, best.gaussians)
            } else {
                let gaussians = self.fill(best.rung, size, (best.gaussians + more) as f64)?.unwrap_or(best.gaussians);
                (self.finest(best.rung, gaussians, size)?, gaussians)
            }
        } else {
            (best.rung, (best.gaussians + more).min(self.whole))
        };
        if (rung, gaussians) != (best.rung, best.gaussians) && self.bytes(rung, gaussians)? <= size {
            let point = self.scored(rung, gaussians)?;
            if is_better(&point, &best, size) {
                best = point;
            }
        }
        Ok(best)
    }

    /// The number of Gaussians with which a file at this rung is as large as asked, if trials are left; the largest that is small
    /// enough, if none is found.
    fn fill(&mut self, rung: usize, size: u64, guess: f64) -> Result<Option<usize>, T::Error> {
        let known = self.tried.range((rung, 0)..=(rung, usize::MAX)).map(|(_, p)| (p.gaussians, p.bytes as f64));
        let mut known: Vec<(usize, f64)> = known.collect();
        let fits = |bytes: f64| bytes <= size as f64;
        let mut next = guess;
        for _ in 0..ON_A_RUNG.min(self.left()) {
            if known.iter().any(|(_, bytes)| fits(*bytes) && *bytes >= LEAST_SHARE * size as f64) {
                break;
            }
            // Files of nearly equal Gaussians may grow as these are merged: the most that fit count.
            let at = known.iter().rposition(|(_, bytes)| fits(*bytes));
            let (low, high) = (at.map(|at| known[at]), known.get(at.map_or(0, |at| at + 1)).copied());
            let (first, last) = (low.map_or(1, |(n, _)| n + 1), high.map_or(self.whole, |(n, _)| n - 1));
            if first > last {
                break;
            }
            let gaussians = (next.round() as usize).clamp(first, last);
            let here = (gaussians, self.bytes(rung, gaussians)? as f64);
            known.insert(known.partition_point(|(n, _)| *n < gaussians), here);
            next = self.secant(&known, size);
        }
        Ok(known.iter().rev().find(|(_, bytes)| fits(*bytes)).map(|(gaussians, _)| *gaussians))
    }

    /// The number of Gaussians at which a file of about this size is expected, by those tried at a rung, in order of Gaussians: on the line
    /// through the two that enclose the size, or through the two nearest to it.
    fn secant(&self, known: &[(usize, f64)], size: u64) -> f64 {
        let wanted = SHARE * size as f64;
        let on_line = |from: (usize, f64), to: (usize, f64)| {
            from.0 as f64 + (wanted - from.1) * (to.0 - from.0) as f64 / (to.1 - from.1).max(1.0)
        };
        let fitting = known.iter().rposition(|(_, bytes)| *bytes <= size as f64).map_or(0, |at| at + 1);
        let nearest = known[fitting.min(known.len() - 1)];
        let in_proportion = on_line((0, self.fixed.min(0.9 * nearest.1)), nearest);
        if fitting == 0 {
            let by_two = known.get(1).map_or(in_proportion, |second| on_line(nearest, *second));
            by_two.min(in_proportion).max(DEEPEST_CUT * in_proportion)
        } else if fitting < known.len() {
            on_line(known[fitting - 1], nearest)
        } else {
            fitting.checked_sub(2).map_or(in_proportion, |at| on_line(known[at], nearest).max(in_proportion))
        }
    }
}
