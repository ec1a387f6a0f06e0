//! A palette of vectors: cells are halved along their widest axis until there are enough, then refined by Lloyd's
//! algorithm among neighbours.
//!
//! An exhaustive search over 2^16 entries of 45 numbers takes minutes a round. Here a vector is compared with the
//! entries of its own branch only, so that a round costs n x BRANCH distances.

use rayon::prelude::*;

const ROUNDS: usize = 4;
/// Entries of a branch.
const BRANCH: usize = 64;

/// Entries, and the entry of each vector.
pub(super) struct Palette {
    /// `entries` x `width`.
    pub values: Vec<f32>,
    /// The entry of each vector.
    pub labels: Vec<u32>,
}

/// At most `2^levels` entries for the rows of `vectors`, `width` numbers each, all finite.
pub(super) fn fit(vectors: &[f32], width: usize, levels: u32) -> Palette {
    let n = vectors.len() / width;
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut cells: Vec<_> = std::iter::once(0..n).collect();
    // Branches first: cells stay contiguous in `order`, so that a branch is a run of them.
    for _ in 0..levels {
        let mut parts: Vec<&mut [u32]> = Vec::with_capacity(cells.len());
        let mut rest = order.as_mut_slice();
        for cell in &cells {
            let (part, after) = rest.split_at_mut(cell.len());
            parts.push(part);
            rest = after;
        }
        parts.into_par_iter().for_each(|part| halve(vectors, width, part));
        cells = cells
            .into_iter()
            .flat_map(|cell| {
                let middle = cell.start + cell.len() / 2;
                [cell.start..middle, middle..cell.end]
            })
            .filter(|cell| !cell.is_empty())
            .collect();
    }
    let mut values = vec![0.0; cells.len() * width];
    let mut labels = vec![0; n];
    let branches: Vec<(Vec<u32>, &mut [f32])> = cells
        .chunks(BRANCH)
        .zip(values.chunks_mut(BRANCH * width))
        .map(|(cells, values)| (order[cells[0].start..cells[cells.len() - 1].end].to_vec(), values))
        .collect();
    let settled: Vec<(Vec<u32>, Vec<u32>)> = branches
        .into_par_iter()
        .zip(cells.par_chunks(BRANCH))
        .map(|((members, values), cells)| {
            let first = cells[0].start;
            let begun = cells.iter().enumerate().flat_map(|(e, cell)| std::iter::repeat_n(e as u32, cell.len()));
            let mut own: Vec<u32> = begun.collect();
            debug_assert_eq!(own.len() + first, cells[cells.len() - 1].end);
            means(vectors, width, &members, &own, values);
            for _ in 0..ROUNDS {
                for (label, i) in own.iter_mut().zip(&members) {
                    *label = nearest(row(vectors, width, *i), values, width);
                }
                means(vectors, width, &members, &own, values);
            }
            (members, own)
        })
        .collect();
    for (b, (members, own)) in settled.into_iter().enumerate() {
        for (i, label) in members.into_iter().zip(own) {
            labels[i as usize] = (b * BRANCH) as u32 + label;
        }
    }
    Palette { values, labels }
}

fn row(vectors: &[f32], width: usize, i: u32) -> &[f32] {
    &vectors[i as usize * width..][..width]
}

/// Orders a cell so that its lower half along the axis of greatest variance comes first.
fn halve(vectors: &[f32], width: usize, cell: &mut [u32]) {
    if cell.len() < 2 {
        return;
    }
    let mut sums = vec![[0.0_f64; 2]; width];
    for i in cell.iter() {
        for (sum, x) in sums.iter_mut().zip(row(vectors, width, *i)) {
            let x = f64::from(*x);
            *sum = [sum[0] + x, sum[1] + x * x];
        }
    }
    let variance = |[sum, squares]: [f64; 2]| squares - sum * sum / cell.len() as f64;
    let axis = (0..width).max_by(|a, b| variance(sums[*a]).total_cmp(&variance(sums[*b]))).unwrap_or(0);
    let at = |i: u32| vectors[i as usize * width + axis];
    let middle = cell.len() / 2;
    cell.select_nth_unstable_by(middle, |a, b| at(*a).total_cmp(&at(*b)).then(a.cmp(b)));
}

/// Each entry becomes the mean of its vectors; an entry without vectors stays.
fn means(vectors: &[f32], width: usize, members: &[u32], own: &[u32], values: &mut [f32]) {
    let entries = values.len() / width;
    let mut sums = vec![0.0_f64; values.len()];
    let mut counts = vec![0_u32; entries];
    for (i, entry) in members.iter().zip(own) {
        counts[*entry as usize] += 1;
        let sum = &mut sums[*entry as usize * width..][..width];
        sum.iter_mut().zip(row(vectors, width, *i)).for_each(|(s, x)| *s += f64::from(*x));
    }
    for ((value, sum), count) in values.chunks_mut(width).zip(sums.chunks(width)).zip(counts) {
        if count > 0 {
            value.iter_mut().zip(sum).for_each(|(v, s)| *v = (s / f64::from(count)) as f32);
        }
    }
}

fn nearest(vector: &[f32], values: &[f32], width: usize) -> u32 {
    let mut best = (f32::INFINITY, 0);
    for (e, value) in values.chunks_exact(width).enumerate() {
        let distance = vector.iter().zip(value).map(|(a, b)| (a - b) * (a - b)).sum();
        if distance < best.0 {
            best = (distance, e as u32);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_entries_as_vectors_lose_nothing() {
        let vectors: Vec<f32> = (0..300).map(|i| ((i * 37) % 101) as f32).collect();
        let palette = fit(&vectors, 3, 7);
        for (i, label) in palette.labels.iter().enumerate() {
            assert_eq!(palette.values[*label as usize * 3..][..3], vectors[i * 3..][..3]);
        }
    }
}
