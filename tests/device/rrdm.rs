//! W and P on the device against their float64 twin, with derived bounds; and the eigenproblems made from them.

use super::overlap::{Row, blocks, model};
use crate::support::{Random, device, finish};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Device, Error};
use qirf_vk::qirf::assemble::{Assembly, BlockMatrices, Options, symmetric};
use qirf_vk::qirf::participation::Eigensolver;
use qirf_vk::qirf::participation::device::{LARGEST_BLOCK, Problem};
use qirf_vk::qirf::partition::Partition;
use qirf_vk::qirf::rrdm::Density;
use qirf_vk::qirf::select::Selector;
use qirf_vk::qirf::study::{Basis, Observed, Study};
use qirf_vk::reference::participation::{participation, uncertainty};
use qirf_vk::reference::rrdm;
use qirf_vk::response::Responses;

/// Unit roundoff of float32, and the smallest normal number.
const U: f64 = 0.5 / (1 << 23) as f64;
const TINY: f64 = f32::MIN_POSITIVE as f64;
/// Blocks of a subgroup's size and of others, for subgroups of 4 to 32.
const SIZES: [usize; 9] = [1, 2, 8, 9, 31, 32, 33, 127, 128];
/// The same where float64 solves each block several times, which costs the cube of its size: at most two subgroups of 32 and one more.
const SOLVED: [usize; 8] = [1, 2, 8, 9, 31, 32, 33, 65];

/// Kinds of rows of H, independent of the Gaussians.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rows {
    Random,
    /// No Gaussian has any response.
    Zero,
    /// Only one Gaussian has a response.
    OneLive,
    /// All have the same response.
    Copies,
    /// From 1e-12 to 1e12.
    Spread,
}

impl Rows {
    const ALL: [Self; 5] = [Self::Random, Self::Zero, Self::OneLive, Self::Copies, Self::Spread];

    fn of(self, starts: &[u32]) -> Vec<[f32; 8]> {
        let mut r = Random(9);
        let live = |i: usize| starts.windows(2).any(|b| i == b[0].midpoint(b[1]) as usize);
        let row = |i: usize| match self {
            Self::Random => [0; 8].map(|_| r.unit() as f32),
            Self::Zero => [0.0; 8],
            Self::OneLive => [if live(i) { 0.5 } else { 0.0 }; 8],
            Self::Copies => [0.25, 0.5, 1.0, 2.0, 0.125, 0.5, 0.75, 1.5],
            Self::Spread => [0; 8].map(|_| 10_f64.powf(24.0 * r.unit() - 12.0) as f32),
        };
        (0..*starts.last().unwrap() as usize).map(row).collect()
    }
}

/// W of a block by the twin, from the device's rows, which contain the weights of `eta`.
fn twin(rows: &[[f32; 8]], eta: f32, epsilon: f32) -> Vec<[f64; 8]> {
    let share = |c: usize| f64::from(if c < 4 { eta } else { 1.0 - eta });
    // A channel of weight zero is zero.
    let bare = |row: &[f32; 8]| {
        std::array::from_fn(|c| if share(c) > 0.0 { f64::from(row[c]) / share(c).sqrt() } else { 0.0 })
    };
    rrdm::w(&rows.iter().map(bare).collect::<Vec<_>>(), f64::from(eta), f64::from(epsilon))
}

