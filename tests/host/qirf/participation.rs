//! The solvers agree; fallbacks; batches.

use super::Made;
use proptest::prelude::*;
use qirf_vk::qirf::batch::{Block, Collected, Solver};
use qirf_vk::qirf::dense::{LIBRARIES, Library};
use qirf_vk::qirf::overlap::Metric;
use qirf_vk::qirf::participation::{Eigensolver, Factor, Gram, lowdin, solve};
use qirf_vk::qirf::select::{Selector, css, rank};
use qirf_vk::qirf::{CHANNELS, Row};
use qirf_vk::random::uniform;
use qirf_vk::reference::overlap::{Primitive, block as overlaps};
use qirf_vk::reference::participation::participation;

/// Overlaps of m random Gaussians in a box with `density` of them per unit of volume.
fn random_block(m: usize, density: f64, seed: u64) -> (Vec<f32>, Vec<[f32; CHANNELS]>) {
    let u = |kind: u64, i: usize, c: usize| uniform(&[seed, kind, i as u64, c as u64]);
    let edge = (m as f64 / density).cbrt();
    let primitive = |i: usize| Primitive {
        position: std::array::from_fn(|c| edge * u(0, i, c)),
        scales: std::array::from_fn(|c| (-2.0 + 2.5 * u(1, i, c)).exp()),
        quaternion: std::array::from_fn(|c| u(2, i, c) - 0.5),
    };
    let primitives: Vec<Primitive> = (0..m).map(primitive).collect();
    let n = overlaps(&primitives).into_iter().map(|x| x as f32).collect();
    let rows = (0..m).map(|i| std::array::from_fn(|c| (u(3, i, c) * (2.0 * u(4, i, 0)).exp()) as f32)).collect();
    (n, rows)
}

/// Each of the host's solvers with each library.
fn everyone() -> impl Iterator<Item = (&'static dyn Library, Eigensolver)> {
    LIBRARIES.iter().flat_map(|library| Eigensolver::HOST.map(|solver| (*library, solver)))
}

