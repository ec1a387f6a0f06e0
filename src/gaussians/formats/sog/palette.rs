//! A palette of vectors by k-means.
//!
//! Cells are halved along their widest axis, the one with the greatest error first, until there are as many as entries; then entries
//! and vectors are matched anew a few times. A vector is compared with the entries of the few groups whose centres are nearest,
//! not with all: 2^16 entries of 45 numbers would take minutes.

use rayon::prelude::*;
use std::collections::BinaryHeap;

const ROUNDS: usize = 2;
/// Groups whose entries a vector is compared with.
const NEAREST: usize = 3;
/// Least share of a cell that a half gets.
const LEAST_HALF: usize = 16;
/// Least number of vectors whose halves are measured by two threads: waking one takes longer than measuring a few.
const LEAST_SHARED: usize = 4096;

/// Entries, and the entry of each vector.
pub(super) struct Palette {
    /// `entries` x `width`.
    pub values: Vec<f32>,
    /// The entry of each vector.
    pub labels: Vec<u32>,
}

/// Vectors with weights.
struct Cloud<'a> {
    vectors: &'a [f32],
    weights: &'a [f32],
    width: usize,
}

/// A cell of vectors: a range of the order, its error, and where it is halved.
struct Cell {
    start: usize,
    end: usize,
    group: u32,
    /// Axis, and number of vectors before the border.
    halves: (usize, f32),
}

/// At most `entries` entries for the rows of `vectors`, `width` numbers each, all finite. `weights` say how much each row counts.
pub(super) fn fit(vectors: &[f32], weights: &[f32], width: usize, entries: usize) -> Palette {
    let n = vectors.len() / width;
    let cloud = Cloud { vectors, weights, width };
    let (order, mut cells) = cloud.cells(n, entries);
    // Groups are runs of entries.
    cells.sort_by_key(|cell| (cell.group, cell.start));
    let mut labels = vec![0; n];
    for (entry, cell) in cells.iter().enumerate() {
        order[cell.start..cell.end].iter().for_each(|i| labels[*i as usize] = entry as u32);
    }
    let mut starts: Vec<usize> = (1..cells.len()).filter(|e| cells[*e].group != cells[e - 1].group).collect();
    starts.insert(0, 0);
    starts.push(cells.len());
    let mut values = vec![0.0; cells.len() * width];
    cloud.means(&labels, &mut values);
    let exact = cells.len() < entries || cells.len() == n;
    let rounds = if exact { 0 } else { ROUNDS };
    for _ in 0..rounds {
        let search = Search::new(&values, width, &starts);
        let moved = |(vector, label): (&[f32], &u32)| search.nearest(vector, *label);
        labels = vectors.par_chunks_exact(width).zip(&labels).map(moved).collect();
        cloud.means(&labels, &mut values);
    }
    without_unused(Palette { values, labels }, width)
}

/// Removes entries that no vector has.
fn without_unused(palette: Palette, width: usize) -> Palette {
    let mut number = vec![u32::MAX; palette.values.len() / width];
    palette.labels.iter().for_each(|label| number[*label as usize] = 0);
    let mut values = Vec::with_capacity(palette.values.len());
    let used = number.iter_mut().zip(palette.values.chunks_exact(width)).filter(|(n, _)| **n == 0);
    for (new, (number, value)) in (0..).zip(used) {
        *number = new;
        values.extend_from_slice(value);
    }
    Palette { values, labels: palette.labels.into_iter().map(|label| number[label as usize]).collect() }
}