/// Checks W, its divisors and P of a block. A trace is a sum of 4 m squares, at least four at a time, and of a
/// subgroup's lanes: at most m + 7 roundings. Division, epsilon and the root's reciprocal add 2.5, 0.5 and 2 units in
/// the last place, each of which is two roundings; the reciprocal root halves the error before it.
fn compare(block: &BlockMatrices<'_>, rows: &[[f32; 8]], (eta, epsilon): (f32, f32), told: &str) {
    let m = block.m;
    let w = twin(rows, eta, epsilon);
    let before = (m + 7) as f64 + 5.0 + 1.0;
    let (of_divisor, of_w) = (before * U, (0.5 * before + 5.0) * U);
    for (group, share) in [f64::from(eta), f64::from(1.0 - eta)].into_iter().enumerate() {
        let squares = rows.iter().flat_map(|row| &row[4 * group..4 * group + 4]).map(|h| f64::from(*h).powi(2));
        let expected = if share > 0.0 { squares.sum::<f64>() / share + f64::from(epsilon) } else { 0.0 };
        let got = f64::from(block.divisors[group]);
        assert!(
            (got - expected).abs() <= of_divisor * expected + TINY,
            "{told}, divisor {group}: {got} for {expected}"
        );
    }
    let (got, repaired) = block.rows();
    assert_eq!(repaired, 0, "{told}");
    for (i, (got, expected)) in got.iter().zip(&w).enumerate() {
        for c in 0..8 {
            let allowed = of_w * expected[c].abs() + TINY;
            assert!((got[c] - expected[c]).abs() <= allowed, "{told}, W {i} {c}: {} for {}", got[c], expected[c]);
        }
    }
    let p: Vec<f64> = symmetric(m, block.density);
    for row in 0..m {
        for column in 0..=row {
            let products = || (0..8).map(|c| w[row][c] * w[column][c]);
            let (expected, size) = (products().sum::<f64>(), products().map(f64::abs).sum::<f64>());
            let got = p[column * m + row];
            let allowed = (2.0 * of_w + 8.0 * U) * size + 8.0 * TINY;
            assert!((got - expected).abs() <= allowed, "{told}, P {row} {column}: {got} for {expected}");
        }
    }
    let scales = block.scales();
    for (got, h) in got.iter().zip(rows) {
        for c in 0..8 {
            let back = got[c] * scales[c];
            let dead = scales[c] == 0.0;
            let expected = f64::from(h[c]);
            // Values too small for W are lost.
            let lost = TINY * scales[c];
            assert!(dead || (back - expected).abs() <= (of_w + of_divisor) * expected + lost, "{told}: H comes back");
        }
    }
}

fn assembly<'a>(
    device: &Device,
    resident: &'a Resident,
    (members, starts): (&[u32], &[u32]),
    h: &[[f32; 8]],
    (eta, epsilon): (f32, f32),
) -> Assembly<'a> {
    let density = Some(Density { eta, epsilon, full: true });
    let options = Options { density, batch_bytes: 4 * 9000, ..Options::default() };
    Assembly::new(device, resident, members, starts, h, options).unwrap()
}

#[test]
fn rrdm_is_its_twins_in_every_hard_case() {
    let device = &device();
    let (gaussians, starts) = blocks(&SIZES, 5);
    let n = gaussians.len() as u32;
    // Members in an order other than the model's.
    let members: Vec<u32> = (0..n).map(|i| (i * 7 + 3) % n).collect();
    let resident = Resident::upload(device, &model(&gaussians)).unwrap();
    for kind in Rows::ALL {
        // Members get the rows in their own order, so that a block has one live row.
        let of_members = kind.of(&starts);
        for (eta, epsilon) in [(0.75, 1e-4), (0.0, 1e-4), (1.0, 1e-4), (0.3, 0.0), (0.75, 1e-12)] {
            // A channel without weight is zero, as after normalisation.
            let weigh =
                |row: &[f32; 8]| std::array::from_fn(|c| if [eta, 1.0 - eta][c / 4] > 0.0 { row[c] } else { 0.0 });
            let mut h = vec![[0.0; 8]; n as usize];
            members.iter().zip(&of_members).for_each(|(i, row)| h[*i as usize] = weigh(row));
            let assembly = assembly(device, &resident, (&members, &starts), &h, (eta, epsilon));
            assert!(assembly.batches().len() > 2);
            let mut seen = 0;
            assembly
                .for_each::<Error>(|batch| {
                    for (b, block) in batch.iter() {
                        let own = &members[starts[b] as usize..starts[b + 1] as usize];
                        let rows: Vec<[f32; 8]> = own.iter().map(|i| h[*i as usize]).collect();
                        let told = format!("{kind:?}, eta {eta}, epsilon {epsilon}, block of {}", block.m);
                        compare(&block, &rows, (eta, epsilon), &told);
                        seen += 1;
                    }
                    Ok(())
                })
                .unwrap();
            assert_eq!(seen, SIZES.len());
        }
    }
    finish(device);
}