fn wide(rows: &[[f32; CHANNELS]]) -> Vec<Row> {
    rows.iter().map(|row| row.map(f64::from)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_solvers_agree(m in 1..90_usize, density in 0.05..20.0_f64, seed in any::<u64>(), which in 0..LIBRARIES.len()) {
        let library = LIBRARIES[which];
        let (n, rows) = random_block(m, density, seed);
        let made = Made::new(&n, &rows);
        let [full, low, single] = Eigensolver::HOST.map(|solver| made.solved(solver, library));
        // P comes in float32: its rounding, at most 2^-24 of its trace, grows by the metric's condition. N's diagonal
        // is 1, so the condition bounds the inverse, too.
        let condition = Gram::new(m, &n, None, 1e-4).condition().unwrap();
        let trace: f64 = made.matrices().rows().0.iter().flatten().map(|x| x * x).sum();
        let allowed = 0.5_f64.powi(22) * trace * condition;
        for k in 0..CHANNELS {
            prop_assert!((full.spectrum[k] - low.spectrum[k]).abs() <= allowed);
            prop_assert!((single.spectrum[k] - low.spectrum[k]).abs() <= 2e-2 * low.spectrum[0]);
        }
        let gap = low.spectrum[low.r - 1] - low.spectrum.get(low.r).copied().unwrap_or(0.0);
        let share = |r: usize| low.spectrum[..r].iter().sum::<f64>() / low.spectrum.iter().sum::<f64>();
        let near = (share(low.r) - 0.95).min(0.95 - share(low.r - 1)) * trace <= 16.0 * allowed;
        prop_assert!(full.r == low.r || near);
        let q_allowed = condition * allowed * (1.0 + 2.0 * low.spectrum[0] / gap);
        for (a, b) in full.q.iter().zip(&low.q) {
            prop_assert!(near || (a - b).abs() <= q_allowed, "{a} and {b}, {q_allowed:.1e} allowed");
        }
        // u^T (N + eps I) u = 1 fixes the sum: q of all eight weights the metric's inverse by P.
        prop_assert!(low.r <= CHANNELS.min(m));
    }
}

#[test]
fn every_solver_agrees_with_the_twin() {
    for (m, density, seed) in [(1, 1.0, 1), (5, 0.1, 2), (24, 20.0, 3), (60, 3.0, 4), (90, 0.5, 5)] {
        let (n, rows) = random_block(m, density, seed);
        let made = Made::new(&n, &rows);
        let overlaps: Vec<f64> = n.iter().map(|&x| f64::from(x)).collect();
        let twin = participation(&overlaps, &made.matrices().rows().0, 1e-4, 0.95).expect("a positive definite metric");
        let most = twin.q.iter().copied().fold(0.0, f64::max);
        for (library, solver) in everyone() {
            let solved = made.solved(solver, library);
            let allowed = match solver {
                Eigensolver::LowRank => 1e-8,
                Eigensolver::LowRankF32 => 2e-2,
                _ => 2e-4,
            };
            assert!(solver == Eigensolver::LowRankF32 || solved.r == twin.r, "{solver}, {m} members");
            for (got, expected) in solved.spectrum.iter().zip(&twin.spectrum) {
                assert!(
                    (got - expected).abs() <= allowed * twin.spectrum[0],
                    "{solver}, {m} members: {got}, {expected}"
                );
            }
            for (got, expected) in solved.q.iter().zip(&twin.q) {
                assert!(
                    solver == Eigensolver::LowRankF32 || (got - expected).abs() <= allowed * most,
                    "{solver}, {m} members: {got}, {expected} of {most}"
                );
            }
        }
    }
}

#[test]
fn float32_keeps_the_same_set_of_separate_functions() {
    for (library, seed) in LIBRARIES.iter().flat_map(|library| (0..20).map(move |seed| (*library, seed))) {
        let (n, rows) = random_block(64, 0.3, seed);
        let made = Made::new(&n, &rows);
        let [full, _, single] = Eigensolver::HOST.map(|solver| made.solved(solver, library));
        let kept = |q: &[f64]| rank(q).iter().map(|&place| place < 18).collect::<Vec<_>>();
        let differing = kept(&full.q).iter().zip(kept(&single.q)).filter(|(a, b)| **a != *b).count();
        assert!(differing <= 2, "{differing} of block {seed}"); // at most one near tie changes sides
    }
}

#[test]
fn an_indefinite_metric_falls_back_to_its_canonical_form() {
    // Eigenvalues 1 + 1.2, 1 - 1.2 and 1: not a Gram matrix, as rounding might produce.
    let n = [1.0, 1.2, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0, 1.0];
    let metric = Gram::new(3, &n, None, 1e-4);
    let w: Vec<Row> = vec![[1.0; CHANNELS], [1.0; CHANNELS], [0.5; CHANNELS]];
    let p = [8.0, 8.0, 4.0, 8.0, 4.0, 2.0];
    for (library, solver) in everyone() {
        let solved = solve(&metric.clone().by(library), &w, &p, solver, 0.95).0;
        assert!(solved.canonical, "{solver}");
        // Along (1, 1)/sqrt 2: lambda = 16 / 2.2001; along e_3: 8/4 / 1.0001; their sum has rank one, with 8 equal
        // columns.
        let expected = 16.0 / 2.2001 + 2.0 / 1.0001;
        assert!((solved.spectrum[0] - expected).abs() < 1e-6, "{solver}: {}", solved.spectrum[0]);
        assert!(solved.q.iter().all(|q| q.is_finite() && *q > 0.0));
        assert!((solved.q[0] - solved.q[1]).abs() < 1e-12);
    }
}

/// Four copies, of whose overlaps one is rounded up: the eigenvalues besides 4 are of the rounding's size, and of both signs.
#[test]
fn the_canonical_form_has_no_functions_of_rounding() {
    let mut n = [1.0_f32; 16];
    (n[1], n[4]) = (1.0 + f32::EPSILON, 1.0 + f32::EPSILON);
    let metric = Gram::new(4, &n, None, 0.0);
    let w: Vec<Row> = [1.0, 1.0, 2.0, 3.0].map(|x| [x; CHANNELS]).to_vec();
    let p = [8.0, 8.0, 8.0, 16.0, 16.0, 32.0, 24.0, 24.0, 48.0, 72.0];
    for (library, solver) in everyone() {
        let solved = solve(&metric.clone().by(library), &w, &p, solver, 0.95).0;
        assert!(solved.canonical, "{solver}");
        // Along (1, 1, 1, 1) / 2, with the eigenvalue 4: lambda = 8 (7 / 2)^2 / 4, and a quarter of lambda / 4 each.
        assert!((solved.spectrum[0] - 24.5).abs() < 1e-4, "{solver}: {:?}", solved.spectrum);
        assert!(solved.q.iter().all(|q| (q - 24.5 / 16.0).abs() < 1e-4), "{solver}: {:?}", solved.q);
    }
}

#[test]
fn a_metric_without_any_positive_eigenvalue_still_answers() {
    let metric = Gram::new(2, &[-1.0, 0.0, 0.0, -2.0], None, 1e-4);
    for (library, solver) in everyone() {
        let solved = solve(&metric.clone().by(library), &[[1.0; CHANNELS]; 2], &[8.0; 3], solver, 0.95).0;
        assert_eq!((solved.q, solved.r, solved.canonical), (vec![0.0; 2], 1, true));
    }
    assert_eq!(lowdin(&metric, &[&[[1.0; CHANNELS]; 2]]), [[0.0; 2]]);
}

#[test]
fn lowdin_is_the_metrics_inverse_root() {
    let (n, rows) = random_block(24, 0.5, 3);
    let w = wide(&rows);
    for library in LIBRARIES {
        let metric = Gram::new(24, &n, None, 1e-4).by(*library);
        // sum of squares of the scores = tr W^T M^-1 W = the sum of the eigenvalues.
        let scores = &lowdin(&metric, &[&w])[0];
        let sum: f64 = scores.iter().map(|x| x * x).sum();
        let solved = Factor::new(&metric, Eigensolver::LowRank).participation(&w, 0.95);
        let total: f64 = solved.spectrum.iter().sum();
        assert!((sum / total - 1.0).abs() < 1e-9);
    }
    let identity: Vec<f32> = (0..9).map(|k| if k % 4 == 0 { 1.0 } else { 0.0 }).collect();
    let plain = &lowdin(&Gram::new(3, &identity, None, 0.0), &[&w[..3]])[0];
    assert!((plain[0] - w[0].iter().map(|x| x * x).sum::<f64>().sqrt()).abs() < 1e-12);
}

#[test]
fn the_column_subset_agrees_with_the_deflated_matrix() {
    for seed in 0..12 {
        let m = 40;
        let (n, rows) = random_block(m, 3.0, seed);
        let weights: Vec<f64> = wide(&rows).iter().map(|row| row.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
        let mut r: Vec<f64> = n.iter().map(|&x| f64::from(x)).collect();
        let mut expected = Vec::new();
        for _ in 0..15 {
            let gain = |i: usize| {
                let column: f64 = (0..m).map(|j| weights[j].powi(2) * r[j * m + i].powi(2)).sum();
                column / r[i * m + i]
            };
            let open = (0..m).filter(|i| r[i * m + i] > 1e-4 && !expected.contains(i));
            let Some(best) = open.reduce(|a, b| if gain(b) > gain(a) { b } else { a }) else { break };
            expected.push(best);
            let (c, pivot): (Vec<f64>, f64) = (r[best * m..(best + 1) * m].to_vec(), r[best * m + best]);
            for i in 0..m {
                (0..m).for_each(|j| r[i * m + j] -= c[i] * c[j] / pivot);
            }
        }
        let ranked = css::order(&n, &weights, expected.len());
        let places: Vec<u32> = expected.iter().map(|&i| ranked.rank[i]).collect();
        assert_eq!(places, (0..expected.len() as u32).collect::<Vec<_>>(), "block {seed}");
        let mut all = ranked.rank.clone();
        all.sort_unstable();
        assert_eq!(all, (0..m as u32).collect::<Vec<_>>());
        assert!(expected.windows(2).all(|pair| ranked.gain[pair[0]] >= ranked.gain[pair[1]]));
    }
}

#[test]
fn a_batch_gives_what_its_blocks_give_and_damage_is_counted() {
    let selectors = vec![Selector::Gnso, Selector::Ordinary, Selector::Lowdin, Selector::Css];
    let solver = Solver { selectors, ..Solver::default() };
    let sizes = [1, 2, 7, 40, 3];
    let mut made: Vec<_> = sizes.iter().zip(0..).map(|(&m, seed)| random_block(m, 1.0, seed)).collect();
    made[3].0[1] = f32::NAN;
    made[3].0[40] = f32::NAN;
    made[4].1.fill([0.0; CHANNELS]);
    let opacity = [0.1_f32, 0.9, 0.5];
    let opacities: Vec<Vec<f32>> = sizes.iter().map(|&m| (0..m).map(|i| opacity[i % 3]).collect()).collect();
    let mut made: Vec<Made> = made.iter().map(|(overlap, rows)| Made::new(overlap, rows)).collect();
    made[3].factor[5] = f32::INFINITY;
    let batch: Vec<Block> = made
        .iter()
        .zip(&opacities)
        .map(|(made, opacity)| Block { matrices: made.matrices(), opacity, self_overlaps: None })
        .collect();
    let solved = solver.solve(&batch);
    let blocks = super::blocks(&sizes);
    let mut all = Collected::new(&blocks, &solver.selectors);
    for (b, (solved, block)) in solved.iter().zip(&batch).enumerate() {
        assert_eq!(*solved, solver.solve_one(block));
        for (_, ranked) in &solved.ranked {
            let mut places = ranked.rank.clone();
            places.sort_unstable();
            assert_eq!(places, (0..sizes[b] as u32).collect::<Vec<_>>());
            assert!(ranked.gain.iter().all(|g| g.is_finite() && *g >= 0.0));
        }
        all.take(&blocks, b, solved);
    }
    // N is symmetric: its broken entry occurs twice.
    assert_eq!((all.unseen, all.repaired, all.rankings.len(), all.r.len()), (1, 3, 4, 5));
    assert!(all.participation.iter().all(|q| q.is_finite() && *q >= 0.0));
    // Without any response, opacity decides.
    assert_eq!(solved[4].ranked[0].1.rank, [2, 0, 1]);
}

/// The diagonal of the raw overlaps is the integral of a Gaussian's square, and the Gaussian is the same as in N: widened, then
/// with no axis below a thousandth of the longest.
#[test]
fn raw_overlaps_are_of_the_functions_of_n() {
    for (scales, dilation) in
        [0.0, 0.25, 40.0].into_iter().flat_map(|d| [([0.02_f32, 0.3, 1.5], d), ([1e-9, 0.3, 1.5], d)])
    {
        let deviations = scales.map(|s| (f64::from(s).powi(2) + dilation * dilation).sqrt());
        let along = |deviation: f64| {
            // exp(-x² / (2 v))² in steps of a tenth of the standard deviation.
            let deviation = deviation.max(1e-3 * deviations[2]);
            (-100..=100_i32).map(|k| (-(0.1 * f64::from(k)).powi(2)).exp()).sum::<f64>() * 0.1 * deviation
        };
        let integral: f64 = deviations.map(along).iter().product();
        let own = Metric { dilation: dilation as f32, ..Metric::default() }.self_overlap(scales.map(f32::ln));
        assert!((own / integral - 1.0).abs() < 1e-5, "{scales:?}, {dilation}: {own}, {integral}");
    }
    // As the kernel clamps them.
    let of = |log: f32| Metric::default().self_overlap([log, 0.0, 0.0]);
    assert_eq!([of(f32::NAN), of(f32::NEG_INFINITY)].map(f64::to_bits), [of(-69.0).to_bits(); 2]);
    assert!(of(f32::INFINITY) == of(69.0) && of(69.0).is_finite());
}

#[test]
fn the_literal_raw_overlap_drowns_in_epsilon() {
    let (n, rows) = random_block(20, 3.0, 1);
    let own = vec![1e-9; 20];
    let w = Made::new(&n, &rows).matrices().rows().0;
    let raw = Factor::new(&Gram::new(20, &n, Some(&own), 1e-4), Eigensolver::LowRank).participation(&w, 0.95);
    let ordinary = Factor::identity().participation(&w, 0.95);
    assert_eq!(rank(&raw.q), rank(&ordinary.q));
}
