//! Floaters: detection of Gaussians in empty space by their appearance in photos.

use crate::gaussians::{Gaussians, opacity};
use crate::response::Score;
use crate::scene::camera::Camera;
use crate::scene::weighted_quantile;
use crate::wording::counted;
use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use serde::Serialize;

/// Minimum weight in a pixel, T alpha, for a photo to see a Gaussian: a step of eight bits.
const STEP: f32 = 1.0 / 255.0;
/// Minimum share of a Gaussian's change that reduces the residual, for photos to disagree with it. At 0.5 the error without it
/// is the same.
const GONE: f64 = 0.6;
/// Minimum share of the photos that see it whose error is smaller without it.
const AGREED: f64 = 0.5;
/// Minimum gain by a Gaussian's removal in each round: in median changes of all removals, times the square of its distance to
/// others. The worst are removed first, because Gaussians behind a floater have a residual until it is removed.
const ROUNDS: [f64; 6] = [4096.0, 1024.0, 256.0, 64.0, 16.0, 4.0];
/// Distance from which a removal's gain is weighted by it: needles and fog have neighbours all along, and may spoil every photo.
const AMID: f64 = 0.125;
/// Minimum distance to others, in its own longest axis, of an isolated Gaussian that photos do not need.
const ALONE: f64 = 2.5;
/// Minimum product of such a Gaussian's distance and opacity: faint Gaussians are not floaters.
const SOLID: f64 = 1.4;
/// Minimum distance of such a Gaussian, in the largest axis among it and its three neighbours: a Gaussian hidden among
/// larger ones is not isolated.
const CLEAR: f64 = 1.5;
/// Distance of such a Gaussian, in its own longest axis, from which larger ones do not hide it: far behind a scene, small
/// floaters have large neighbours.
const FAR: f64 = 10.0;
/// Minimum distance to others without photos, in the largest axis among a Gaussian and these others, times a root of
/// the change that it makes. An isolated Gaussian is a floater if pictures show it.
const LONELY: f64 = 10.0;
/// Degree of this root: with the seventh to the tenth, planted floaters and models were told apart equally well
/// (docs/edit.md).
const ROOT: f64 = 8.0;
/// Largest loss of the photos by the removal of a Gaussian that they do not need, in median changes.
const FREE: f64 = 0.2;
/// A Gaussian is near a camera if its depth is below this share of the photo's median depth.
const NEAR: f32 = 0.25;
/// Minimum share of a Gaussian's contribution in one photo, for it to be near that camera only.
const ONE: f32 = 0.9;

/// Share of a model above which floaters by photos are surprising: of trained models they were 1.2 % at most.
const MANY: f64 = 0.05;

/// True if photos contradict far more of `all` Gaussians than usual.
pub fn are_many_floaters(floaters: usize, all: usize) -> bool {
    floaters as f64 > MANY * all as f64
}

/// A warning if surprisingly many Gaussians are floaters, by photos or by pictures of the model.
pub fn floater_warning(floaters: usize, all: usize, by_photos: bool) -> Option<String> {
    let (by, check) = if by_photos {
        (
            "these photos",
            "does the model lie where the photos were taken, and was it trained on pictures of this size (--resolution)?",
        )
    } else {
        ("pictures of the model", "check the result, or give the photos (--scene)")
    };
    are_many_floaters(floaters, all).then(|| {
        format!("{floaters} of {} are floaters by {by}, far more than usual: {check}", counted(all, "Gaussian"))
    })
}

/// Evidence about a Gaussian from photos, or from pictures of the model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// Sum of its weights T alpha over all pixels of all photos.
    pub shown: f32,
    /// The largest share of this sum in one photo.
    pub most: f32,
    /// Depth in that photo, relative to the photo's median depth.
    pub depth: f32,
    /// Sum of the squared changes of pixels if it is removed.
    pub change: f32,
    /// Sum of the products of these changes with the residual.
    pub along: f32,
    /// Photos that see it.
    pub photos: u32,
    /// Photos among these with a smaller error without it.
    pub against: u32,
}

impl Sight {
    /// True if the photos that see it disagree with it.
    fn disagrees(&self) -> bool {
        let agreed = f64::from(self.against) >= AGREED * f64::from(self.photos);
        self.photos > 0 && agreed && f64::from(self.along) >= GONE * f64::from(self.change)
    }

    /// Increase of the squared error by its removal; negative if the error falls.
    fn cost(&self) -> f64 {
        f64::from(self.change) - 2.0 * f64::from(self.along)
    }

    /// Decrease of the squared error by its removal, times the square of its distance to others.
    fn blame(&self, distance: f64) -> f64 {
        -self.cost() * distance.max(AMID).powi(2)
    }
}

