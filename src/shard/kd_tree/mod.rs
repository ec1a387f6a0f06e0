//! Division of unbounded space into cells, for the separate training of a scene's blocks: a kd-tree over weighted
//! positions in contracted space. It uses only +, -, x, / and comparisons in float64, so that every host agrees to the
//! bit.

mod contraction;
mod leaf;

pub use contraction::Contraction;

use leaf::{Leaf, Member};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// One division: `cell` keeps the part below `at` on this axis of contracted space, and a new cell gets the rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Split {
    cell: u32,
    axis: u8,
    at: f64,
}

/// Cells, numbered from 0. Every position belongs to exactly one: faces to the upper side, NaN to cell 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cells {
    contraction: Contraction,
    /// In order of creation: number k creates cell k + 1.
    splits: Vec<Split>,
    /// By cell: length of each side in contracted space, without strays.
    sides: Vec<[f64; 3]>,
}

impl Cells {
    /// At most `count` cells of nearly equal weight: the heaviest is repeatedly halved along its longest side. There
    /// are fewer if positions coincide. Positions that are not finite, and weights that are not positive, do not count.
    ///
    /// # Panics
    /// If there is not one weight per position.
    pub fn new(contraction: Contraction, positions: &[[f32; 3]], weights: &[f32], count: usize) -> Self {
        assert_eq!(positions.len(), weights.len(), "one weight a position");
        let weighed = positions.par_iter().zip(weights).filter_map(|(position, weight)| {
            let counts = *weight > 0.0 && weight.is_finite() && position.iter().all(|x| x.is_finite());
            counts.then(|| Member { place: contraction.of(*position), weight: f64::from(*weight) })
        });
        let mut leaves = vec![Leaf::new(weighed.collect())];
        let mut splits = Vec::new();
        while leaves.len() < count {
            let open = (0..leaves.len()).filter(|i| !leaves[*i].whole);
            let Some(heaviest) = open.reduce(|a, b| if leaves[b].weight > leaves[a].weight { b } else { a }) else {
                break;
            };
            match leaves[heaviest].halve() {
                Some((axis, at, upper)) => {
                    splits.push(Split { cell: heaviest as u32, axis, at });
                    leaves.push(upper);
                }
                None => leaves[heaviest].whole = true,
            }
        }
        Self { contraction, splits, sides: leaves.iter().map(|leaf| leaf.sides).collect() }
    }

    /// Number of cells; at least one.
    pub fn count(&self) -> usize {
        self.splits.len() + 1
    }

    /// The cell that a position in world units belongs to.
    pub fn owner(&self, position: [f32; 3]) -> usize {
        let place = self.contraction.of(position);
        let mut cell = 0;
        for (k, split) in self.splits.iter().enumerate() {
            // NaN is never beyond a face.
            if split.cell as usize == cell && place[usize::from(split.axis) % 3] >= split.at {
                cell = k + 1;
            }
        }
        cell
    }

    /// [`Cells::owner`] of each position.
    pub fn owners(&self, positions: &[[f32; 3]]) -> Vec<u32> {
        positions.par_iter().map(|position| self.owner(*position) as u32).collect()
    }

    /// A cell grown on all sides by `share` of their lengths in contracted space; shares are not negative.
    pub fn grown(&self, cell: usize, share: f64) -> Grown<'_> {
        let margins = self.sides.get(cell).map_or([0.0; 3], |sides| sides.map(|side| share * side));
        Grown { cells: self, cell, faces: self.faces(cell), margins }
    }

    /// The lower and upper faces of a cell in contracted space; infinite where it has no neighbour.
    pub fn faces(&self, cell: usize) -> ([f64; 3], [f64; 3]) {
        let mut boxes = vec![([f64::NEG_INFINITY; 3], [f64::INFINITY; 3])];
        for split in &self.splits {
            let axis = usize::from(split.axis) % 3;
            let whole: ([f64; 3], [f64; 3]) = boxes.get(split.cell as usize).copied().unwrap_or(boxes[0]);
            let mut upper = whole;
            upper.0[axis] = split.at;
            if let Some(lower) = boxes.get_mut(split.cell as usize) {
                lower.1[axis] = split.at;
            }
            boxes.push(upper);
        }
        boxes.get(cell).copied().unwrap_or(boxes[0])
    }
}

/// A cell grown on all sides.
#[derive(Clone, Copy, Debug)]
pub struct Grown<'a> {
    cells: &'a Cells,
    cell: usize,
    /// Lower and upper faces of the cell itself.
    faces: ([f64; 3], [f64; 3]),
    /// Margin beyond each face of an axis.
    margins: [f64; 3],
}

