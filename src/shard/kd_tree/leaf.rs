//! A cell during division: its members, and where to halve it.

use rayon::prelude::*;

/// Share of a cell's weight beyond either end of a side: strays do not make a cell long.
const STRAYS: f64 = 0.05;

/// A position in contracted space, with its weight.
#[derive(Clone, Copy)]
pub(super) struct Member {
    pub place: [f64; 3],
    pub weight: f64,
}

/// A cell during division.
pub(super) struct Leaf {
    members: Vec<Member>,
    pub weight: f64,
    /// Length of each side, without strays.
    pub sides: [f64; 3],
    /// True if no face can divide it.
    pub whole: bool,
}

impl Leaf {
    pub fn new(mut members: Vec<Member>) -> Self {
        // Sorted first: a sum depends on its order.
        sort(&mut members, 0);
        let weight = members.iter().map(|m| m.weight).sum();
        let sides = [0, 1, 2].map(|axis| {
            sort(&mut members, axis);
            let reached = |share: f64| {
                let mut passed = 0.0;
                let at = members.iter().position(|m| {
                    passed += m.weight;
                    passed >= share * weight
                });
                members.get(at.unwrap_or(0)).map_or(0.0, |m| m.place[axis])
            };
            reached(1.0 - STRAYS) - reached(STRAYS)
        });
        Self { members, weight, sides, whole: false }
    }

    /// Divides the cell across its longest side into halves of nearly equal weight, and keeps the lower one; returns
    /// axis and position of the face, and the upper half. `None` if all members coincide.
    pub fn halve(&mut self) -> Option<(u8, f64, Self)> {
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| self.sides[*b].total_cmp(&self.sides[*a]));
        let (axis, first) = axes.into_iter().find_map(|axis| Some((axis, self.middle(axis)?)))?;
        let upper = self.members.split_off(first);
        let at = upper[0].place[axis];
        *self = Self::new(std::mem::take(&mut self.members));
        Some((axis as u8, at, Self::new(upper)))
    }

    /// Sorts the members along an axis, and finds the first of the upper half: at the change of coordinate nearest to
    /// half the weight.
    fn middle(&mut self, axis: usize) -> Option<usize> {
        sort(&mut self.members, axis);
        let (mut below, mut best) = (0.0, None);
        for i in 1..self.members.len() {
            below += self.members[i - 1].weight;
            let off = (below - 0.5 * self.weight).abs();
            let differs = self.members[i].place[axis] > self.members[i - 1].place[axis];
            if differs && best.is_none_or(|(least, _)| off < least) {
                best = Some((off, i));
            }
        }
        best.map(|(_, i)| i)
    }
}

/// Sorts along an axis; equal coordinates by the other axes and by weight, so that sums do not depend on the previous
/// order.
fn sort(members: &mut [Member], axis: usize) {
    let key = |m: &Member| [m.place[axis], m.place[(axis + 1) % 3], m.place[(axis + 2) % 3], m.weight];
    members.par_sort_unstable_by(|a, b| {
        key(a)
            .iter()
            .zip(key(b))
            .map(|(a, b)| a.total_cmp(&b))
            .find(|order| order.is_ne())
            .unwrap_or(std::cmp::Ordering::Equal)
    });
}