/// The rule by which a Gaussian is a floater.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The photos that see it disagree with it.
    #[serde(rename = "disagree")]
    Disagrees,
    /// It is close to a single camera.
    NearOne,
    /// No photo needs it (if there are photos), and it is isolated.
    Alone,
}

/// Evidence of a set of photos on each Gaussian of a model.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// Evidence on each Gaussian, n.
    pub sights: Vec<Sight>,
    /// Photos added.
    photos: usize,
    /// True if photos are compared with pictures; false for pictures of the model itself, which agree with it.
    compared: bool,
}

impl Evidence {
    /// Evidence of no photo yet; `compared` if photos will be added, and not pictures of the model itself.
    pub fn new(gaussians: usize, compared: bool) -> Self {
        Self { sights: vec![Sight::default(); gaussians], photos: 0, compared }
    }

    /// Adds a photo: its camera, and its scores alone, n.
    ///
    /// # Panics
    /// If there is not one score for each Gaussian.
    pub fn add(&mut self, model: &Gaussians, camera: &Camera, scores: &[Score]) {
        assert!(scores.len() == self.sights.len() && model.len() == scores.len(), "one score for each Gaussian");
        let forward = camera.rotation.row(2);
        let depth = |i: usize| forward.dot(DVec3::from_array(model.means[i].map(f64::from))) + camera.translation.z;
        let mut shown: Vec<(f32, f64)> = (0..scores.len())
            .into_par_iter()
            .filter(|i| scores[*i].contribution > 0.0)
            .map(|i| (depth(i) as f32, f64::from(scores[i].contribution)))
            .collect();
        let Some(median) = weighted_quantile(&mut shown, 0.5) else { return };
        self.photos += 1;
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

    /// Returns true for each Gaussian with which the photos disagree in this round, counted from 0; n values.
    ///
    /// # Panics
    /// If there is no such round, or the evidence is of another number of Gaussians.
    pub fn disagreeing(&self, model: &Gaussians, round: usize) -> Vec<bool> {
        let least = ROUNDS[round] * self.typical_change();
        let neighbours = Neighbours::new(model, &self.sights);
        let judge = |(i, sight): (usize, &Sight)| sight.disagrees() && sight.blame(neighbours.distances(i).0) > least;
        self.sights.par_iter().enumerate().map(judge).collect()
    }

    /// The median change of the pixels by the removal of a Gaussian that photos see.
    fn typical_change(&self) -> f64 {
        let mut changes: Vec<f32> = self.sights.iter().filter(|s| s.photos > 0).map(|s| s.change).collect();
        changes.par_sort_unstable_by(f32::total_cmp);
        changes.get(changes.len() / 2).copied().map_or(0.0, f64::from)
    }

    /// Returns the reason why each Gaussian is a floater, as strictly as in the last round; n values, `None` for
    /// Gaussians that are not.
    ///
    /// # Panics
    /// If the evidence is of another number of Gaussians.
    pub fn floaters(&self, model: &Gaussians) -> Vec<Option<Reason>> {
        if self.photos == 0 {
            return vec![None; model.len()];
        }
        let typical = self.typical_change();
        let least = ROUNDS[ROUNDS.len() - 1] * typical;
        let neighbours = Neighbours::new(model, &self.sights);
        let judge = |(i, sight): (usize, &Sight)| {
            let (distance, apart) = neighbours.distances(i);
            if sight.disagrees() && sight.blame(distance) > least {
                return Some(Reason::Disagrees);
            }
            let alone = if self.compared {
                let solid = distance * opacity(model.opacity_logits[i]);
                let clear = apart >= CLEAR || distance >= FAR;
                sight.cost() <= FREE * typical && distance >= ALONE && solid >= SOLID && clear
            } else {
                let change = if typical > 0.0 { f64::from(sight.change) / typical } else { 0.0 };
                apart * (1.0 + change).powf(1.0 / ROOT) >= LONELY
            };
            if alone {
                return Some(Reason::Alone);
            }
            let near_one = sight.depth < NEAR && sight.most >= ONE * sight.shown && sight.photos > 0 && self.photos > 1;
            near_one.then_some(Reason::NearOne)
        };
        self.sights.par_iter().enumerate().map(judge).collect()
    }
}

/// Neighbours of Gaussians: those that photos see.
struct Neighbours<'a> {
    model: &'a Gaussians,
    tree: RTree<GeomWithData<[f32; 3], usize>>,
}

impl<'a> Neighbours<'a> {
    fn new(model: &'a Gaussians, sights: &[Sight]) -> Self {
        // The tree cannot order NaN.
        let seen = |i: &usize| sights[*i].photos > 0 && model.means[*i].iter().all(|x| x.is_finite());
        let all = (0..model.len()).filter(seen).map(|i| GeomWithData::new(model.means[i], i));
        Self { model, tree: RTree::bulk_load(all.collect()) }
    }