impl Cloud<'_> {
    fn row(&self, i: u32) -> &[f32] {
        &self.vectors[i as usize * self.width..][..self.width]
    }

    /// Halves cells until there are `entries`; the order of the vectors, and the cells in it.
    fn cells(&self, n: usize, entries: usize) -> (Vec<u32>, Vec<Cell>) {
        let mut order: Vec<u32> = (0..n as u32).collect();
        let mut cells = vec![Cell { start: 0, end: n, group: 0, halves: (0, 0.0) }];
        let mut queue = BinaryHeap::new();
        queue.extend(self.measure(&order, &mut cells[0]).map(|error| (error, std::cmp::Reverse(0_usize))));
        let groups = (entries as f64).sqrt().ceil() as usize;
        while cells.len() < entries {
            // Without errors, every vector has an entry of its own.
            let Some((_, std::cmp::Reverse(k))) = queue.pop() else { break };
            let middle = self.halve(&mut order, &cells[k]);
            let group = if cells.len() < groups { cells.len() as u32 } else { cells[k].group };
            let mut second = Cell { start: middle, end: cells[k].end, group, halves: (0, 0.0) };
            cells[k].end = middle;
            let number = cells.len();
            let first = &mut cells[k];
            let errors = if second.end - first.start < LEAST_SHARED {
                (self.measure(&order, first), self.measure(&order, &mut second))
            } else {
                rayon::join(|| self.measure(&order, first), || self.measure(&order, &mut second))
            };
            queue.extend(errors.0.map(|error| (error, std::cmp::Reverse(k))));
            queue.extend(errors.1.map(|error| (error, std::cmp::Reverse(number))));
            cells.push(second);
        }
        (order, cells)
    }

    /// Bits of the error of a cell, which order like it; none if its vectors are alike. Notes where to halve it.
    fn measure(&self, order: &[u32], cell: &mut Cell) -> Option<u64> {
        let mut sums = vec![[0.0_f64; 2]; self.width];
        let mut weight = 0.0;
        for &i in &order[cell.start..cell.end] {
            let w = f64::from(self.weights[i as usize]);
            weight += w;
            for (sum, x) in sums.iter_mut().zip(self.row(i)) {
                let x = f64::from(*x);
                *sum = [sum[0] + w * x, sum[1] + w * x * x];
            }
        }
        let variance = |[sum, squares]: [f64; 2]| (squares - sum * sum / weight).max(0.0);
        let errors: Vec<f64> = sums.iter().map(|s| variance(*s)).collect();
        let axis = (0..self.width).max_by(|a, b| errors[*a].total_cmp(&errors[*b]))?;
        cell.halves = (axis, (sums[axis][0] / weight) as f32);
        let error: f64 = errors.iter().sum();
        (cell.end - cell.start > 1 && error > 0.0).then_some(error.to_bits())
    }

    /// Orders a cell so that what lies below its border comes first, and returns where the rest begins.
    fn halve(&self, order: &mut [u32], cell: &Cell) -> usize {
        let (axis, border) = cell.halves;
        let members = &mut order[cell.start..cell.end];
        let at = |i: u32| self.vectors[i as usize * self.width + axis];
        let below = members.iter().filter(|i| at(**i) <= border).count();
        let least = (members.len() / LEAST_HALF).max(1);
        let middle = below.clamp(least, members.len() - least);
        members.select_nth_unstable_by(middle, |a, b| at(*a).total_cmp(&at(*b)).then(a.cmp(b)));
        cell.start + middle
    }

    /// Each entry becomes the weighted mean of its vectors; an entry without vectors stays.
    fn means(&self, labels: &[u32], values: &mut [f32]) {
        let mut sums = vec![0.0_f64; values.len()];
        let mut weights = vec![0.0_f64; values.len() / self.width];
        for (i, label) in labels.iter().enumerate() {
            let w = f64::from(self.weights[i]);
            weights[*label as usize] += w;
            let sum = &mut sums[*label as usize * self.width..][..self.width];
            sum.iter_mut().zip(self.row(i as u32)).for_each(|(s, x)| *s += w * f64::from(*x));
        }
        for ((value, sum), weight) in values.chunks_mut(self.width).zip(sums.chunks(self.width)).zip(weights) {
            if weight > 0.0 {
                value.iter_mut().zip(sum).for_each(|(v, s)| *v = (s / weight) as f32);
            }
        }
    }
}

/// Entries whose distances are summed at once.
const BLOCK: usize = 16;
/// Axes that are summed between two looks at whether an entry of a block can still be near enough.
const AXES: usize = 9;

/// A list of entries, for distances to many at once: by block, axis and entry of the block. Places after the last entry are
/// infinitely far.
struct Blocks {
    values: Vec<f32>,
}

