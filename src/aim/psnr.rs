//! The smallest file of at least a PSNR.

use super::row::Row;
use super::{MOST, Search, Trials};
use crate::job::records::Point;

/// Distance in dB from the target PSNR from which the bytes of the file with that PSNR are foretold.
const ROUGH: f64 = 0.5;
/// Excess in dB over the target beyond which a file is halved.
const FAR: f64 = 0.5;
/// Maximum number of attempts at one rung until its bytes are foretold, and at the first one, where nothing is known yet.
const ON_A_RUNG: usize = 3;
const ON_THE_FIRST: usize = 5;
/// Most attempts, beyond all others, at a file that reaches the target; as many again at smaller ones.
pub(super) const TO_SHRINK: usize = 4;
/// Share of a file's Gaussians by which fewer are worth an attempt.
const CLOSE: f64 = 0.02;
/// Attempts left for the best rung while rungs are compared.
const TO_REFINE: usize = 4;
/// Share of a file's bytes that another rung must promise to save to be worth an attempt.
const SAVING: f64 = 0.01;

/// Gaussians of a model whose files are made in milliseconds: it gets [`AT_SMALL`] attempts, others get [`AT_LARGE`].
pub(super) const SMALL: usize = 5_000;
const AT_SMALL: usize = MOST + 9;
const AT_LARGE: usize = MOST + 3;

