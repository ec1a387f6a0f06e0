//! Floaters: Gaussians that hang where nothing is, told by what photos show of them.

use crate::gaussians::Gaussians;
use crate::response::Score;
use crate::scene::camera::Camera;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Weight in a pixel, T alpha, from which on a photo sees a Gaussian: a step of eight bits.
const STEP: f32 = 1.0 / 255.0;
/// A Gaussian that photos want gone by this share or more disagrees with them: at 0.5 they are as far from the picture without it.
const GONE: f64 = 0.6;
/// Share of the photos that see it which must be nearer to the picture without it.
const AGREED: f64 = 0.5;
/// How much nearer the photos must be to the pictures without a Gaussian, round by round, by the median change that the removal of a
/// Gaussian makes. The worst go first: what stands behind a floater shares the blame for it until that is gone.
const ROUNDS: [f64; 5] = [64.0, 16.0, 4.0, 1.0, 1.0];
/// A Gaussian is near a camera if its depth is below this share of the photo's median depth.
const NEAR: f32 = 0.25;
/// A Gaussian shows near one camera only if that photo has this share of all that photos show of it.
const ONE: f32 = 0.9;
/// An unseen Gaussian is alone if no seen one is within this share of the photos' median depth.
const ALONE: f64 = 0.05;
/// Without photos, a seen one is alone with fewer seen ones around it.
const COMPANY: usize = 3;

/// Evidence about a Gaussian from photos, or from pictures of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// Sum of its weights T alpha over all pixels of all photos.
    pub shown: f32,
    /// The largest part of that in one photo.
    pub most: f32,
    /// Depth in that photo, by the photo's median depth.
    pub depth: f32,
    /// Sum of the squared changes of pixels if it is removed.
    pub change: f32,
    /// Sum of these changes' products with the residual: by `change`, the share of it that the photos want gone.
    pub along: f32,
    /// Photos that see it.
    pub photos: u32,
    /// Of these, photos that are nearer to the picture without it.
    pub against: u32,
}

impl Sight {
    /// True if the photos that see it want it gone, and come nearer to the pictures by more than `least`.
    fn disagrees(&self, least: f64) -> bool {
        let (change, along) = (f64::from(self.change), f64::from(self.along));
        let agreed = f64::from(self.against) >= AGREED * f64::from(self.photos);
        self.photos > 0 && agreed && along >= GONE * change && 2.0 * along - change > least
    }
}

/// What gives a floater away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The photos that see it want it gone.
    Disagrees,
    /// It shows near one camera only.
    NearOne,
    /// No photo sees it, and nothing seen is near it; or, without photos, hardly anything is near it.
    Alone,
}

/// What a set of photos shows of each Gaussian of a model.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// By Gaussian, n.
    pub sights: Vec<Sight>,
    /// Median depth of each photo, in world units, weighted by what it shows.
    depths: Vec<f64>,
    /// True if photos are compared with pictures; false for pictures of the model itself, which agree with it.
    compared: bool,
}

impl Evidence {
    /// Of no photo; `compared` if there will be photos, and not pictures of the model itself.
    pub fn new(gaussians: usize, compared: bool) -> Self {
        Self { sights: vec![Sight::default(); gaussians], depths: Vec::new(), compared }
    }

    /// Adds a photo: its camera, and its scores alone, n.
    ///
    /// # Panics
    /// If there is not one score for each Gaussian.
    pub fn add(&mut self, model: &Gaussians, camera: &Camera, scores: &[Score]) {
        assert!(scores.len() == self.sights.len() && model.len() == scores.len(), "one score for each Gaussian");
        let forward = camera.rotation.row(2);
        let depth = |i: usize| forward.dot(DVec3::from_array(model.means[i].map(f64::from))) + camera.translation.z;
        let mut shown: Vec<(f32, f32)> = (0..scores.len())
            .into_par_iter()
            .filter(|i| scores[*i].contribution > 0.0)
            .map(|i| (depth(i) as f32, scores[i].contribution))
            .collect();
        let median = weighted_median(&mut shown);
        self.depths.extend(median.map(f64::from));
        let median = median.unwrap_or(1.0);
        self.sights.par_iter_mut().enumerate().for_each(|(i, sight)| {
            let score = &scores[i];
            if score.contribution > sight.most {
                (sight.most, sight.depth) = (score.contribution, depth(i) as f32 / median);
            }
            sight.shown += score.contribution;
            sight.change += score.change;
            sight.along += score.along_residual;
            if score.peak >= STEP {
                sight.photos += 1;
                sight.against += u32::from(score.removal() < 0.0);
            }
        });
    }