impl Blocks {
    fn new(rows: &[f32], width: usize) -> Self {
        let block = |rows: &[f32]| -> Vec<f32> {
            let at = |axis: usize, k: usize| rows.get(k * width + axis).copied().unwrap_or(f32::INFINITY);
            (0..width).flat_map(|axis| (0..BLOCK).map(move |k| (axis, k))).map(|(axis, k)| at(axis, k)).collect()
        };
        Self { values: rows.chunks(BLOCK * width).flat_map(block).collect() }
    }

    /// Hands entries and their squared distances to `found`, in order, as far as these may be at most `limit`; it returns the
    /// next limit. Sums only grow: a block is left as soon as all of its sums are greater.
    fn within(&self, vector: &[f32], mut limit: f32, mut found: impl FnMut(usize, f32) -> f32) {
        'blocks: for (number, block) in self.values.chunks_exact(BLOCK * vector.len()).enumerate() {
            let mut sums = [0.0_f32; BLOCK];
            let columns = block.as_chunks::<BLOCK>().0;
            for (values, columns) in vector.chunks(AXES).zip(columns.chunks(AXES)) {
                for (x, column) in values.iter().zip(columns) {
                    for (sum, value) in sums.iter_mut().zip(column) {
                        *sum += (x - value) * (x - value);
                    }
                }
                // Counted, so that all are compared at once.
                if sums.iter().filter(|sum| **sum > limit).count() == BLOCK {
                    continue 'blocks;
                }
            }
            for (k, sum) in sums.into_iter().enumerate() {
                if sum <= limit {
                    limit = found(number * BLOCK + k, sum);
                }
            }
        }
    }
}

/// Entries in groups, with the groups' centres.
struct Search<'a> {
    values: &'a [f32],
    width: usize,
    starts: &'a [usize],
    centres: Blocks,
    groups: Vec<Blocks>,
}

impl<'a> Search<'a> {
    fn new(values: &'a [f32], width: usize, starts: &'a [usize]) -> Self {
        let of = |bounds: &[usize]| &values[bounds[0] * width..bounds[1] * width];
        let centres: Vec<f32> = starts
            .windows(2)
            .flat_map(|bounds| {
                let rows = of(bounds);
                let count = (bounds[1] - bounds[0]) as f32;
                (0..width).map(move |axis| rows.iter().skip(axis).step_by(width).sum::<f32>() / count)
            })
            .collect();
        let groups = starts.windows(2).map(|bounds| Blocks::new(of(bounds), width)).collect();
        Self { values, width, starts, centres: Blocks::new(&centres, width), groups }
    }

    /// The nearest entry in the groups that are nearest, or the entry that the vector has, if none is nearer.
    fn nearest(&self, vector: &[f32], own: u32) -> u32 {
        let own_group = self.starts.partition_point(|start| *start <= own as usize) - 1;
        // By distance, then by number; the own group counts as nearest.
        let mut near = [(f32::INFINITY, usize::MAX); NEAREST];
        near[0] = (0.0, own_group);
        self.centres.within(vector, f32::INFINITY, |group, distance| {
            let new = (distance, group);
            if group != own_group && new < near[NEAREST - 1] {
                let at = near.partition_point(|known| *known < new);
                near[at..].rotate_right(1);
                near[at] = new;
            }
            near[NEAREST - 1].0
        });
        let row = &self.values[own as usize * self.width..][..self.width];
        let distance = vector.iter().zip(row).fold(0.0, |sum, (x, value)| sum + (x - value) * (x - value));
        let mut best = (distance, own);
        for (_, group) in near.iter().filter(|(distance, _)| distance.is_finite()) {
            let start = self.starts[*group] as u32;
            self.groups[*group].within(vector, best.0, |entry, distance| {
                // The first of equally near ones, but for its own.
                if distance < best.0 {
                    best = (distance, start + entry as u32);
                }
                best.0
            });
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_entries_as_vectors_lose_nothing() {
        let vectors: Vec<f32> = (0..300).map(|i| ((i * 37) % 101) as f32).collect();
        let palette = fit(&vectors, &[1.0; 100], 3, 100);
        for (i, label) in palette.labels.iter().enumerate() {
            assert_eq!(palette.values[*label as usize * 3..][..3], vectors[i * 3..][..3]);
        }
    }
}
