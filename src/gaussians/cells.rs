//! Division of unbounded space into cells, for blocks of a scene that are trained apart: a kd-tree over weighted positions in
//! contracted space. Only +, -, x, / and comparisons in float64, so that every host agrees to the bit.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Coordinates of contracted space are at most this far from its centre.
const REACH: f64 = 2.0;
/// Share of a cell's weight beyond either end of its side: strays do not make a cell long.
const STRAYS: f64 = 0.05;

/// A map of all space into a cube of side 4: the unit cube around `centre`, of half side `radius`, keeps its shape, and the rest
/// of the world lies in the shell around it (as in mip-NeRF 360, with the largest coordinate as the norm).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contraction {
    #[serde(with = "exact3")]
    centre: [f64; 3],
    #[serde(with = "exact")]
    radius: f64,
}

impl Contraction {
    /// Keeps the shape of the cube around the box of these points, such as the cameras' centres. Points that are not finite do not
    /// count; without any, or with equal ones only, the cube is that of half side 1.
    pub fn around(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut finite = points.into_iter().filter(|p| p.is_finite());
        let first = finite.next().unwrap_or(DVec3::ZERO);
        let (low, high) = finite.fold((first, first), |(low, high), p| (low.min(p), high.max(p)));
        let half = 0.5 * (high - low).max_element();
        Self { centre: (low + 0.5 * (high - low)).to_array(), radius: if half > 0.0 { half } else { 1.0 } }
    }

    /// The place of a position in world units, each coordinate within -2..=2; NaN if one of its coordinates is.
    pub fn of(&self, position: [f32; 3]) -> [f64; 3] {
        let p: [f64; 3] = std::array::from_fn(|i| (f64::from(position[i]) - self.centre[i]) / self.radius);
        if p.iter().any(|x| x.is_nan()) {
            return [f64::NAN; 3];
        }
        let most = p.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        if most <= 1.0 {
            return p;
        }
        if most == f64::INFINITY {
            return p.map(|x| if x.is_infinite() { REACH * x.signum() } else { 0.0 });
        }
        let factor = REACH - 1.0 / most;
        p.map(|x| factor * (x / most))
    }
}

/// One division: `cell` keeps what lies below `at` on this axis of contracted space, and a new cell gets the rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Split {
    cell: u32,
    axis: u8,
    #[serde(with = "exact")]
    at: f64,
}

/// Cells, numbered from 0. Every position belongs to exactly one: faces to the upper side, NaN to cell 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cells {
    contraction: Contraction,
    /// In the order of their making: number k makes cell k + 1.
    splits: Vec<Split>,
    /// By cell, the length of each side in contracted space that holds all but strays.
    #[serde(with = "exact_rows")]
    sides: Vec<[f64; 3]>,
}

impl Cells {
    /// At most `count` cells of nearly equal weight: the heaviest is halved, again and again, along its longest side. There are
    /// fewer where positions coincide. Positions that are not finite, and weights that are not positive, do not count.
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

    /// True if a position lies in a cell that is grown on all sides by `share` of their lengths in contracted space. A cell
    /// contains what it owns, whatever the share; shares are not negative.
    pub fn grown_contains(&self, cell: usize, share: f64, position: [f32; 3]) -> bool {
        if self.owner(position) == cell {
            return true;
        }
        let (place, margins) = (self.contraction.of(position), self.margins(cell, share));
        let (low, high) = self.faces(cell);
        (0..3).all(|axis| low[axis] - margins[axis] <= place[axis] && place[axis] < high[axis] + margins[axis])
    }

    /// What a cell that is grown by `share` gains on both ends of each side, in contracted space.
    fn margins(&self, cell: usize, share: f64) -> [f64; 3] {
        self.sides.get(cell).map_or([0.0; 3], |sides| sides.map(|side| share * side))
    }