    /// Rounds of evidence, each without the floaters of those before, for [`Evidence::disagreeing`].
    pub const ROUNDS: usize = ROUNDS.len();

    /// By Gaussian: true if the photos want it gone, in a round from 0; later rounds are stricter.
    ///
    /// # Panics
    /// If there is no such round.
    pub fn disagreeing(&self, round: usize) -> Vec<bool> {
        let least = ROUNDS[round] * self.typical_change();
        self.sights.par_iter().map(|sight| sight.disagrees(least)).collect()
    }

    /// The median change of the pixels by the removal of a Gaussian that photos see.
    fn typical_change(&self) -> f64 {
        let mut changes: Vec<f32> = self.sights.iter().filter(|s| s.photos > 0).map(|s| s.change).collect();
        changes.par_sort_unstable_by(f32::total_cmp);
        changes.get(changes.len() / 2).copied().map_or(0.0, f64::from)
    }

    /// By Gaussian: what gives it away as a floater, if anything does; as strictly as in the last round.
    ///
    /// # Panics
    /// If the evidence is of another number of Gaussians.
    pub fn floaters(&self, model: &Gaussians) -> Vec<Option<Reason>> {
        if self.depths.is_empty() {
            return vec![None; model.len()];
        }
        let least = ROUNDS[ROUNDS.len() - 1] * self.typical_change();
        let beside = Beside::new(model, &self.sights, ALONE * self.typical());
        let judge = |(i, sight): (usize, &Sight)| {
            let company = || beside.count(model.means[i]);
            if sight.photos == 0 {
                return (company() == 0).then_some(Reason::Alone);
            }
            if !self.compared && company() <= COMPANY {
                return Some(Reason::Alone); // it is in its own company
            }
            if sight.disagrees(least) {
                return Some(Reason::Disagrees);
            }
            let near_one = sight.depth < NEAR && sight.most >= ONE * sight.shown && self.depths.len() > 1;
            near_one.then_some(Reason::NearOne)
        };
        self.sights.par_iter().enumerate().map(judge).collect()
    }

    /// The median of the photos' median depths, in world units; 0 without photos.
    fn typical(&self) -> f64 {
        let mut depths = self.depths.clone();
        depths.sort_unstable_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied().unwrap_or_default()
    }
}

/// The value with half of the weight on either side, of (value, weight).
fn weighted_median(values: &mut [(f32, f32)]) -> Option<f32> {
    values.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| f64::from(v.1)).sum::<f64>();
    let mut sum = 0.0;
    values
        .iter()
        .find(|v| {
            sum += f64::from(v.1);
            sum >= half
        })
        .map(|v| v.0)
}

/// Numbers of Gaussians that photos see, by cell of space.
struct Beside {
    cells: FxHashMap<[i64; 3], usize>,
    edge: f64,
}

impl Beside {
    fn new(model: &Gaussians, sights: &[Sight], edge: f64) -> Self {
        let edge = edge.max(f64::MIN_POSITIVE);
        let mut cells = FxHashMap::default();
        for (mean, _) in model.means.iter().zip(sights).filter(|(_, sight)| sight.photos > 0) {
            *cells.entry(cell(*mean, edge)).or_default() += 1;
        }
        Self { cells, edge }
    }

