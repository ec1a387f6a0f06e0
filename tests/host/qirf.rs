//! The host half of QIRF: blocks, eigenproblems, rankings and budgets.

mod hard_cases;
mod pairs;
mod participation;
mod partition;
mod real;
mod select;

use qirf_vk::qirf::partition::Blocks;

/// Blocks of these sizes over consecutive Gaussians.
fn blocks(sizes: &[usize]) -> Blocks {
    let mut starts = vec![0_u32];
    starts.extend(sizes.iter().scan(0, |sum, &size| {
        *sum += size as u32;
        Some(*sum)
    }));
    Blocks { members: (0..sizes.iter().sum::<usize>() as u32).collect(), starts }
}
