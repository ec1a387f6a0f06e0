//! Files in a row, from the fewest bytes to the most, and the search among them for the one with a PSNR.

use super::psnr::SMALL;
use crate::job::records::Point;
use std::f64::consts::LN_2;

/// Greatest excess in dB over the target PSNR of a file that counts as met, and the one that is aimed at.
const NEAR: f64 = 0.08;
const AIMED: f64 = 0.03;
/// Gain in dB by twice as many Gaussians, and by one rung more, that is assumed until two files are known.
const AN_OCTAVE: f64 = 4.5;
const A_RUNG: f64 = 0.7;
/// Usual PSNR in dB of a third of the Gaussians.
const A_THIRD: f64 = 42.0;
/// Way down in logarithms of the number, or in rungs, that is tried where files hardly differ.
const HIDDEN: f64 = 0.35;
/// Growth of a file from rung to rung.
const GROWTH: f64 = 1.03;
/// Share of the Gaussians of a large model within which another file is not worth an attempt: PSNR differs there by chance.
const NARROW: f64 = 0.005;

/// Files of growing numbers of Gaussians at one rung, or of the whole model at finer and finer rungs.
///
/// PSNR is about linear in the logarithm of the number of Gaussians, and in the rung. The search follows the secant through the two
/// files nearest to the target; where that does not come nearer, as at jumps of the PSNR, or leads out of what is left between two files, it
/// halves that.
pub(super) struct Row {
    /// The rung; none for the whole model.
    pub(super) rung: Option<usize>,
    whole: usize,
    /// The first and the last number: of Gaussians, or of the rung.
    ends: [usize; 2],
    wanted: f64,
    guess: f64,
    /// Gain in dB by twice as many Gaussians, or by one rung more, that is assumed until two files are known: the usual
    /// one, or that near the target at another rung.
    slope: f64,
    known: Vec<Point>,
    /// The last file brought the target no nearer.
    stalled: bool,
}

impl Row {
    /// Files at a rung, of a model of `whole` Gaussians.
    pub(super) fn of_rung(rung: usize, wanted: f64, whole: usize) -> Self {
        let guess = (whole as f64 / 3.0).ln() + (wanted - A_THIRD) / AN_OCTAVE * LN_2;
        let slope = AN_OCTAVE / LN_2;
        Self { rung: Some(rung), whole, ends: [1, whole], wanted, guess, slope, known: Vec::new(), stalled: false }
    }

    /// Files of a whole model of `whole` Gaussians, up to the `last` rung.
    pub(super) fn of_whole(last: usize, wanted: f64, whole: usize) -> Self {
        Self { rung: None, ends: [0, last], slope: A_RUNG, ..Self::of_rung(0, wanted, whole) }
    }

    /// The files at another rung, which are about as good at equal numbers.
    pub(super) fn at(&self, rung: usize) -> Self {
        let fresh = Self::of_rung(rung, self.wanted, self.whole);
        if self.known.is_empty() {
            return fresh;
        }
        let slope = match self.finite()[..] {
            [a, b, ..] if self.rung.is_some() => {
                ((a.1 - b.1) / (a.0 - b.0)).clamp(0.5 * fresh.slope, 2.0 * fresh.slope)
            }
            _ => fresh.slope,
        };
        Self { guess: self.target(), slope, ..fresh }
    }

    /// Adds a file of this row.
    pub(super) fn add(&mut self, point: Point) {
        let before = (self.width(), self.nearest());
        self.known.push(point);
        let halved = |now: f64, before: f64| now <= 0.5 * before;
        let nearer = self.nearest().zip(before.1).is_none_or(|(now, before)| halved(now, before));
        self.stalled = !nearer && self.width().is_some_and(|now| before.0.is_some_and(|before| !halved(now, before)));
    }

    /// Adds a file if it is one of this row that was not known.
    pub(super) fn learn(&mut self, point: &Point) {
        let is_of_row = self.rung.map_or(point.gaussians == self.whole, |rung| point.rung == rung);
        if is_of_row && !self.holds(point) {
            self.add(*point);
        }
    }

