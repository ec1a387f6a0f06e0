//! A model under edit, with a record of each edit.

use super::{Edit, Error, Reason};
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

/// A model under edit.
#[derive(Clone, Debug)]
pub struct Editor {
    model: Gaussians,
    /// The number of each Gaussian in the input.
    numbers: Option<Vec<u32>>,
    steps: Vec<Step>,
}

impl Editor {
    /// Starts with a model. With a number for each Gaussian, n, steps list the removed ones by them.
    pub fn new(model: Gaussians, numbers: Option<Vec<u32>>) -> Self {
        Self { model, numbers, steps: Vec::new() }
    }

    /// The current model.
    pub fn model(&self) -> &Gaussians {
        &self.model
    }

    /// The model and the records of all edits.
    pub fn finish(self) -> (Gaussians, Vec<Step>) {
        (self.model, self.steps)
    }

    /// Applies an edit; `name` is the user's request, `why` the reason of its removals.
    pub fn apply(&mut self, edit: &Edit, name: &str, why: &str) -> Result<&Step, Error> {
        let before = self.model.len();
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
        assert_eq!(editor.finish().1.len(), 3);
    }
}