/// Separate Gaussians, which overlap with neighbours only, or exact copies of one.
fn apart_or_copies(sizes: &[usize], copies: bool) -> (Vec<Row>, Vec<u32>) {
    let (mut gaussians, starts) = blocks(sizes, 5);
    let (one, _) = blocks(&[1], 3);
    for (i, row) in gaussians.iter_mut().enumerate() {
        *row = one[0];
        row.1 = [-1.0; 3];
        if !copies {
            row.0 = [0.8 * i as f32, 0.0, 0.0];
        }
    }
    (gaussians, starts)
}

/// The device's solution of the hard cases equals the twin's within the uncertainty from rounding, or is reported as
/// failed; with epsilon 0 if N is well conditioned, and 1e-12 otherwise.
#[test]
fn solutions_of_the_hard_cases_are_the_twins_or_fail() {
    let device = &device();
    for (copies, epsilon) in [(false, 0.0), (false, 1e-4), (true, 1e-4), (true, 1e-12)] {
        let (gaussians, starts) = apart_or_copies(&SOLVED, copies);
        let members: Vec<u32> = (0..gaussians.len() as u32).collect();
        let resident = Resident::upload(device, &model(&gaussians)).unwrap();
        for kind in [Rows::Random, Rows::Zero, Rows::OneLive, Rows::Copies] {
            let h = kind.of(&starts);
            let assembly = assembly(device, &resident, (&members, &starts), &h, (0.75, epsilon));
            let mut expected = Vec::new();
            assembly
                .for_each::<Error>(|batch| {
                    for (_, block) in batch.iter() {
                        let overlap: Vec<f64> = symmetric(block.m, block.overlap);
                        let (w, numbers) = (block.rows().0, [f64::from(epsilon), 0.95]);
                        let twin = participation(&overlap, &w, numbers[0], numbers[1]);
                        let draws = if block.m > 64 { 2 } else { 8 };
                        expected.push((twin, uncertainty(&overlap, &w, numbers, U, draws)));
                    }
                    Ok(())
                })
                .unwrap();
            let (mut seen, mut failed) = (0, 0);
            assembly
                .solve_each::<Error>(Problem { epsilon, tau: 0.95 }, |b, solution| {
                    let told = format!("copies {copies}, epsilon {epsilon}, {kind:?}, block of {}", SOLVED[b]);
                    seen += 1;
                    failed += usize::from(solution.failed);
                    assert!(solution.q.iter().chain(solution.gain).all(|q| q.is_finite()), "{told}");
                    let (Some(twin), Some(unsure)) = &expected[b] else {
                        // Float32 cannot distinguish that metric from one that is not positive definite; the host must
                        // solve it.
                        assert!(copies, "{told}: the twin solves it");
                        return Ok(());
                    };
                    if solution.failed {
                        assert!(copies && epsilon < 1e-6, "{told}: failed");
                        return Ok(());
                    }
                    let most = twin.q.iter().copied().fold(0.0, f64::max);
                    for ((got, expected), unsure) in solution.q.iter().zip(&twin.q).zip(unsure) {
                        let apart = (f64::from(*got) - expected).abs();
                        let allowed = 8.0 * unsure + 64.0 * U * most;
                        assert!(apart <= allowed, "{told}: q {got} for {expected}, {allowed:.1e} allowed");
                    }
                    Ok(())
                })
                .unwrap();
            assert_eq!(seen, SOLVED.len());
            println!("copies {copies}, epsilon {epsilon}, {kind:?}: {failed} of {seen} blocks failed in float32");
        }
    }
    finish(device);
}