    /// Rung and Gaussians of the next file to try; none if all that matter are known.
    pub(super) fn next(&self) -> Option<(usize, usize)> {
        let [low, high] = self.bracket().map(|end| end.map(|point| self.number(&point)));
        let (first, last) = (low.map_or(self.ends[0], |n| n + 1), high.map_or(self.ends[1] + 1, |n| n).checked_sub(1)?);
        if first > last {
            return None;
        }
        let expected = if self.known.is_empty() { self.guess } else { self.target() };
        let at = match low.zip(high).map(|(low, high)| [self.abscissa(low), self.abscissa(high)]) {
            Some([low, high])
                if self.stalled || expected <= low || (expected >= high && high < self.abscissa(self.ends[1])) =>
            {
                0.5 * (low + high)
            }
            Some(_) => expected,
            None if high.is_some_and(|high| expected >= self.abscissa(high)) => self.abscissa(high.unwrap_or(1)) - LN_2,
            None => low.map_or(expected, |low| expected.min(self.abscissa(low) + self.reach())),
        };
        let number = if self.rung.is_some() { at.exp() } else { at };
        let number = (number.round() as usize).clamp(first, last);
        Some(self.rung.map_or((number, self.whole), |rung| (rung, number)))
    }

    /// Rung and Gaussians of a file of half as many Gaussians as the only one known, if that exceeds the target; none otherwise.
    pub(super) fn half(&self) -> Option<(usize, usize)> {
        let [only] = self.known[..] else { return None };
        let exceeds = only.psnr > Some(self.wanted + NEAR) && only.gaussians > 1;
        self.rung.filter(|_| exceeds).map(|rung| (rung, only.gaussians / 2))
    }

    /// The next file to try between the two that enclose the target, of about `most` bytes or fewer: the bytes of the
    /// target PSNR if that grew evenly from one to the other, and the file's rung and Gaussians. None if no such file is
    /// left to try.
    pub(super) fn below(&self, most: f64) -> Option<(f64, (usize, usize))> {
        let [low, high] = self.bracket();
        let (low, high) = low.zip(high).filter(|_| self.is_open())?;
        let place = |point: &Point| (self.abscissa(self.number(point)), (point.bytes as f64).ln());
        let ((from, fewest), (to, many)) = (place(&low), place(&high));
        // Equal pictures promise the fewest bytes.
        let share = ((self.wanted - low.psnr?) / (high.psnr? - low.psnr?)).clamp(0.0, 1.0);
        let promised = (fewest + share * (many - fewest)).exp();
        let at = (from + (to - from) * (most.ln() - fewest) / (many - fewest)).min(to);
        let number = if self.rung.is_some() { at.exp() } else { at };
        let last = number as usize;
        let (rung, gaussians) = self.next()?;
        let next = if self.rung.is_some() { (rung, gaussians.min(last)) } else { (rung.min(last), gaussians) };
        (last > self.number(&low)).then_some((promised, next))
    }

    /// Whether a smaller file of the target PSNR may be left to try.
    pub(super) fn is_open(&self) -> bool {
        let [_, high] = self.bracket();
        let is_met = high.is_some_and(|high| high.psnr <= Some(self.wanted + NEAR));
        let is_narrow = self.rung.is_some() && self.whole > SMALL && self.width().is_some_and(|width| width < NARROW);
        !is_met && !is_narrow && self.next().is_some()
    }

    /// Whether a file was tried in this row.
    pub(super) fn holds(&self, point: &Point) -> bool {
        self.known.contains(point)
    }

    /// The least distance of a file from the target, in dB.
    pub(super) fn nearest(&self) -> Option<f64> {
        self.known.iter().filter_map(|point| Some((point.psnr? - self.wanted).abs())).reduce(f64::min)
    }

