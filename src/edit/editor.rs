//! A model under edit, with a record of each edit.

use super::transform::transform;
use super::{Edit, Error, Reason, Similarity, rounding};
use crate::gaussians::Gaussians;
use crate::gaussians::order::{reorder, z_order};
use serde::Serialize;
use std::collections::BTreeMap;

/// The record of one edit.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Step {
    /// The edit, as the user requested it.
    pub edit: String,
    /// Gaussians before.
    pub before: usize,
    /// Gaussians after.
    pub after: usize,
    /// Gaussians removed.
    pub removed: usize,
    /// The reason of the removal; `None` for edits that cannot remove.
    pub why: Option<String>,
    /// The removed Gaussians, as first and last number of each range; `None` unless the editor has numbers.
    pub ranges: Option<Vec<[u32; 2]>>,
    /// The ranges of the floaters by rule; `None` for other edits.
    pub rules: Option<BTreeMap<Reason, Vec<[u32; 2]>>>,
}

/// A model under edit. Successive moves ([`Edit::Transform`]) are composed in float64 and wait; they are applied as one
/// before an edit of another kind and wherever the model is asked for. All methods that apply them fail by [`Error::Overflow`], as
/// [`Edit::apply`] does.
#[derive(Clone, Debug)]
pub struct Editor {
    model: Gaussians,
    /// The moves that are not yet applied, as one.
    moves: Option<Similarity>,
    /// The number of each Gaussian in the input.
    numbers: Option<Vec<u32>>,
    steps: Vec<Step>,
}

impl Editor {
    /// Starts with a model. With a number for each Gaussian, n, steps list the removed ones by them.
    pub fn new(model: Gaussians, numbers: Option<Vec<u32>>) -> Self {
        Self { model, moves: None, numbers, steps: Vec::new() }
    }

    /// The current model, after the moves that were waiting.
    pub fn model(&mut self) -> Result<&Gaussians, Error> {
        self.settle()?;
        Ok(&self.model)
    }

    /// The current SH degree.
    pub fn degree(&self) -> usize {
        self.model.degree()
    }

    /// Applies the moves that wait. Returns the step of float32 in the new positions, in world units, if it matters
    /// ([`rounding`]); `None` if no move waited.
    pub fn settle(&mut self) -> Result<Option<f64>, Error> {
        let Some(moves) = self.moves.take() else { return Ok(None) };
        transform(&mut self.model, &moves)?;
        Ok(rounding(&self.model))
    }

    /// The model and the records of all edits.
    pub fn finish(mut self) -> Result<(Gaussians, Vec<Step>), Error> {
        self.settle()?;
        Ok((self.model, self.steps))
    }

    /// Applies an edit, or lets a move wait; `name` is the user's request, `why` the reason of its removals.
    pub fn apply(&mut self, edit: &Edit, name: &str, why: &str) -> Result<&Step, Error> {
        let before = self.model.len();
        if let Edit::Transform(next) = edit {
            self.moves = Some(self.moves.map_or(*next, |first| first.then(next)));
            return Ok(self.account(name, None, before, (None, None)));
        }
        self.settle()?;
        let order = matches!(edit, Edit::MortonOrder).then(|| z_order(&self.model));
        let kept = match &order {
            Some(order) => {
                reorder(&mut self.model, order);
                None
            }
            None => edit.apply(&mut self.model)?,
        };
        if let (Some(order), Some(numbers)) = (&order, &mut self.numbers) {
            *numbers = order.iter().map(|i| numbers[*i as usize]).collect();
        }
        let ranges = kept.as_ref().and_then(|kept| self.renumber(kept));
        Ok(self.account(name, kept.is_some().then(|| why.to_owned()), before, (ranges, None)))
    }

    /// Removes floaters: the Gaussians with a reason (n, or none), which `why` sums up.
    ///
    /// # Panics
    /// If there is not one entry for each Gaussian.
    pub fn remove(&mut self, found: &[Option<Reason>], name: &str, why: &str) -> &Step {
        let before = self.model.len();
        let kept: Vec<bool> = found.iter().map(Option::is_none).collect();
        self.model.compact(&kept);
        let rules = self.numbers.as_ref().map(|numbers| {
            let mut rules: BTreeMap<Reason, Vec<u32>> = BTreeMap::new();
            for (number, reason) in numbers.iter().zip(found).filter_map(|(number, reason)| Some((*number, (*reason)?)))
            {
                rules.entry(reason).or_default().push(number);
            }
            rules.into_iter().map(|(reason, numbers)| (reason, ranges(numbers))).collect()
        });
        let ranges = self.renumber(&kept);
        self.account(name, Some(why.to_owned()), before, (ranges, rules))
    }