    /// Distances of a Gaussian from others: the distance of its third neighbour divided by the standard deviation of its longest
    /// axis, and by the longest axis of all four; 0 without such a neighbour or with a mean that is not finite.
    fn distances(&self, i: usize) -> (f64, f64) {
        if !self.model.means[i].iter().all(|x| x.is_finite()) {
            return (0.0, 0.0); // such a distance has no order either
        }
        let longest = |i: usize| self.model.log_scales[i].iter().fold(f32::NEG_INFINITY, |a, s| a.max(*s));
        let near = self.tree.nearest_neighbor_iter_with_distance_2(self.model.means[i]);
        let near: Vec<_> = near.filter(|(other, _)| other.data != i).take(3).collect();
        let [_, _, (_, squared)] = near[..] else { return (0.0, 0.0) };
        let of_all = near.iter().fold(longest(i), |a, (other, _)| a.max(longest(other.data)));
        let third = f64::from(squared).sqrt();
        (third / f64::from(longest(i)).exp(), third / f64::from(of_all).exp())
    }
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
        model.log_scales.fill([0.1_f32.ln(); 3]);
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
            [0.3, 0.0, 0.01], // by one of four, in company
            [0.0, 0.0, -3.6], // near one camera, with which it agrees
            [0.0, 0.1, -3.6], // as near, but another one needs it, too
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
        assert!(evidence.disagreeing(&model, 3)[50] && !evidence.disagreeing(&model, 0)[50], "more is asked for first");
    }

    /// Large Gaussians hide a small one among them, except if it is far smaller than its distance to them.
    #[test]
    fn large_neighbours_hide_what_is_not_far_from_them() {
        let found = |size: f32| {
            let mut model = model([
                [0.0, 0.0, 40.0], // small, and unseen
                [0.5, 0.0, 40.0], // large
                [-0.5, 0.0, 40.0],
                [0.0, 0.5, 40.0],
                [0.1, 0.1, 0.2], // within the scene
                [0.2, 0.1, 0.2],
            ]);
            model.log_scales[50] = [size.ln(); 3];
            model.log_scales[51..54].fill([0.0; 3]);
            let mut scores = [score(2.0, 1.0, 0.1); 56];
            scores[50] = Score::default();
            let mut evidence = Evidence::new(56, true);
            (0..4).for_each(|view| evidence.add(&model, &camera(0.1 * f64::from(view)), &scores));
            let found = evidence.floaters(&model);
            assert!((0..56).all(|i| i == 50 || found[i].is_none()), "{found:?}");
            found[50]
        };
        assert_eq!([found(0.1), found(0.01)], [None, Some(Reason::Alone)]);
    }

    /// Pictures of the model agree with it: only what hangs alone, or before one camera, is left to be found.
    #[test]
    fn pictures_tell_what_hangs_alone() {
        let found = |size: f32, change: f32| {
            let mut model = model([
                [0.0, 0.0, -2.0], // alone
                [0.0, 3.0, 0.0],  // four together
                [0.0, 3.01, 0.0],
                [0.0, 3.02, 0.0],
                [0.0, 3.03, 0.0],
                [0.1, 0.1, 0.2], // within the scene
            ]);
            model.log_scales.fill([size.ln(); 3]);
            model.log_scales[50] = [0.1_f32.ln(); 3];
            let mut scores = [score(2.0, 1.0, 0.0); 56];
            scores[50].change = change;
            let mut evidence = Evidence::new(56, false);
            (0..4).for_each(|view| evidence.add(&model, &camera(0.1 * f64::from(view)), &scores));
            let found = evidence.floaters(&model);
            assert!((0..56).all(|i| i == 50 || found[i].is_none()), "{found:?}");
            found[50]
        };
        // The neighbours' size counts as its own does, and so does what it changes.
        assert_eq!(
            [found(0.1, 1.0), found(0.3, 1.0), found(0.3, 100.0)],
            [Some(Reason::Alone), None, Some(Reason::Alone)]
        );
        let none = Evidence::new(56, false).floaters(&model([[0.0; 3]; 6]));
        assert_eq!(none.iter().flatten().count(), 0, "no picture, no evidence");
    }

    /// A Gaussian whose mean is no number has no neighbours, and stays.
    #[test]
    fn means_that_are_no_numbers_are_no_floaters() {
        let bad = [[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0], [0.0, f32::NEG_INFINITY, 0.0]];
        let model = model([bad[0], bad[1], bad[2], [0.0; 3], [0.0; 3], [0.0; 3]]);
        let mut evidence = Evidence::new(56, true);
        for view in 0..2 {
            evidence.add(&model, &camera(0.1 * f64::from(view)), &[score(2.0, 1.0, 0.9); 56]);
        }
        let found = evidence.floaters(&model);
        assert!(found[50..53].iter().all(|reason| *reason != Some(Reason::Alone)), "{found:?}");
    }
}
