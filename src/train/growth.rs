//! Growth to a planned number of Gaussians: selects the ones that each density step halves. The thresholds of the 3DGS
//! reference leave the number open, and its steps are too few in short runs.

use crate::effects::geometry::LOOKS;
use crate::random;
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::{Deserialize, Serialize};

/// Iterations that count in any run, however few its photos.
const LEAST_TAUGHT: f64 = 1000.0;

/// Growth to a planned number, as written to `config.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Growth {
    /// Final number of Gaussians; if absent, derived from the photos and the length of the run, see
    /// [`Growth::by_photos`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaussians: Option<usize>,
    /// Least final number where it is derived.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least: Option<usize>,
    /// Least number of density steps, in short runs.
    pub steps: u32,
    /// True if gradients count by their size in each tile, so that tiles do not cancel.
    pub absolute: bool,
    /// True if a Gaussian's chance is proportional to its gradients; otherwise those with the greatest are halved.
    pub sampled: bool,
}

impl Default for Growth {
    fn default() -> Self {
        Self { gaussians: None, least: None, steps: 15, absolute: true, sampled: true }
    }
}

impl Growth {
    /// The number for a run of `iterations` on photos with these numbers of pixels: the geometric mean of all pixels and of
    /// the iterations. Both limit what can be learnt: a picture holds no more detail than it has pixels, and each Gaussian
    /// needs its steps. Of the steps on n photos, only [`LOOKS`] n² count: more teach nothing new.
    /// docs/decisions.md (50, 146) has the figures.
    pub fn by_photos(pixels: &[u64], iterations: u32) -> usize {
        let all: u64 = pixels.iter().sum();
        (all as f64 * Self::taught(pixels.len(), iterations)).sqrt() as usize
    }

    /// The iterations that count towards the number, of a run of `iterations` on `photos` photos.
    fn taught(photos: usize, iterations: u32) -> f64 {
        let iterations = f64::from(iterations);
        (LOOKS * (photos.max(1) as f64).powi(2)).max(LEAST_TAUGHT).min(iterations)
    }

    /// A note for people if few photos limit the number.
    pub fn limit(self, pixels: &[u64], iterations: u32) -> Option<String> {
        let (taught, photos) = (Self::taught(pixels.len(), iterations), pixels.len());
        let planned = Self::by_photos(pixels, iterations);
        let limited = self.gaussians.is_none() && Some(planned) > self.least && taught < f64::from(iterations);
        limited.then(|| {
            format!(
                "the photos ({photos}) are few for {iterations} iterations; growth ends at {planned} Gaussians, the number for {taught:.0} iterations, and a model with more does not grow",
            )
        })
    }

    /// The same plan with its number, derived from the photos' numbers of pixels if it has none.
    #[must_use]
    pub fn for_photos(self, pixels: &[u64], iterations: u32) -> Self {
        let planned = || Some(Self::by_photos(pixels, iterations)).max(self.least);
        Self { gaussians: self.gaussians.or_else(planned), ..self }
    }