    /// The bytes expected of the file with the target PSNR, or known of it; none if even the last file is known to miss it, or none is known.
    pub(super) fn bytes(&self) -> Option<f64> {
        let [low, high] = self.bracket();
        let near = high.or(low)?;
        if high.is_some() && !self.is_open() {
            return Some(near.bytes as f64);
        }
        if high.is_none() && self.number(&near) == self.ends[1] {
            return None;
        }
        let place = |point: &Point| (self.abscissa(self.number(point)), (point.bytes as f64).ln());
        let at = self.target();
        if let Some(((from, fewest), (to, most))) = low.zip(high).map(|(low, high)| (place(&low), place(&high))) {
            let share = ((at - from) / (to - from)).clamp(0.0, 1.0);
            return Some((fewest + share * (most - fewest)).exp());
        }
        let (from, bytes) = place(&near);
        let grown = (at - from) * if self.rung.is_some() { 1.0 } else { GROWTH.ln() };
        // Towards the end that is known, no further.
        Some((bytes + if high.is_some() { grown.min(0.0) } else { grown.max(0.0) }).exp())
    }

    /// The longest way beyond the last file: a curve that bends upwards promises nothing for long.
    fn reach(&self) -> f64 {
        if self.rung.is_some() { 2.0 * LN_2 } else { f64::INFINITY }
    }

    fn number(&self, point: &Point) -> usize {
        if self.rung.is_some() { point.gaussians } else { point.rung }
    }

    fn abscissa(&self, number: usize) -> f64 {
        if self.rung.is_some() { (number as f64).ln() } else { number as f64 }
    }

    /// The first file that reaches the target, and the last one before it that does not.
    fn bracket(&self) -> [Option<Point>; 2] {
        let reaches = |point: &&Point| point.psnr >= Some(self.wanted);
        let high = self.known.iter().filter(reaches).min_by_key(|point| self.number(point)).copied();
        let before = |point: &&Point| !reaches(point) && high.is_none_or(|h| self.number(point) < self.number(&h));
        [self.known.iter().filter(before).max_by_key(|point| self.number(point)).copied(), high]
    }

    /// Length of what is left between two files.
    fn width(&self) -> Option<f64> {
        let [low, high] = self.bracket().map(|end| end.map(|point| self.abscissa(self.number(&point))));
        low.zip(high).map(|(low, high)| high - low)
    }

    /// Abscissa and PSNR of the files whose PSNR is finite, the nearest to the target first.
    fn finite(&self) -> Vec<(f64, f64)> {
        let psnr = |point: &Point| point.psnr.filter(|psnr| psnr.is_finite());
        let mut near: Vec<_> =
            self.known.iter().filter_map(|point| Some((self.abscissa(self.number(point)), psnr(point)?))).collect();
        near.sort_by(|a, b| (a.1 - self.wanted).abs().total_cmp(&(b.1 - self.wanted).abs()));
        near
    }

    /// The abscissa at which the target is expected, by the files nearest to it.
    fn target(&self) -> f64 {
        let usual = self.slope;
        let wanted = self.wanted + AIMED;
        match self.finite()[..] {
            // Equal pictures: far fewer.
            [] => self.known.iter().map(|p| self.abscissa(self.number(p))).fold(f64::INFINITY, f64::min) - 3_f64.ln(),
            [a] => a.0 + (wanted - a.1) / usual,
            [a, b, ..] => {
                let slope = (a.1 - b.1) / (a.0 - b.0);
                if slope >= usual {
                    return a.0 + (wanted - a.1) / slope;
                }
                // Flatter, since rounding adds the same error to all: error = constant + falling part.
                let error = |psnr: f64| 10_f64.powf(-psnr / 10.0);
                let falling = |x: f64| error(usual * (x - a.0));
                let scale = ((error(a.1) - error(b.1)) / (falling(a.0) - falling(b.0))).max(0.0);
                let rest = (error(wanted) - error(a.1)) / scale + 1.0;
                // Where rounding hides how the rest falls, no further down than that may be.
                (a.0 - 10.0 * rest.max(0.0).log10() / usual).max(a.0 - 3.0 * (a.1 - wanted).max(0.0) / usual - HIDDEN)
            }
        }
    }
}