impl<T: Trials> Search<'_, T> {
    /// Foretells the bytes at neighbouring rungs from rough attempts, and refines the best of them.
    pub(super) fn by_psnr(&mut self, wanted: f64) -> Result<Point, T::Error> {
        self.most = AT_LARGE;
        let start = self.steps[(self.steps.len() - 1).div_ceil(3)];
        // All Gaussians may take fewer bytes than merged ones, if they are alike.
        let first = self.scored(start, self.whole)?;
        let mut whole = Row::of_whole(self.last(), wanted, self.whole);
        whole.add(first);
        let mut rows: Vec<Row> = Vec::new();
        // Fewer Gaussians hardly reach a PSNR that the whole model misses.
        let finer = self.steps.iter().copied().find(|step| *step > start && first.psnr < Some(wanted));
        let mut next = finer.or(Some(start));
        while let Some(rung) = next {
            self.explore(rung, wanted, &mut rows)?;
            next = self.neighbour(&rows).filter(|_| self.left() > TO_REFINE || best(&rows).is_none());
        }
        self.tried.values().for_each(|known| whole.learn(known));
        rows.push(whole);
        if self.whole <= SMALL {
            self.most = AT_SMALL;
        }
        self.follow(wanted, &mut rows)?;
        // The files tried by now may make another rung the best, whose neighbours are unknown.
        let mut idle = 0;
        while self.left() > 2
            && idle < 2
            && let Some((near, rung)) = best(&rows).zip(self.neighbour(&rows))
        {
            let before = self.smallest(wanted);
            let mut row = rows[near].at(rung);
            self.attempt(&mut row)?;
            rows.push(row);
            self.follow(wanted, &mut rows)?;
            let saves = |now: Point, before: Point| now.bytes as f64 <= (1.0 - SAVING) * before.bytes as f64;
            idle = if self.smallest(wanted).zip(before).is_some_and(|(now, before)| !saves(now, before)) {
                idle + 1
            } else {
                0
            };
        }
        // Where PSNR hardly depends on the number, as with held-out photos, secants through one file mislead.
        for at in 0..rows.len() {
            if self.left() > 2
                && let Some((rung, gaussians)) = rows[at].half()
            {
                let point = self.scored(rung, gaussians)?;
                rows[at].add(point);
                self.follow(wanted, &mut rows)?;
            }
        }
        // Where every row turned out to miss the target, a finer rung of the whole model reaches it.
        if self.smallest(wanted).is_none() {
            self.scored(self.last(), self.whole)?;
            self.most = self.most.max(self.tried.len() + ON_A_RUNG);
            self.learn(&mut rows);
            self.follow(wanted, &mut rows)?;
        }
        self.shrink(wanted, &mut rows)?;
        if let Some(point) = self.smallest(wanted) {
            return Ok(point);
        }
        // Held-out photos may agree better with fewer Gaussians than with all.
        let better = |ends: &[Point]| ends[0].rung == ends[1].rung && ends[0].psnr > ends[1].psnr;
        if self.whole <= SMALL || self.tried().windows(2).any(better) {
            for parts in 2..=4 {
                self.scored(self.last(), (self.whole / parts).max(1))?;
            }
        }
        let merit = |point: &Point| (point.psnr.map_or(i64::MIN, |psnr| (1e6 * psnr) as i64), point.gaussians);
        let most = self.tried().into_iter().max_by_key(merit);
        self.smallest(wanted).or(most).map_or_else(|| self.scored(self.last(), self.whole), Ok)
    }

    /// Adds the row of a rung, with attempts that come as near to the target as its bytes need to be foretold.
    fn explore(&mut self, rung: usize, wanted: f64, rows: &mut Vec<Row>) -> Result<(), T::Error> {
        let near = best(rows).map(|at| &rows[at]).or_else(|| rows.last());
        let mut row = near.map_or_else(|| Row::of_rung(rung, wanted, self.whole), |near| near.at(rung));
        // As long as no rung is known to reach the PSNR, all attempts serve to find one.
        let reserved = if best(rows).is_some() { TO_REFINE } else { 0 };
        let most = if rows.is_empty() { ON_THE_FIRST } else { ON_A_RUNG };
        for _ in 0..most {
            if row.nearest().is_some_and(|psnr| psnr <= ROUGH) || self.left() <= reserved || !self.attempt(&mut row)? {
                break;
            }
        }
        rows.push(row);
        Ok(())
    }

    /// The step above the best row, or else the one below, where no row is as near on that side; or else halfway to the row that is farthest
    /// away of the two beside it. Above all rows if none reaches the PSNR.
    fn neighbour(&self, rows: &[Row]) -> Option<usize> {
        let tried = || rows.iter().filter_map(|row| row.rung);
        let best = best(rows);
        let rung = best.map_or_else(|| tried().max(), |at| rows[at].rung)?;
        let (above, below) = (tried().filter(|other| *other > rung).min(), tried().filter(|other| *other < rung).max());
        let up = self.steps.iter().copied().find(|step| *step > rung && above.is_none());
        let down = self.steps.iter().rev().copied().find(|step| *step < rung && best.is_some() && below.is_none());
        let between = || {
            let beside = above.into_iter().chain(below).filter(|other| other.abs_diff(rung) > 1);
            beside.max_by_key(|other| other.abs_diff(rung)).map(|other| other.midpoint(rung))
        };
        up.or(down).or_else(|| best.and_then(|_| between()))
    }

    /// Follows the row that promises the smallest file, until one file is near the target and no row promises a smaller one.
    fn follow(&mut self, wanted: f64, rows: &mut Vec<Row>) -> Result<(), T::Error> {
        let limit = self.most + TO_SHRINK;
        while (self.left() > 0 || self.smallest(wanted).is_none() && self.tried.len() < limit)
            && let Some(at) = self.most_promising(wanted, rows)
            && self.attempt(&mut rows[at])?
        {}
        Ok(())
    }

    /// The row to try next: the one that promises a smaller file than is known, or else that of the smallest file known; `None` if neither
    /// has anything left to try.
    fn most_promising(&self, wanted: f64, rows: &mut Vec<Row>) -> Option<usize> {
        let smallest = self.smallest(wanted);
        let enough = smallest.map(|point| (1.0 - SAVING) * point.bytes as f64);
        let saves = |row: &Row| row.is_open() && enough.is_none_or(|enough| row.bytes().is_some_and(|b| b < enough));
        if let Some(at) = best(rows).filter(|at| saves(&rows[*at])) {
            return Some(at);
        }
        let point = smallest?;
        if !rows.iter().any(|row| row.rung == Some(point.rung)) {
            let mut row = Row::of_rung(point.rung, wanted, self.whole);
            self.tried.values().for_each(|known| row.learn(known));
            rows.push(row);
        }
        let of_whole = rows.iter().position(|row| row.rung.is_none() && row.holds(&point) && row.is_open());
        of_whole.or_else(|| rows.iter().position(|row| row.rung == Some(point.rung) && row.is_open()))
    }

    /// Tries the next file of a row; false if the row has none left to try.
    fn attempt(&mut self, row: &mut Row) -> Result<bool, T::Error> {
        let Some((rung, gaussians)) = row.next() else { return Ok(false) };
        row.add(self.scored(rung, gaussians)?);
        Ok(true)
    }

    /// Tries files smaller than the smallest one that reaches the target. One that exceeds the target by far is halved,
    /// since PSNR hardly grows or jumps there, and secants mislead. Where that fails, and near the target, the row that
    /// promises the smallest file is narrowed.
    fn shrink(&mut self, wanted: f64, rows: &mut [Row]) -> Result<(), T::Error> {
        let (mut by_rung, mut halves) = (true, true);
        for _ in 0..TO_SHRINK {
            let Some(point) = self.smallest(wanted) else { break };
            self.learn(rows);
            let is_far = point.psnr > Some(wanted + FAR);
            let half = self.halved(&point, wanted, by_rung).filter(|_| is_far);
            let narrowed = self.narrowed(&point, rows);
            let is_half = half.is_some() && (halves || narrowed.is_none());
            let next = if is_half { half } else { narrowed };
            let Some((rung, gaussians)) = next else { break };
            let next = self.scored(rung, gaussians)?;
            let is_smaller = next.psnr >= Some(wanted) && next.bytes <= point.bytes;
            if is_half && !is_smaller {
                by_rung = !by_rung;
            }
            // A method that found no smaller file gives way to the other.
            halves = is_half == is_smaller;
        }
        Ok(())
    }

    /// Returns rung and Gaussians of a file halfway down from the point's to one that misses the target, by rungs or by
    /// Gaussians; by the other of the two if nothing lies between.
    fn halved(&self, point: &Point, wanted: f64, by_rung: bool) -> Option<(usize, usize)> {
        let (coarser, fewer) = (self.coarser(point, wanted), self.fewer(point, wanted));
        if by_rung { coarser.or(fewer) } else { fewer.or(coarser) }
    }

    /// Returns rung and Gaussians of a file smaller than the point's, from the row that promises the smallest one
    /// between two that were tried; none for a small model, which had enough attempts before.
    fn narrowed(&self, point: &Point, rows: &[Row]) -> Option<(usize, usize)> {
        let most = (1.0 - SAVING) * point.bytes as f64;
        let below = rows.iter().filter(|_| self.whole > SMALL).filter_map(|row| row.below(most));
        below.filter(|(bytes, _)| *bytes < most).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, next)| next)
    }

    /// Returns a rung halfway between the point's and the finest that misses the target with as many Gaussians, and
    /// their number; none if no rung lies between.
    fn coarser(&self, point: &Point, wanted: f64) -> Option<(usize, usize)> {
        let known = self.tried.values().filter(|known| known.gaussians == point.gaussians && known.rung < point.rung);
        let misses = known.filter(|known| known.psnr < Some(wanted));
        let first = misses.map(|known| known.rung + 1).max().unwrap_or(0);
        (first < point.rung).then(|| (first.midpoint(point.rung), point.gaussians))
    }

    /// Returns the point's rung, and a number of Gaussians halfway between the point's and the largest that misses the
    /// target there; none if hardly any lie between.
    fn fewer(&self, point: &Point, wanted: f64) -> Option<(usize, usize)> {
        let known = self.tried.values().filter(|known| known.rung == point.rung && known.gaussians < point.gaussians);
        let misses = known.filter(|known| known.psnr < Some(wanted));
        let first = misses.map(|known| known.gaussians + 1).max().unwrap_or(1);
        let between = point.gaussians.saturating_sub(first);
        (between as f64 >= CLOSE * point.gaussians as f64).then(|| (point.rung, first.midpoint(point.gaussians)))
    }

    /// Adds to each row the files of it that were tried for others.
    fn learn(&self, rows: &mut [Row]) {
        for row in rows {
            self.tried.values().for_each(|known| row.learn(known));
        }
    }

    /// The smallest of the files tried that reach the target PSNR.
    fn smallest(&self, wanted: f64) -> Option<Point> {
        self.tried.values().filter(|point| point.psnr >= Some(wanted)).min_by_key(|point| point.bytes).copied()
    }
}

/// The row whose file with the target PSNR is foretold to have the fewest bytes.
fn best(rows: &[Row]) -> Option<usize> {
    let bytes = rows.iter().enumerate().filter_map(|(at, row)| Some((at, row.bytes()?)));
    bytes.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(at, _)| at)
}
