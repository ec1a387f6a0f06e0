//! The smallest file of at least a PSNR.

use super::row::Row;
use super::{MOST, Search, Trials};
use crate::job::records::Point;

/// Distance in dB from the target PSNR from which the bytes of the file with that PSNR are foretold.
const ROUGH: f64 = 1.0;
/// Excess in dB over the target that is worth more attempts.
const FAR: f64 = 0.5;
/// Maximum number of attempts at one rung until its bytes are foretold.
const ON_A_RUNG: usize = 3;
/// Most attempts, beyond all others, at smaller files where the smallest one still exceeds the target by [`FAR`].
pub(super) const TO_HALVE: usize = 4;
/// Share of a file's Gaussians by which fewer are worth an attempt.
const CLOSE: f64 = 0.02;
/// Attempts left for the best rung, of which three suffice unless PSNR jumps or hardly grows.
const TO_REFINE: usize = 6;

/// Gaussians of a model whose files are made in milliseconds: it gets more attempts.
pub(super) const SMALL: usize = 5_000;

impl<T: Trials> Search<'_, T> {
    /// Foretells the bytes at neighbouring rungs from rough attempts, and refines the best of them.
    pub(super) fn by_psnr(&mut self, wanted: f64) -> Result<Point, T::Error> {
        self.most = MOST + TO_REFINE - 3;
        let start = (self.steps.len() - 1).div_ceil(3);
        let mut rows: Vec<Row> = Vec::new();
        // Up as long as that needs fewer bytes, or as coarser rungs cannot reach the PSNR at all; else down.
        for step in start..self.steps.len() {
            if !self.is_better(self.steps[step], wanted, &mut rows)? && best(&mut rows).is_some() {
                break;
            }
        }
        if best(&mut rows).is_none_or(|row| row.rung == Some(self.steps[start])) {
            for step in (0..start).rev() {
                if !self.is_better(self.steps[step], wanted, &mut rows)? {
                    break;
                }
            }
        }
        rows.extend(self.of_whole(wanted));
        while let Some(row) = best(&mut rows)
            && !row.is_met()
            && (self.left() > 0 || self.smallest(wanted).is_none())
            && self.attempt(row)?
        {}
        // Where every row turned out to miss the target, a finer rung of the whole model reaches it.
        if self.smallest(wanted).is_none() {
            self.scored(self.last(), self.whole)?;
            self.most = self.most.max(self.tried.len() + ON_A_RUNG);
            if let Some(mut row) = self.of_whole(wanted) {
                while !row.is_met() && self.left() > 0 && self.attempt(&mut row)? {}
            }
        }
        // Where rungs are far apart, fewer Gaussians lower the PSNR to the target.
        let far = |point: &Point| point.psnr > Some(wanted + FAR);
        if let Some(point) = self.smallest(wanted).filter(far) {
            if self.whole <= SMALL {
                self.most = self.most.max(self.tried.len() + TO_REFINE);
            }
            let mut row = Row::of_rung(point.rung, wanted, self.whole);
            self.tried.values().filter(|known| known.rung == point.rung).for_each(|known| row.add(*known));
            while !row.is_met() && self.left() > 0 && self.attempt(&mut row)? {}
        }
        if let Some(point) = self.smallest(wanted).filter(far) {
            self.halve(point, wanted)?;
        }
        match self.smallest(wanted) {
            Some(point) => Ok(point),
            None => self.scored(self.last(), self.whole),
        }
    }

    /// Adds the row of a rung, as near to the target as its bytes need to be foretold; whether these are fewer than in the others.
    fn is_better(&mut self, rung: usize, wanted: f64, rows: &mut Vec<Row>) -> Result<bool, T::Error> {
        let near = best(rows).map(|row| row.clone()).or_else(|| rows.last().cloned());
        let mut row = near.map_or_else(|| Row::of_rung(rung, wanted, self.whole), |near| near.at(rung));
        // As long as no rung is known to reach the PSNR, all attempts serve to find one.
        let reserved = if best(rows).is_some() { TO_REFINE } else { 0 };
        for _ in 0..ON_A_RUNG {
            if row.nearest().is_some_and(|psnr| psnr <= ROUGH) || self.left() <= reserved || !self.attempt(&mut row)? {
                break;
            }
        }
        rows.push(row);
        Ok(best(rows).is_some_and(|row| row.rung == Some(rung)))
    }

    /// One more attempt in a row; false if none is left to make there.
    fn attempt(&mut self, row: &mut Row) -> Result<bool, T::Error> {
        let Some((rung, gaussians)) = row.next() else { return Ok(false) };
        row.add(self.scored(rung, gaussians)?);
        Ok(true)
    }

    /// Tries smaller files than one that exceeds the target by far, as where PSNR hardly grows or jumps and secants mislead: each halves the
    /// rungs below it, or the Gaussians, whichever served last.
    fn halve(&mut self, mut point: Point, wanted: f64) -> Result<(), T::Error> {
        let mut by_rung = true;
        for _ in 0..TO_HALVE {
            let (coarser, fewer) = (self.coarser(&point, wanted), self.fewer(&point, wanted));
            let next = if by_rung { coarser.or(fewer) } else { fewer.or(coarser) };
            let Some((rung, gaussians)) = next else { break };
            let next = self.scored(rung, gaussians)?;
            if next.psnr < Some(wanted) || next.bytes > point.bytes {
                by_rung = !by_rung;
                continue;
            }
            point = next;
            if point.psnr <= Some(wanted + FAR) {
                break;
            }
        }
        Ok(())
    }

    /// As many Gaussians, halfway down to the rungs that are known to miss the target with them; none if no rung is left between.
    fn coarser(&self, point: &Point, wanted: f64) -> Option<(usize, usize)> {
        let known = self.tried.values().filter(|known| known.gaussians == point.gaussians && known.rung < point.rung);
        let misses = known.filter(|known| known.psnr < Some(wanted));
        let first = misses.map(|known| known.rung + 1).max().unwrap_or(0);
        (first < point.rung).then(|| (first.midpoint(point.rung), point.gaussians))
    }

    /// The same rung, halfway down to the numbers of Gaussians that are known to miss the target at it; none if hardly any are left between.
    fn fewer(&self, point: &Point, wanted: f64) -> Option<(usize, usize)> {
        let known = self.tried.values().filter(|known| known.rung == point.rung && known.gaussians < point.gaussians);
        let misses = known.filter(|known| known.psnr < Some(wanted));
        let first = misses.map(|known| known.gaussians + 1).max().unwrap_or(1);
        let between = point.gaussians.saturating_sub(first);
        (between as f64 >= CLOSE * point.gaussians as f64).then(|| (point.rung, first.midpoint(point.gaussians)))
    }

    /// The whole model at the rungs between two steps, of which one is known to miss the target and the other to reach it.
    fn of_whole(&self, wanted: f64) -> Option<Row> {
        let known: Vec<&Point> = self.tried.values().filter(|point| point.gaussians == self.whole).collect();
        let ends = known.windows(2).find(|ends| ends[0].psnr < Some(wanted) && ends[1].psnr >= Some(wanted))?;
        let mut row = Row::of_whole(self.last(), wanted, self.whole);
        for point in ends {
            row.add(**point);
        }
        Some(row)
    }

    /// The smallest of the files tried that reach the target PSNR.
    fn smallest(&self, wanted: f64) -> Option<Point> {
        self.tried.values().filter(|point| point.psnr >= Some(wanted)).min_by_key(|point| point.bytes).copied()
    }
}

/// The row whose file with the target PSNR is foretold to have the fewest bytes.
fn best(rows: &mut [Row]) -> Option<&mut Row> {
    let bytes = |row: &Row| row.bytes().unwrap_or(f64::INFINITY);
    rows.iter_mut().filter(|row| row.bytes().is_some()).min_by(|a, b| bytes(a).total_cmp(&bytes(b)))
}