impl Grown<'_> {
    /// Whether it contains a position. It contains every position that the cell owns, whatever its margins.
    pub fn contains(&self, position: [f32; 3]) -> bool {
        if self.cells.owner(position) == self.cell {
            return true;
        }
        let (place, (low, high)) = (self.cells.contraction.of(position), self.faces);
        let inside = |axis: usize| {
            let margin = self.margins[axis];
            low[axis] - margin <= place[axis] && place[axis] < high[axis] + margin
        };
        (0..3).all(inside)
    }

    /// Depth of a position inside it: 0 at the grown faces, 1/2 at the cell's own faces, and 1 as far inside these.
    /// Cells of different sides may have different depths at their common face. Every position that a cell owns has at
    /// least 1/2, even if its sides have no length.
    pub fn depth(&self, position: [f32; 3]) -> f64 {
        if !self.contains(position) {
            return 0.0;
        }
        let (place, (low, high)) = (self.cells.contraction.of(position), self.faces);
        (0..3).fold(1.0, |least, axis| {
            let margin = self.margins[axis];
            let within = (place[axis] - low[axis]).min(high[axis] - place[axis]);
            // NaN positions, and cells without a margin, have no nearest face.
            if margin > 0.0 && within < margin { least.min(0.5 + 0.5 * within / margin) } else { least }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use proptest::prelude::*;

    const INFINITE: f32 = f32::INFINITY;

    fn unit() -> Contraction {
        Contraction { centre: [1.0, -2.0, 0.5], half_side: 3.0 }
    }

    /// Positions around the origin, some of them far away.
    fn cloud(n: usize, seed: u64) -> Vec<[f32; 3]> {
        let mut r = Random(seed);
        let mut one = || {
            let far = if r.unit() < 0.1 { 100.0 } else { 1.0 };
            [8.0, 3.0, 1.0].map(|size| (far * r.within(-size, size)) as f32)
        };
        (0..n).map(|_| one()).collect()
    }

    /// Returns true if a position lies within the faces of a cell.
    fn within(cells: &Cells, cell: usize, position: [f32; 3]) -> bool {
        let place = cells.contraction.of(position);
        let (low, high) = cells.faces(cell);
        if place[0].is_nan() {
            return cell == 0;
        }
        (0..3).all(|axis| low[axis] <= place[axis] && place[axis] < high[axis])
    }

    #[test]
    fn cells_have_nearly_equal_weights() {
        let positions = cloud(20_000, 1);
        let weights: Vec<f32> = (0..positions.len()).map(|i| 1.0 + (i % 7) as f32).collect();
        for count in [1, 2, 3, 5, 16, 33] {
            let cells = Cells::new(unit(), &positions, &weights, count);
            assert_eq!(cells.count(), count);
            let mut sums = vec![0.0; count];
            for (owner, weight) in cells.owners(&positions).iter().zip(&weights) {
                sums[*owner as usize] += f64::from(*weight);
            }
            let all: f64 = weights.iter().map(|w| f64::from(*w)).sum();
            let share = all / count as f64;
            assert!((sums.iter().sum::<f64>() - all).abs() < 1e-6 * all, "each belongs to one");
            assert!(sums.iter().all(|s| (0.45 * share..2.05 * share).contains(s)), "{count}: {sums:?}");
        }
    }

    #[test]
    fn the_longest_side_is_divided_and_strays_do_not_count() {
        let mut positions: Vec<[f32; 3]> =
            (0..1000).map(|i| [(i % 40) as f32 * 0.05, (i / 40) as f32 * 0.01, 0.0]).collect();
        positions[0][2] = 1e6;
        let contraction = Contraction { centre: [0.0; 3], half_side: 3.0 };
        let cells = Cells::new(contraction, &positions, &vec![1.0; 1000], 2);
        assert_eq!(cells.splits[0].axis, 0);
        assert!((cells.splits[0].at - 1.0 / 3.0).abs() < 0.02, "{:?}", cells.splits);
    }

    #[test]
    fn what_cannot_be_divided_stays_whole() {
        let none = Cells::new(unit(), &[], &[], 4);
        assert_eq!((none.count(), none.owner([1.0; 3])), (1, 0));
        let alike = Cells::new(unit(), &[[1.0, 2.0, 3.0]; 9], &[1.0; 9], 4);
        assert_eq!(alike.count(), 1);
        let odd = [[f32::NAN; 3], [INFINITE, 0.0, 0.0], [0.0; 3], [1.0; 3]];
        let two = Cells::new(unit(), &odd, &[1.0, 1.0, 1.0, f32::NAN], 4);
        assert_eq!(two.count(), 1, "one position counts");
        let three = Cells::new(unit(), &[[0.0; 3], [0.0; 3], [1.0; 3], [2.0, 0.0, 0.0]], &[1.0; 4], 9);
        assert_eq!(three.count(), 3, "as many as there are distinct positions");
    }

    /// Neither the order of positions nor the number of threads changes a bit, and neither does a file.
    #[test]
    fn cells_are_the_same_on_every_host() {
        let mut positions = cloud(3000, 2);
        let cells = Cells::new(unit(), &positions, &vec![1.5; 3000], 12);
        positions.reverse();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert!(pool.install(|| Cells::new(unit(), &positions, &vec![1.5; 3000], 12)) == cells);
        let text = serde_json::to_string(&cells).unwrap();
        assert_eq!(serde_json::from_str::<Cells>(&text).unwrap(), cells);
        assert_eq!(serde_json::from_value::<Cells>(serde_json::to_value(&cells).unwrap()).unwrap(), cells);
        // Builds that wrote numbers as their bits named this field otherwise: their files are not misread.
        assert!(serde_json::from_str::<Cells>(&text.replace("half_side", "radius")).is_err());
    }

    #[test]
    fn grown_cells_overlap_by_a_share_of_their_sides() {
        let line: Vec<[f32; 3]> = (0..=100).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let cells = Cells::new(Contraction { centre: [0.0; 3], half_side: 1.0 }, &line, &[1.0; 101], 2);
        let at = cells.splits[0].at as f32;
        assert!((0.49..0.52).contains(&at), "{at}");
        // Sides without strays: 0.45 of each half of 0.5.
        let inside = |cell: usize, x: f32| cells.grown(cell, 0.2).contains([x, 0.0, 0.0]);
        assert!(inside(0, at + 0.08) && !inside(0, at + 0.1) && inside(0, -1e9));
        assert!(inside(1, at - 0.08) && !inside(1, at - 0.1) && inside(1, INFINITE));
        assert!(cells.grown(0, 0.2).contains([f32::NAN; 3]) && !cells.grown(1, 0.2).contains([f32::NAN; 3]));
    }

    #[test]
    fn depths_rise_from_the_grown_face() {
        let line: Vec<[f32; 3]> = (0..=100).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let cells = Cells::new(Contraction { centre: [0.0; 3], half_side: 1.0 }, &line, &[1.0; 101], 2);
        let (at, margin) = (cells.splits[0].at, 0.2 * cells.sides[0][0]);
        let depth = |cell: usize, beyond: f64| cells.grown(cell, 0.2).depth([(at + beyond * margin) as f32, 0.0, 0.0]);
        for (beyond, lower, upper) in
            [(-1.5, 1.0, 0.0), (-0.5, 0.75, 0.25), (0.0, 0.5, 0.5), (0.8, 0.1, 0.9), (1.01, 0.0, 1.0), (9.0, 0.0, 1.0)]
        {
            let [a, b] = [depth(0, beyond), depth(1, beyond)];
            assert!((a - lower).abs() < 0.02 && (b - upper).abs() < 0.02, "{beyond}: {a} {b}");
        }
        assert_eq!([0, 1].map(|cell| cells.grown(cell, 0.2).depth([f32::NAN; 3])), [1.0, 0.0]);
        assert_eq!(Cells::new(unit(), &[], &[], 1).grown(0, 0.2).depth([INFINITE; 3]), 1.0);
    }

    proptest! {
        /// Whatever its bits, a position has exactly one owner, which agrees with the faces and does not change when
        /// cells grow.
        #[test]
        fn every_position_has_exactly_one_owner(
            bits in prop::array::uniform3(any::<u32>()), near in prop::array::uniform3(-4.0_f32..4.0), face in 0_usize..40, seed in 0_u64..50,
        ) {
            let cells = Cells::new(unit(), &cloud(300, seed), &[1.0; 300], 20);
            let split = cells.splits[face % cells.splits.len()];
            // On a face, as closely as float32 permits.
            let mut on_face = near;
            let axis = usize::from(split.axis);
            on_face[axis] = (split.at * 3.0 + unit().centre[axis]) as f32;
            let special = bits.map(|b| [f32::NAN, INFINITE, -INFINITE, 0.0, f32::MAX, f32::MIN_POSITIVE][b as usize % 6]);
            for position in [bits.map(f32::from_bits), near, on_face, special] {
                let owner = cells.owner(position);
                let holders: Vec<usize> = (0..cells.count()).filter(|c| within(&cells, *c, position)).collect();
                prop_assert_eq!(holders, vec![owner]);
                prop_assert!(cells.grown(owner, 0.2).contains(position) && cells.grown(owner, 0.0).contains(position));
                prop_assert_eq!((0..cells.count()).filter(|c| cells.grown(*c, 0.0).contains(position)).count(), 1);
                let depths = (0..cells.count()).map(|c| cells.grown(c, 0.2).depth(position));
                prop_assert!(cells.grown(owner, 0.2).depth(position) >= 0.5 && depths.clone().all(|d| (0.0..=1.0).contains(&d)));
            }
        }
    }
}
