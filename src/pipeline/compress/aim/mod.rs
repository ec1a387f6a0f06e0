//! Search for the best file: a number of Gaussians, and a rung of the format's list of settings.
//!
//! Bytes and PSNR grow with both. At each rung, a secant search over the number of Gaussians finds the file of the target size
//! or PSNR. The search proceeds to the next rung as long as the file gets better.

mod psnr;
mod size;

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
        let smallest = self.trials.bytes(0, self.whole.min(1))?;
        self.fixed = smallest as f64;
        match aim {
            Aim::Bytes(size) if size < smallest => Ok(Found::TooSmall(smallest)),
            _ if self.whole == 0 => self.scored(0, 0).map(Found::Best),
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

    fn last(&self) -> usize {
        self.steps.last().copied().unwrap_or(0)
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
        let all: Vec<usize> = (0..7).collect();
        for (rungs, whole) in [(1, 50_000), (4, 50_000), (7, 50_000), (7, 2_000_000)] {
            for size in [9_000_u64, 50_000, 200_000, 400_000, 3_000_000] {
                let mut trials = model(rungs, whole);
                let mut search = Search::new(&mut trials, whole, &all[..rungs]);
                let Ok(Found::Best(best)) = search.find(Aim::Bytes(size)) else { panic!("{size}") };
                let tried = search.tried();
                assert!(best.bytes <= size, "{best:?} of {size}");
                assert!(best.bytes as f64 >= 0.95 * size as f64 || best.gaussians == whole, "{best:?} of {size}");
                assert!(trials.encodes <= MOST, "{} encodes: {tried:?}", trials.encodes);
                // Rungs between the steps fill what the whole model leaves free.
                let fine: Vec<usize> = (0..=48).step_by(8).collect();
                let mut between = Model {
                    bytes: (0..49).map(|r| 8.0 * 1.25_f64.powf(f64::from(r) / 8.0)).collect(),
                    ..model(49, whole)
                };
                let mut search = Search::new(&mut between, whole, &fine);
                let Ok(Found::Best(filled)) = search.find(Aim::Bytes(size)) else { panic!("{size}") };
                let share = filled.bytes as f64 / size as f64;
                assert!(
                    (0.95..=1.0).contains(&share) || filled.rung == 48,
                    "{filled:?} of {size}: {:?}",
                    search.tried()
                );
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
    fn a_given_number_fills_a_size_by_settings_and_fewer_only_where_it_must() {
        let all: Vec<usize> = (0..=48).collect();
        for (rungs, step, whole) in [(49, 8.0, 50_000), (49, 8.0, 40), (4, 1.0, 50_000), (1, 1.0, 50_000)] {
            for (near, share) in [(0, 0.4), (0, 1.01), (rungs / 2, 0.96), (rungs / 2, 1.03), (rungs - 1, 0.7)] {
                let bytes = (0..rungs).map(|r| 8.0 * 1.25_f64.powf(r as f64 / step)).collect();
                let mut trials = Model { bytes, ..model(rungs, whole) };
                let size = (share * trials.bytes(near, whole).unwrap() as f64) as u64;
                trials.encodes = 0;
                let smallest = trials.bytes(0, 1).unwrap();
                let (rung, gaussians) = Search::new(&mut trials, whole, &all[..rungs]).refine(size, near).unwrap();
                let encodes = trials.encodes;
                let bytes = trials.bytes(rung, gaussians).unwrap();
                let told = format!("{rungs} rungs, {whole}: {rung}, {gaussians}: {bytes} of {size}");
                assert!(encodes <= MOST && (bytes <= size || smallest > size), "{encodes} encodes; {told}");
                assert!(bytes as f64 >= 0.95 * size as f64 || rung + 1 == rungs || gaussians == 1, "{told}");
                assert!(gaussians == whole || rungs < 10 || trials.bytes(0, whole).unwrap() > size, "{told}");
            }
        }
    }

    #[test]
    fn a_psnr_is_met_and_sizes_that_are_impossible_are_refused() {
        let all: Vec<usize> = (0..7).collect();
        for wanted in [22.0, 30.0, 35.0, 42.0] {
            let mut trials = model(7, 50_000);
            let mut search = Search::new(&mut trials, 50_000, &all);
            let Ok(Found::Best(best)) = search.find(Aim::Psnr(wanted)) else { panic!("{wanted}") };
            assert!(best.psnr.is_some_and(|p| (p - wanted).abs() < 0.1), "{best:?} for {wanted}: {:?}", search.tried());
        }
        for aim in [Aim::Psnr(30.0), Aim::Bytes(9000)] {
            let mut trials = model(7, 0);
            let Ok(Found::Best(best)) = Search::new(&mut trials, 0, &all).find(aim) else { panic!() };
            assert!(best.gaussians == 0, "of no Gaussian: {best:?}");
        }
        let mut trials = model(7, 50_000);
        assert_eq!(Search::new(&mut trials, 50_000, &all).find(Aim::Bytes(4000)), Ok(Found::TooSmall(4008)));
        let mut trials = model(7, 50_000);
        let Ok(Found::Best(best)) = Search::new(&mut trials, 50_000, &all).find(Aim::Psnr(99.0)) else { panic!() };
        assert_eq!((best.rung, best.gaussians), (6, 50_000), "the finest file of the whole model is the best there is");
        let mut trials = model(7, 50_000);
        let Ok(Found::Best(best)) = Search::new(&mut trials, 50_000, &all).find(Aim::Psnr(-50.0)) else { panic!() };
        assert_eq!((best.rung, best.gaussians), (0, 1), "one Gaussian has more than that");
    }
}