    /// Drops the numbers of removed Gaussians and returns them as ranges.
    fn renumber(&mut self, kept: &[bool]) -> Option<Vec<[u32; 2]>> {
        let numbers = self.numbers.as_mut()?;
        let gone = numbers.iter().zip(kept).filter(|(_, kept)| !**kept).map(|(n, _)| *n).collect();
        let mut flags = kept.iter();
        numbers.retain(|_| flags.next().copied().unwrap_or(false));
        Some(ranges(gone))
    }

    fn account(&mut self, edit: &str, why: Option<String>, before: usize, (ranges, rules): Listed) -> &Step {
        let after = self.model.len();
        self.steps.push(Step { edit: edit.to_owned(), before, after, removed: before - after, why, ranges, rules });
        &self.steps[self.steps.len() - 1]
    }
}

/// The removed Gaussians of a step: of all, and by rule.
type Listed = (Option<Vec<[u32; 2]>>, Option<BTreeMap<Reason, Vec<[u32; 2]>>>);

/// Numbers in any order as first and last of each range.
fn ranges(mut numbers: Vec<u32>) -> Vec<[u32; 2]> {
    numbers.sort_unstable();
    let mut runs: Vec<[u32; 2]> = Vec::new();
    for number in numbers {
        match runs.last_mut() {
            Some(run) if run[1] + 1 == number => run[1] = number,
            _ => runs.push([number, number]),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::Region;
    use crate::random::Random;
    use glam::DVec3;

    #[test]
    fn steps_name_what_they_removed_by_first_numbers_also_after_an_order() {
        let mut model = Gaussians::zeroed(10, 0);
        for i in 0..10 {
            model.means[i] = [9.0 - i as f32, 0.0, 0.0];
        }
        let mut editor = Editor::new(model, Some((0..10).collect()));
        let ball = |radius: f64| Edit::Crop { region: Region::Sphere { centre: DVec3::ZERO, radius }, outside: false };
        assert_eq!(editor.apply(&Edit::MortonOrder, "order", "").unwrap().ranges, None);
        let step = editor.apply(&ball(7.5), "ball", "outside the ball").unwrap();
        assert_eq!((step.removed, step.ranges.as_deref()), (2, Some(&[[0, 1]][..])));
        // From 0 on: numbers 9, 8, 7 and so on.
        let mut found = [None; 8];
        (found[1], found[5], found[6]) = (Some(Reason::Alone), Some(Reason::NearOne), Some(Reason::Alone));
        let step = editor.remove(&found, "floaters", "three").clone();
        assert_eq!((step.before, step.after, step.ranges), (8, 5, Some(vec![[3, 4], [8, 8]])));
        let rules = [(Reason::NearOne, vec![[4, 4]]), (Reason::Alone, vec![[3, 3], [8, 8]])];
        assert_eq!(step.rules, Some(rules.into()));
        assert_eq!(editor.finish().unwrap().1.len(), 3);
    }

    #[test]
    fn successive_moves_are_rounded_once() {
        let mut random = Random(9);
        let mut model = Gaussians::zeroed(50, 3);
        for i in 0..50 {
            model.means[i] = [0; 3].map(|_| random.within(0.25, 2.0) as f32);
            model.rotations[i] = [0; 4].map(|_| random.within(0.25, 1.0) as f32);
        }
        model.sh.iter_mut().flatten().for_each(|x| *x = random.within(0.25, 1.0) as f32);
        let shift = |sign: f64| Edit::Transform(Similarity::shift(DVec3::new(1e6, -2e6, 3e5) * sign));
        let turn = |degrees: f64| Edit::Transform(Similarity::turn(DVec3::Z, degrees).unwrap());
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits().abs_diff(b.to_bits()) <= 1);
        for edits in [vec![shift(1.0), turn(30.0), turn(-30.0), shift(-1.0)], vec![turn(10.0); 36]] {
            let mut editor = Editor::new(model.clone(), None);
            for edit in &edits {
                let step = editor.apply(edit, "move", "").unwrap();
                assert_eq!((step.before, step.after, &step.why), (50, 50, &None));
            }
            let (moved, steps) = editor.finish().unwrap();
            assert_eq!((steps.len(), &moved.log_scales), (edits.len(), &model.log_scales));
            assert!(same(moved.means.as_flattened(), model.means.as_flattened()));
            assert!(same(moved.rotations.as_flattened(), model.rotations.as_flattened()));
            assert!(same(&moved.sh.concat(), &model.sh.concat()));
        }
        // An edit of another kind sees the model where it was moved to, as float32 has it there.
        let mut editor = Editor::new(model, None);
        editor.apply(&shift(1.0), "away", "").unwrap();
        assert!(editor.clone().settle().unwrap().is_some_and(|step| step > 0.1));
        assert!(editor.clone().model().unwrap().means.iter().all(|mean| mean[0] > 9e5));
        let there = Region::Sphere { centre: DVec3::new(1e6, -2e6, 3e5), radius: 9.0 };
        let step = editor.apply(&Edit::Crop { region: there, outside: false }, "crop", "outside").unwrap();
        assert_eq!(step.after, 50);
    }
}