    /// How deep a position lies in a cell that is grown by `share`, from 0 at the grown faces over 1/2 at the cell's own to 1 as far
    /// within these. Cells of different sides may have different depths at their common face. What a cell owns has at least 1/2,
    /// also where its sides have no length.
    pub fn depth(&self, cell: usize, share: f64, position: [f32; 3]) -> f64 {
        if !self.grown_contains(cell, share, position) {
            return 0.0;
        }
        let (place, margins) = (self.contraction.of(position), self.margins(cell, share));
        let (low, high) = self.faces(cell);
        (0..3).fold(1.0, |least, axis| {
            let margin = margins[axis];
            let within = (place[axis] - low[axis]).min(high[axis] - place[axis]);
            // Positions that are not numbers, and cells without a margin, have no nearest face.
            if margin > 0.0 && within < margin { least.min(0.5 + 0.5 * within / margin) } else { least }
        })
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

/// A position in contracted space, with its weight.
#[derive(Clone, Copy)]
struct Member {
    place: [f64; 3],
    weight: f64,
}

/// A cell under division.
struct Leaf {
    members: Vec<Member>,
    weight: f64,
    sides: [f64; 3],
    /// No face divides it.
    whole: bool,
}

impl Leaf {
    fn new(mut members: Vec<Member>) -> Self {
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

    /// Divides the cell across its longest side into halves of nearly equal weight. It keeps the lower one; returns axis and place
    /// of the face, and the upper one. None if all members coincide.
    fn halve(&mut self) -> Option<(u8, f64, Self)> {
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| self.sides[*b].total_cmp(&self.sides[*a]));
        let (axis, first) = axes.into_iter().find_map(|axis| Some((axis, self.middle(axis)?)))?;
        let upper = self.members.split_off(first);
        let at = upper[0].place[axis];
        *self = Self::new(std::mem::take(&mut self.members));
        Some((axis as u8, at, Self::new(upper)))
    }

    /// Sorts the members along an axis, and finds the first of the upper half: where coordinates differ, nearest to half the weight.
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

/// Sorts along an axis; equal coordinates by the others and by weight, so that sums do not depend on the order before.
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

/// Numbers are stored as the integers that have their bits: text would round them.
mod exact {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
    pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
        value.to_bits().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        u64::deserialize(deserializer).map(f64::from_bits)
    }
}

/// As [`exact`], for three.
mod exact3 {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(values: &[f64; 3], serializer: S) -> Result<S::Ok, S::Error> {
        values.map(f64::to_bits).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
        <[u64; 3]>::deserialize(deserializer).map(|bits| bits.map(f64::from_bits))
    }
}

/// As [`exact3`], for many.
mod exact_rows {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(rows: &[[f64; 3]], serializer: S) -> Result<S::Ok, S::Error> {
        rows.iter().map(|row| row.map(f64::to_bits)).collect::<Vec<_>>().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 3]>, D::Error> {
        Ok(Vec::<[u64; 3]>::deserialize(deserializer)?.into_iter().map(|row| row.map(f64::from_bits)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use proptest::prelude::*;

    const INFINITE: f32 = f32::INFINITY;

    fn unit() -> Contraction {
        Contraction { centre: [1.0, -2.0, 0.5], radius: 3.0 }
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

    /// Whether the faces of a cell say that a position is in it.
    fn within(cells: &Cells, cell: usize, position: [f32; 3]) -> bool {
        let place = cells.contraction.of(position);
        let (low, high) = cells.faces(cell);
        if place[0].is_nan() {
            return cell == 0;
        }
        (0..3).all(|axis| low[axis] <= place[axis] && place[axis] < high[axis])
    }

    #[test]
    fn the_unit_cube_keeps_its_shape_and_infinity_is_two_away() {
        let c = unit();
        assert_eq!(c.of([1.0, -2.0, 0.5]), [0.0; 3]);
        assert_eq!(c.of([4.0, -5.0, 2.0]), [1.0, -1.0, 0.5]);
        // p = (4, 2, 0): 2 - 1/4 along the largest coordinate.
        assert_eq!(c.of([13.0, 4.0, 0.5]), [1.75, 0.875, 0.0]);
        assert_eq!(c.of([INFINITE, -INFINITE, 9.0]), [2.0, -2.0, 0.0]);
        assert!(c.of([f32::NAN, 0.0, 0.0]).iter().all(|x| x.is_nan()));
        let largest = c.of([f32::MAX, -f32::MAX, 0.0]);
        assert!(largest[0] <= 2.0 && largest[1] >= -2.0 && largest[0] > 1.99, "{largest:?}");
    }

    #[test]
    fn the_cube_encloses_the_cameras() {
        let points = [DVec3::new(-1.0, 0.0, 2.0), DVec3::new(5.0, 2.0, 2.0), DVec3::splat(f64::NAN)];
        assert_eq!(Contraction::around(points), Contraction { centre: [2.0, 1.0, 2.0], radius: 3.0 });
        for few in [vec![], vec![DVec3::ONE; 2]] {
            assert_eq!(Contraction::around(few).radius, 1.0);
        }
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
        let contraction = Contraction { centre: [0.0; 3], radius: 3.0 };
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
    }

    #[test]
    fn grown_cells_overlap_by_a_share_of_their_sides() {
        let line: Vec<[f32; 3]> = (0..=100).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let cells = Cells::new(Contraction { centre: [0.0; 3], radius: 1.0 }, &line, &[1.0; 101], 2);
        let at = cells.splits[0].at as f32;
        assert!((0.49..0.52).contains(&at), "{at}");
        // Sides without strays: 0.45 of each half of 0.5.
        let inside = |cell: usize, x: f32| cells.grown_contains(cell, 0.2, [x, 0.0, 0.0]);
        assert!(inside(0, at + 0.08) && !inside(0, at + 0.1) && inside(0, -1e9));
        assert!(inside(1, at - 0.08) && !inside(1, at - 0.1) && inside(1, INFINITE));
        assert!(cells.grown_contains(0, 0.2, [f32::NAN; 3]) && !cells.grown_contains(1, 0.2, [f32::NAN; 3]));
    }

    #[test]
    fn depths_rise_from_the_grown_face() {
        let line: Vec<[f32; 3]> = (0..=100).map(|i| [0.01 * i as f32, 0.0, 0.0]).collect();
        let cells = Cells::new(Contraction { centre: [0.0; 3], radius: 1.0 }, &line, &[1.0; 101], 2);
        let (at, margin) = (cells.splits[0].at, 0.2 * cells.sides[0][0]);
        let depth = |cell: usize, beyond: f64| cells.depth(cell, 0.2, [(at + beyond * margin) as f32, 0.0, 0.0]);
        for (beyond, lower, upper) in
            [(-1.5, 1.0, 0.0), (-0.5, 0.75, 0.25), (0.0, 0.5, 0.5), (0.8, 0.1, 0.9), (1.01, 0.0, 1.0), (9.0, 0.0, 1.0)]
        {
            let [a, b] = [depth(0, beyond), depth(1, beyond)];
            assert!((a - lower).abs() < 0.02 && (b - upper).abs() < 0.02, "{beyond}: {a} {b}");
        }
        assert_eq!([0, 1].map(|cell| cells.depth(cell, 0.2, [f32::NAN; 3])), [1.0, 0.0]);
        assert_eq!(Cells::new(unit(), &[], &[], 1).depth(0, 0.2, [INFINITE; 3]), 1.0);
    }

    proptest! {
        /// Whatever its bits are, a position has one owner, which the faces agree with, and which stays when cells grow.
        #[test]
        fn every_position_has_exactly_one_owner(
            bits in prop::array::uniform3(any::<u32>()), near in prop::array::uniform3(-4.0_f32..4.0), face in 0_usize..40, seed in 0_u64..50,
        ) {
            let cells = Cells::new(unit(), &cloud(300, seed), &[1.0; 300], 20);
            let split = cells.splits[face % cells.splits.len()];
            // On a face, as near as float32 comes to it.
            let mut on_face = near;
            let axis = usize::from(split.axis);
            on_face[axis] = (split.at * 3.0 + unit().centre[axis]) as f32;
            let special = bits.map(|b| [f32::NAN, INFINITE, -INFINITE, 0.0, f32::MAX, f32::MIN_POSITIVE][b as usize % 6]);
            for position in [bits.map(f32::from_bits), near, on_face, special] {
                let owner = cells.owner(position);
                let holders: Vec<usize> = (0..cells.count()).filter(|c| within(&cells, *c, position)).collect();
                prop_assert_eq!(holders, vec![owner]);
                prop_assert!(cells.grown_contains(owner, 0.2, position) && cells.grown_contains(owner, 0.0, position));
                prop_assert_eq!((0..cells.count()).filter(|c| cells.grown_contains(*c, 0.0, position)).count(), 1);
                let depths = (0..cells.count()).map(|c| cells.depth(c, 0.2, position));
                prop_assert!(cells.depth(owner, 0.2, position) >= 0.5 && depths.clone().all(|d| (0.0..=1.0).contains(&d)));
            }
        }
    }
}
