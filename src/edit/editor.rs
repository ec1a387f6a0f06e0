//! A model under edit, with a record of each edit.

use super::{Edit, Error};
use crate::gaussians::Gaussians;
use serde::Serialize;

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
    /// The removed Gaussians, as first and last index of each range in the concatenated input models; `None` unless the editor
    /// is `numbered`.
    pub ranges: Option<Vec<[u32; 2]>>,
}

/// A model under edit.
#[derive(Clone, Debug)]
pub struct Editor {
    model: Gaussians,
    /// The initial index of each Gaussian.
    numbers: Option<Vec<u32>>,
    steps: Vec<Step>,
}

impl Editor {
    /// Starts with a model; `numbered` if steps are to list the removed Gaussians.
    pub fn new(model: Gaussians, numbered: bool) -> Self {
        let numbers = numbered.then(|| (0..model.len() as u32).collect());
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
        let order = matches!(edit, Edit::MortonOrder).then(|| super::order::morton(&self.model.means));
        let kept = match &order {
            Some(order) => {
                super::order::reorder(&mut self.model, order);
                None
            }
            None => edit.apply(&mut self.model)?,
        };
        if let (Some(order), Some(numbers)) = (&order, &mut self.numbers) {
            *numbers = order.iter().map(|i| numbers[*i as usize]).collect();
        }
        let ranges = kept.as_ref().and_then(|kept| self.renumber(kept));
        Ok(self.account(name, kept.is_some().then(|| why.to_owned()), before, ranges))
    }

    /// Keeps the Gaussians whose flag is true (n flags), for the reason `why`.
    ///
    /// # Panics If the number of flags is not that of the Gaussians.
    pub fn keep(&mut self, kept: &[bool], name: &str, why: &str) -> &Step {
        let before = self.model.len();
        self.model.compact(kept);
        let ranges = self.renumber(kept);
        self.account(name, Some(why.to_owned()), before, ranges)
    }

    /// Drops the indices of removed Gaussians and returns them as ranges.
    fn renumber(&mut self, kept: &[bool]) -> Option<Vec<[u32; 2]>> {
        let numbers = self.numbers.as_mut()?;
        let mut gone: Vec<u32> = numbers.iter().zip(kept).filter(|(_, kept)| !**kept).map(|(n, _)| *n).collect();
        gone.sort_unstable();
        let mut flags = kept.iter();
        numbers.retain(|_| flags.next().copied().unwrap_or(false));
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for number in gone {
            match runs.last_mut() {
                Some(run) if run[1] + 1 == number => run[1] = number,
                _ => runs.push([number, number]),
            }
        }
        Some(runs)
    }

    fn account(&mut self, edit: &str, why: Option<String>, before: usize, ranges: Option<Vec<[u32; 2]>>) -> &Step {
        let after = self.model.len();
        self.steps.push(Step { edit: edit.to_owned(), before, after, removed: before - after, why, ranges });
        &self.steps[self.steps.len() - 1]
    }
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
        let mut editor = Editor::new(model, true);
        let ball = |radius: f64| Edit::Crop { region: Region::Sphere { centre: DVec3::ZERO, radius }, outside: false };
        assert_eq!(editor.apply(&Edit::MortonOrder, "order", "").unwrap().ranges, None);
        let step = editor.apply(&ball(7.5), "ball", "outside the ball").unwrap();
        assert_eq!((step.removed, step.ranges.as_deref()), (2, Some(&[[0, 1]][..])));
        // From 0 on: numbers 9, 8, 7 and so on.
        let kept = [true, false, true, true, true, false, true, true];
        let step = editor.keep(&kept, "hand", "by hand").clone();
        assert_eq!((step.before, step.after, step.ranges), (8, 6, Some(vec![[4, 4], [8, 8]])));
        assert_eq!(editor.finish().1.len(), 3);
    }
}