/// A study of exact copies and of separate Gaussians: for every solver and epsilon, the ranks of a block are a
/// permutation, all numbers are finite, and a block that a solver cannot factorise is solved by the next and counted.
#[test]
fn every_solver_answers_for_every_block() {
    let device = device();
    for (copies, epsilon) in [(false, 0.0), (true, 1e-4), (true, 1e-12)] {
        let (gaussians, _) = apart_or_copies(&SIZES, copies);
        let model = model(&gaussians);
        let resident = Resident::upload(&device, &model).unwrap();
        let channels = Rows::Random.of(&[0, gaussians.len() as u32]);
        let responses = Responses { channels, ..Responses::default() };
        let observed = Observed { resident: &resident, model: &model, responses: &responses };
        for solver in Eigensolver::ALL {
            let basis = Basis { solver, epsilon, ..Basis::default() };
            let study = Study::new(&device, observed, &basis, &[Selector::Gnso, Selector::Css], 1).unwrap();
            let told = format!("copies {copies}, epsilon {epsilon}, {solver}");
            let collected = &study.collected;
            assert_eq!(study.solver, Some(solver));
            assert!(collected.participation.iter().all(|q| q.is_finite() && *q >= 0.0), "{told}");
            for (selector, ranking) in &study.rankings {
                assert!(ranking.gain.iter().all(|g| g.is_finite()), "{told}, {selector}");
                for members in study.partitioned.blocks.iter() {
                    let mut ranks: Vec<u32> = members.iter().map(|i| ranking.rank[*i as usize]).collect();
                    ranks.sort_unstable();
                    assert!(ranks.iter().copied().eq(0..members.len() as u32), "{told}, {selector}");
                }
            }
            let single = matches!(solver, Eigensolver::Device | Eigensolver::LowRankF32);
            let blocks = study.partitioned.blocks.len();
            println!(
                "{told}: {} of {blocks} blocks fell back, {} to canonical form",
                collected.fallbacks, collected.canonical
            );
            // In float32 1 + 1e-12 is 1, and the second of two copies has no pivot left.
            let expected = if copies && epsilon < 1e-6 && single { blocks } else { 0 };
            assert_eq!(collected.fallbacks, expected, "{told}");
            let canonical = if solver == Eigensolver::Device { 0 } else { expected };
            assert_eq!(
                collected.canonical, canonical,
                "{told}: the device's blocks go to float64, which factorises them"
            );
        }
    }
    finish(&device);
}

/// A kernel of minutes is one after which systems reset the device: the host solves blocks that are too large.
#[test]
fn the_host_solves_blocks_too_large_for_the_device() {
    let device = device();
    let (gaussians, _) = blocks(&[600], 5);
    let model = model(&gaussians);
    let resident = Resident::upload(&device, &model).unwrap();
    let channels = Rows::Random.of(&[0, gaussians.len() as u32]);
    let responses = Responses { channels, ..Responses::default() };
    let observed = Observed { resident: &resident, model: &model, responses: &responses };
    let study = |solver, most| {
        let basis = Basis {
            solver,
            partition: Partition::Adaptive { mean: most, least: most.min(600), most },
            ..Basis::default()
        };
        Study::new(&device, observed, &basis, &[Selector::Gnso], 1).unwrap()
    };
    let (host, whole) = (study(Eigensolver::LowRank, 4096), study(Eigensolver::Device, 4096));
    assert!(whole.partitioned.blocks.block(0).len() > LARGEST_BLOCK);
    assert_eq!((whole.partitioned.blocks.len(), whole.collected.fallbacks), (1, 1));
    assert!(whole.rankings[0].1.rank == host.rankings[0].1.rank);
    assert_eq!(study(Eigensolver::Device, LARGEST_BLOCK).collected.fallbacks, 0);
    finish(&device);
}

#[test]
fn responses_that_are_not_finite_are_refused_by_their_gaussian() {
    let device = device();
    let (gaussians, _) = apart_or_copies(&SIZES, false);
    let model = model(&gaussians);
    let resident = Resident::upload(&device, &model).unwrap();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut channels = Rows::Random.of(&[0, gaussians.len() as u32]);
        (channels[77][5], channels[200][0]) = (bad, bad);
        let responses = Responses { channels, ..Responses::default() };
        let observed = Observed { resident: &resident, model: &model, responses: &responses };
        let refused = Study::new(&device, observed, &Basis::default(), &[Selector::Css], 1).err().expect("refused");
        let text = refused.to_string();
        assert!(text.contains("Gaussian 77 ") && text.contains("channel 5 (gradient by scale)"), "{text}");
    }
    finish(&device);
}