    /// Marks which `count` of the candidates are halved. `growth` holds each Gaussian's sum of gradients and number of
    /// views; a candidate is a Gaussian that `candidate` accepts and that has a gradient.
    pub fn choose(
        &self,
        growth: &[[f32; 2]],
        count: usize,
        key: [u32; 2],
        candidate: impl Fn(usize) -> bool + Sync,
    ) -> Vec<bool> {
        let key = key.map(u64::from);
        let mut weighed: Vec<(f64, usize)> = (0..growth.len())
            .into_par_iter()
            .filter(|i| candidate(*i))
            .filter_map(|i| {
                let [sum, views] = growth[i].map(f64::from);
                let grows = sum.is_finite() && sum > 0.0;
                // The smallest of exponential variables with these rates: a sample without replacement (Efraimidis,
                // Spirakis).
                let chance = || -(1.0 - random::uniform(&[key[0], key[1], i as u64])).ln() / sum;
                grows.then(|| (if self.sampled { chance() } else { -sum / views.max(1.0) }, i))
            })
            .collect();
        let mut halved = vec![false; growth.len()];
        if count < weighed.len() {
            weighed.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        weighed.iter().take(count).for_each(|(_, i)| halved[*i] = true);
        halved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: Growth = Growth { gaussians: Some(10_000), least: None, steps: 15, absolute: true, sampled: true };

    /// Iterations count up to 4.5 times the square of the number of photos, and up to 1,000 in any run.
    #[test]
    fn few_photos_teach_no_more_in_longer_runs() {
        let number = |photos: usize, iterations: u32| Growth::by_photos(&vec![10_000; photos], iterations);
        assert_eq!([1000, 1800, 7000, 30_000].map(|i| number(20, i)), [14_142, 18_973, 18_973, 18_973]);
        assert_eq!([7000, 30_000].map(|i| number(100, i)), [83_666, 173_205]);
        assert_eq!([60, 1000, 30_000].map(|i| number(1, i)), [774, 3162, 3162]);
        assert_eq!(number(0, 1000), 0);
        let plan = Growth::default();
        let note = plan.limit(&[10_000; 20], 7000).unwrap();
        assert!(
            note.contains("(20)") && note.contains("18973 Gaussians") && note.contains("1800 iterations"),
            "{note}"
        );
        assert_eq!(plan.limit(&[10_000; 20], 1800), None);
        let most = |least: usize| Growth { least: Some(least), ..plan };
        assert_eq!([18_972, 18_973].map(|n| most(n).limit(&[10_000; 20], 7000).is_some()), [true, false]);
        assert_eq!([9, 20_000].map(|n| most(n).for_photos(&[10_000; 20], 7000).gaussians), [18_973, 20_000].map(Some));
        assert_eq!(Growth { gaussians: Some(9), ..plan }.limit(&[10_000; 20], 7000), None);
    }

    #[test]
    fn the_greatest_gradients_or_a_fair_sample() {
        let growth: Vec<[f32; 2]> = (0..100).map(|i| [((i * 37) % 100) as f32, 1.0]).collect();
        let top = Growth { sampled: false, ..PLAN };
        let chosen = |plan: Growth, key: u32| plan.choose(&growth, 10, [key, 7], |i| i != 97);
        // 97 * 37 = 89 modulo 100, below the ten greatest.
        let greatest = chosen(top, 1);
        assert!((0..100).all(|i| greatest[i] == ((i * 37) % 100 >= 90)));
        assert_eq!(chosen(PLAN, 1), chosen(PLAN, 1));
        assert_ne!(chosen(PLAN, 1), chosen(PLAN, 2));
        let mut times = [0_u32; 100];
        for key in 0..2000 {
            let halved = chosen(PLAN, key);
            assert!(halved.iter().filter(|h| **h).count() == 10 && !halved[97] && !halved[0]);
            times.iter_mut().zip(&halved).for_each(|(t, h)| *t += u32::from(*h));
        }
        // About 2000 * 10 * i / 4861 for gradient i; four standard errors.
        let of = |gradient: usize| times[(0..100).position(|i| (i * 37) % 100 == gradient).unwrap()];
        assert!((150..270).contains(&of(50)) && (10..80).contains(&of(10)), "{} {}", of(50), of(10));
    }

    /// Equal gradients, NaN gradients, and more room than candidates.
    #[test]
    fn hard_choices() {
        let count = |growth: &[[f32; 2]], count: usize| {
            [true, false].map(|sampled| {
                let halved = Growth { sampled, ..PLAN }.choose(growth, count, [1, 2], |_| true);
                (0..growth.len()).filter(|i| halved[*i]).collect::<Vec<_>>()
            })
        };
        let odd = [[f32::NAN, 1.0], [f32::INFINITY, 1.0], [0.0, 0.0], [-1.0, 1.0], [2.0, 2.0], [9.0, 10.0]];
        assert_eq!(count(&odd, 9), [[4, 5]; 2].map(Vec::from));
        assert!(count(&odd, 0).iter().all(Vec::is_empty));
        let equal = count(&[[1.0, 1.0]; 1000], 300);
        assert!(equal[0].len() == 300 && equal[1] == (0..300).collect::<Vec<_>>());
    }
}