    /// How many there are in the cell of a point and in its neighbours.
    fn count(&self, point: [f32; 3]) -> usize {
        let [x, y, z] = cell(point, self.edge);
        let near = |at: i64| at.saturating_sub(1)..=at.saturating_add(1);
        let of = |at: [i64; 3]| self.cells.get(&at).copied().unwrap_or_default();
        near(x).flat_map(|x| near(y).flat_map(move |y| near(z).map(move |z| [x, y, z]))).map(of).sum()
    }
}

fn cell(point: [f32; 3], edge: f64) -> [i64; 3] {
    point.map(|x| (f64::from(x) / edge).floor() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(contribution: f32, change: f32, along_residual: f32) -> Score {
        Score { contribution, peak: contribution.min(0.5), change, along_residual, ..Score::default() }
    }

    /// Fifty Gaussians of a scene at depths about 4, and six more.
    fn model(more: [[f32; 3]; 6]) -> Gaussians {
        let mut model = Gaussians::zeroed(56, 0);
        for i in 0..50 {
            let turn = i as f32;
            model.means[i] = [0.3 * turn.cos(), 0.3 * turn.sin(), 0.01 * turn];
        }
        model.means[50..].copy_from_slice(&more);
        model
    }

    fn camera(side: f64) -> Camera {
        Camera::look_at(DVec3::new(side, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.7, 64, 48)
    }

    #[test]
    fn photos_tell_floaters_from_what_they_show() {
        let model = model([
            [0.0, 0.0, -2.0], // wanted gone by all
            [0.1, 0.0, -2.0], // by one of four
            [0.0, 0.0, -3.6], // near one camera, with which it agrees
            [0.0, 0.1, -3.6], // as near, but seen by another one, too
            [0.0, 0.0, 40.0], // unseen, far behind
            [0.1, 0.1, 0.2],  // unseen, within the scene
        ]);
        let mut evidence = Evidence::new(56, true);
        for view in 0..4 {
            let mut scores = vec![score(2.0, 1.0, 0.1); 56];
            scores[50] = score(1.0, 3.0, 2.9);
            scores[51] = score(1.0, 3.0, if view < 1 { 9.0 } else { 1.0 });
            scores[52] = if view == 0 { score(3.0, 1.0, 0.0) } else { Score::default() };
            scores[53] = if view < 2 { score(3.0, 1.0, 0.0) } else { Score::default() };
            scores[54] = Score::default();
            scores[55] = score(0.001, 1e-9, 0.0); // less than a step of eight bits
            evidence.add(&model, &camera(0.1 * f64::from(view)), &scores);
        }
        let found = evidence.floaters(&model);
        assert!(found[..50].iter().all(Option::is_none), "{found:?}");
        let expected = [Some(Reason::Disagrees), None, Some(Reason::NearOne), None, Some(Reason::Alone), None];
        assert_eq!(found[50..], expected);
        assert_eq!((evidence.sights[51].photos, evidence.sights[51].against), (4, 1));
        assert!(
            evidence.disagreeing(4)[50] && !evidence.disagreeing(0)[50],
            "64 times the median change is asked for first"
        );
    }

    /// Pictures of the model agree with it: only what hangs alone, or before one camera, is left to be found.
    #[test]
    fn pictures_tell_what_hangs_alone() {
        let model = model([
            [0.0, 0.0, -2.0], // alone
            [0.0, 3.0, 0.0],  // four together
            [0.0, 3.01, 0.0],
            [0.0, 3.02, 0.0],
            [0.0, 3.03, 0.0],
            [0.1, 0.1, 0.2], // within the scene
        ]);
        let mut evidence = Evidence::new(56, false);
        for view in 0..4 {
            evidence.add(&model, &camera(0.1 * f64::from(view)), &[score(2.0, 1.0, 0.0); 56]);
        }
        let found = evidence.floaters(&model);
        assert!((0..56).all(|i| found[i] == (i == 50).then_some(Reason::Alone)), "{found:?}");
        assert_eq!(Evidence::new(56, false).floaters(&model).iter().flatten().count(), 0, "no picture, no evidence");
    }
}
