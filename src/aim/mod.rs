//! Search for the best file: a number of Gaussians, and a rung of the format's list of settings.
//!
//! Bytes and PSNR usually grow with both. At each rung, a secant search over the number of Gaussians finds the file of the target size
//! or PSNR, or comes near enough to foretell its bytes. The search proceeds to the next rung as long as the file gets better. The whole model
//! is tried first, and at coarser rungs if it takes fewer bytes than merged ones, as a poster of equal Gaussians does.

mod psnr;
mod row;
mod size;
#[cfg(test)]
mod tests;

use crate::job::records::{Aim, Point};
use std::collections::BTreeMap;

/// Files of a model.
pub trait Trials {
    /// The reason why a file cannot be made.
    type Error;

    /// Bytes of the file with this many Gaussians at this rung.
    fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, Self::Error>;

    /// PSNR of a file's pictures in dB.
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

/// Maximum number of attempts, not counting files of one Gaussian.
const MOST: usize = 9;
/// Maximum number of attempts at one rung.
const ON_A_RUNG: usize = 4;

/// A search and its attempts.
pub struct Search<'a, T> {
    trials: &'a mut T,
    /// Gaussians of the whole model.
    whole: usize,
    /// The main rungs; those between them serve to use the last bytes.
    steps: &'a [usize],
    /// Approximate bytes of a file without Gaussians.
    fixed: f64,
    /// Files tried, by rung and Gaussians.
    tried: BTreeMap<(usize, usize), Point>,
    most: usize,
}

impl<'a, T: Trials> Search<'a, T> {
    /// A search over a model of `whole` Gaussians and a ladder with these steps.
    pub fn new(trials: &'a mut T, whole: usize, steps: &'a [usize]) -> Self {
        Self { trials, whole, steps, fixed: 0.0, tried: BTreeMap::new(), most: MOST }
    }

    /// The files tried, in order of rung and Gaussians.
    pub fn tried(&self) -> Vec<Point> {
        self.tried.values().copied().collect()
    }

    /// Finds the best file.
    pub fn find(&mut self, aim: Aim) -> Result<Found, T::Error> {
        let least = self.trials.bytes(0, self.whole.min(1))?;
        self.fixed = least as f64;
        match aim {
            Aim::Bytes(size) if size < least => self.of_one(size, least),
            _ if self.whole == 0 => self.scored(0, 0).map(Found::Best),
            Aim::Bytes(size) => self.by_size(size).map(Found::Best),
            Aim::Psnr(psnr) => self.by_psnr(psnr).map(Found::Best),
        }
    }

    /// The file of one Gaussian at the first rung where it takes at most `size` bytes: finer ones may take fewer than the coarsest, `least`.
    fn of_one(&mut self, size: u64, mut least: u64) -> Result<Found, T::Error> {
        let one = self.whole.min(1);
        for rung in self.steps.iter().copied() {
            least = least.min(self.trials.bytes(rung, one)?);
            if least <= size {
                return self.scored(rung, one).map(Found::Best);
            }
        }
        Ok(Found::TooSmall(least))
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
        if let Some(point) = self.tried.get(&(rung, gaussians)).filter(|point| point.psnr.is_some()) {
            return Ok(*point);
        }
        self.bytes(rung, gaussians)?;
        let psnr = self.trials.psnr(rung, gaussians)?;
        let point = self.tried.get_mut(&(rung, gaussians)).expect("a file that was tried");
        point.psnr = Some(psnr);
        Ok(*point)
    }

    fn left(&self) -> usize {
        self.most.saturating_sub(self.tried.len())
    }

    fn last(&self) -> usize {
        self.steps.last().copied().unwrap_or(0)
    }
}
