//! Budgets, ties, the safeguard, selectors of single Gaussians, merging.

use super::Made;
use proptest::prelude::*;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::qirf::CHANNELS;
use qirf_vk::qirf::batch::{Block, Collected, Solver};
use qirf_vk::qirf::select::budget::{Budget, Keep, Safeguard, choose, quotas};
use qirf_vk::qirf::select::merge::{Functions, merge};
use qirf_vk::qirf::select::{Ranking, Selector, Statistics, detail, rank, rounded};
use qirf_vk::random::uniform;
use qirf_vk::response::Score;

const BUDGETS: [Budget; 3] = [Budget::PerBlock, Budget::Hybrid, Budget::Global];

fn indices(keep: &[bool]) -> Vec<usize> {
    (0..keep.len()).filter(|&i| keep[i]).collect()
}

proptest! {
    #[test]
    fn quotas_sum_and_fit(sizes in prop::collection::vec(1..60_usize, 1..80), share in 0.0..=1.0_f64) {
        let blocks = super::blocks(&sizes);
        let total = (share * blocks.members.len() as f64) as usize;
        let quotas = quotas(&blocks, total);
        prop_assert_eq!(quotas.iter().sum::<usize>(), total);
        for (&quota, &size) in quotas.iter().zip(&sizes) {
            prop_assert!(quota <= size);
            let exact = total as f64 * size as f64 / blocks.members.len() as f64;
            prop_assert!((quota as f64 - exact).abs() < 1.0);
        }
    }

    #[test]
    fn the_count_is_exact(
        sizes in prop::collection::vec(1..40_usize, 1..40), target in 0..900_usize, seed in any::<u64>(), guarded in any::<bool>(),
    ) {
        let blocks = super::blocks(&sizes);
        let n = blocks.members.len();
        let score: Vec<f64> = (0..n as u64).map(|i| (uniform(&[seed, i]) * 8.0).floor()).collect();
        let ranking = Ranking::by_score(&blocks, &score);
        let safeguard = guarded.then_some(Safeguard { scores: &score, share: 0.05 });
        for budget in BUDGETS {
            let r = vec![1; sizes.len()];
            let choice = choose(&blocks, &ranking, &r, budget, Keep::Count(target), safeguard);
            prop_assert_eq!(indices(&choice.keep).len(), target.min(n));
            prop_assert_eq!(choice.kept(), target.min(n));
            prop_assert!(choice.detail <= n / 20);
        }
    }
}

#[test]
fn ties_go_by_index() {
    let blocks = super::blocks(&[5, 5]);
    let ranking = Ranking::by_score(&blocks, &[1.0; 10]);
    let kept = |budget| indices(&choose(&blocks, &ranking, &[1, 1], budget, Keep::Count(4), None).keep);
    assert_eq!(kept(Budget::PerBlock), [0, 1, 5, 6]);
    assert_eq!(kept(Budget::Global), [0, 1, 5, 6]); // equal gains: by rank in the block, then by index
    assert_eq!(rank(&[1.0, 2.0, 1.0 + 1e-6, f64::NAN, 2.0 - 1e-6]), [2, 0, 3, 4, 1]);
    assert_eq!(rounded(-0.0).to_bits(), 0);
    assert!(rounded(1.0 + 1e-3) > 1.0 && rounded(1.0 + 1e-4) == 1.0);
}

/// Identical Gaussians are ranked by their index, by every selector and in blocks of any size.
#[test]
fn equals_are_ranked_by_index_in_blocks_of_any_size() {
    let selectors = vec![Selector::Gnso, Selector::Ordinary, Selector::Lowdin, Selector::Css];
    let solver = Solver { selectors, ..Solver::default() };
    for m in (1..=8).chain([9, 40]) {
        // All separate, and all overlapping equally; all with the same response, and with none.
        for (across, response) in [(0.0, 1.0), (0.0, 0.0), (0.5, 1.0), (0.5, 0.0)] {
            let overlap: Vec<f32> = (0..m * m).map(|k| if k % (m + 1) == 0 { 1.0 } else { across }).collect();
            let (rows, opacity) = (vec![[response; CHANNELS]; m], vec![0.5; m]);
            let made = Made::new(&overlap, &rows);
            let block = Block { matrices: made.matrices(), opacity: &opacity, self_overlaps: None };
            let solved = solver.solve_one(&block);
            assert_eq!(solved, solver.solve_one(&block), "once more");
            let modes = solved.modes.as_ref().expect("the host solves");
            assert_eq!((modes.unseen, modes.canonical), (response == 0.0, false));
            assert!(modes.r == 1 && modes.spectrum.iter().all(|l| l.is_finite()));
            for (selector, ranked) in &solved.ranked {
                let told = format!("{selector:?}, {m} of overlap {across}, response {response}");
                // After the column subset picks the first of overlapping equals, the others are still equal: ordered by
                // index.
                assert_eq!(ranked.rank, (0..m as u32).collect::<Vec<_>>(), "{told}");
                assert!(ranked.gain.iter().all(|g| g.is_finite()), "{told}");
            }
        }
    }
}

/// A block whose metric is not a Gram matrix is still solved, and counted once.
#[test]
fn a_metric_that_is_not_positive_definite_is_counted() {
    let solver = Solver::default();
    let sound = [1.0, 0.3, 0.3, 1.0];
    let broken = [1.0, 1.2, 1.2, 1.0];
    let rows = [[1.0_f32; CHANNELS], [0.5; CHANNELS]];
    let made = [sound, broken, sound].map(|overlap| Made::new(&overlap, &rows));
    let batch =
        made.each_ref().map(|made| Block { matrices: made.matrices(), opacity: &[0.5, 0.5], self_overlaps: None });
    let blocks = super::blocks(&[2, 2, 2]);
    let mut all = Collected::new(&blocks, &solver.selectors);
    for (b, solved) in solver.solve(&batch).iter().enumerate() {
        all.take(&blocks, b, solved);
    }
    assert_eq!((all.fallbacks, all.canonical, all.repaired, all.unseen), (1, 1, 0, 0));
    assert!(all.energies.iter().flatten().all(|l| l.is_finite()) && all.r == [1, 1, 1]);
}

#[test]
fn a_share_counts_all_and_a_remainder_goes_to_the_larger_part() {
    let blocks = super::blocks(&[7, 2, 1]);
    assert_eq!(quotas(&blocks, 5), [4, 1, 0]); // 3.5, 1.0, 0.5: the tie goes to the first
    let ranking = Ranking::by_score(&blocks, &[0.0; 10]);
    let choice = choose(&blocks, &ranking, &[1; 3], Budget::PerBlock, Keep::Share(0.28), None);
    assert_eq!(choice.kept(), 3);
}

#[test]
fn the_papers_rule_keeps_kappa_or_r_and_detail_on_top() {
    let blocks = super::blocks(&[100, 10, 1, 3]);
    let n = blocks.members.len();
    let score: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let ranking = Ranking::by_score(&blocks, &score);
    let safeguard = Some(Safeguard { scores: &score, share: 0.05 });
    let keep = Keep::Paper { kappa: 0.22 };
    let choice = choose(&blocks, &ranking, &[3, 5, 2, 8], Budget::Global, keep, safeguard);
    assert_eq!((choice.main, choice.detail), (22 + 5 + 1 + 3, 5));
    assert_eq!(indices(&choice.keep).len(), 36);
    // ceil(0.22 x 50) is 11, whatever the binary value of 0.22.
    let blocks = super::blocks(&[50]);
    let ranking = Ranking::by_score(&blocks, &[0.0; 50]);
    assert_eq!(choose(&blocks, &ranking, &[1], Budget::PerBlock, keep, None).main, 11);
}

#[test]
fn hybrid_gives_half_by_block_and_half_by_gain() {
    let blocks = super::blocks(&[10, 10]);
    let score: Vec<f64> = (0..20).map(|i| f64::from(i % 10) + if i < 10 { 0.0 } else { 100.0 }).collect();
    let ranking = Ranking::by_score(&blocks, &score);
    let kept = |budget| indices(&choose(&blocks, &ranking, &[1, 1], budget, Keep::Count(8), None).keep);
    assert_eq!(kept(Budget::PerBlock), [6, 7, 8, 9, 16, 17, 18, 19]);
    assert_eq!(kept(Budget::Hybrid), [8, 9, 14, 15, 16, 17, 18, 19]);
    assert_eq!(kept(Budget::Global), [12, 13, 14, 15, 16, 17, 18, 19]);
}

#[test]
fn the_safeguard_looks_for_small_visible_opaque_and_unsettled() {
    let log_scales = vec![[-3.0, -3.0, -9.0], [-1.0, -1.0, -9.0], [-3.0; 3], [-3.0; 3], [f32::NAN; 3]];
    let model = Gaussians { log_scales, ..Gaussians::zeroed(5, 0) };
    let responses = [(1.0, 2.0), (1.0, 2.0), (0.25, 1.0), (1.0, f32::NAN), (1.0, 1.0)]
        .map(|(visibility, gradient)| [visibility, 0.0, 0.0, 0.0, gradient, 0.0, 0.0, 0.0]);
    let d = detail::scores(&model, &responses);
    let expected = (1.5_f64).exp() * 0.5_f64.sqrt();
    assert!((d[0] - expected).abs() < 1e-6);
    assert!((d[1] / d[0] - (-1.0_f64).exp()).abs() < 1e-6);
    assert!((d[2] / d[0] - 0.25).abs() < 1e-6);
    assert_eq!((d[3], d[4]), (0.0, 0.0));
}

#[test]
fn selectors_of_single_gaussians() {
    let rows = [[1.0_f32; CHANNELS], [2.0; CHANNELS], [0.0; CHANNELS]];
    let score = |contribution: f32, peak: f32, significance: f32, change: f32, along_residual: f32| Score {
        contribution,
        peak,
        significance,
        change,
        along_residual,
        ..Score::default()
    };
    let scores = [score(3.0, 0.5, 1.0, 2.0, 1.5), score(1.0, 0.9, 1.0, 2.0, 0.0), score(2.0, 0.1, 2.0, 1.0, -1.0)];
    let statistics = Statistics {
        rows: &rows,
        opacity: &[0.1, 0.2, 0.3],
        scores: &scores,
        log_scales: &[[-5.0; 3], [-1.0; 3], [-1.0; 3]],
    };
    let blocks = super::blocks(&[3]);
    let order = |selector: Selector| selector.ranking(&blocks, &statistics, 7).map(|r| r.rank);
    assert_eq!(order(Selector::Importance).unwrap(), [1, 0, 2]);
    assert_eq!(order(Selector::Contribution).unwrap(), [0, 2, 1]);
    assert_eq!(order(Selector::Opacity).unwrap(), [2, 1, 0]);
    assert_eq!(order(Selector::Radsplat).unwrap(), [1, 0, 2]);
    assert_eq!(order(Selector::Lightgaussian).unwrap(), [2, 1, 0]);
    assert_eq!(order(Selector::Removal).unwrap(), [2, 1, 0], "the first is in the photos' way");
    assert_eq!(order(Selector::Change).unwrap(), [0, 1, 2], "whatever the photos show");
    assert_eq!(order(Selector::Random), order(Selector::Random));
    assert_ne!(Selector::Random.score(&statistics, 7), Selector::Random.score(&statistics, 8));
    for (selector, name) in Selector::ALL.map(|selector| (selector, selector.name())) {
        assert_eq!(name.parse::<Selector>().unwrap(), selector);
        assert_eq!(selector.to_string(), name);
        let of_more = selector.reads_blocks() || selector == Selector::Pairs;
        assert_eq!(!of_more, order(selector).is_some());
    }
    assert!("gsno".parse::<Selector>().unwrap_err().contains("gnso"));
}

fn functions(alpha: &[f64], colour: &[[f64; 3]]) -> Functions {
    Functions { alpha: alpha.to_vec(), sh: colour.concat(), width: 3, self_overlaps: vec![2.0; alpha.len()] }
}

#[test]
fn a_dropped_duplicate_is_merged_into_its_twin() {
    let n = [1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let mut f = functions(&[0.3, 0.2, 0.5], &[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let done = merge(&n, &[true, false, true], &mut f).unwrap();
    assert!(done.accepted && done.merged < 1e-4 * done.dropped);
    assert!((f.alpha[0] - 0.5).abs() < 1e-3);
    assert!((f.sh[0] - 0.6).abs() < 1e-3 && (f.sh[1] - 0.4).abs() < 1e-3);
    assert_eq!((f.alpha[2], f.sh[8]), (0.5, 1.0));
}

#[test]
fn merging_that_does_not_help_changes_nothing() {
    let far = [1.0, 0.0, 0.0, 1.0];
    let before = functions(&[0.5, 0.5], &[[1.0; 3], [1.0; 3]]);
    let mut f = before.clone();
    assert!(!merge(&far, &[true, false], &mut f).unwrap().accepted);
    assert_eq!(f, before);
    assert!(merge(&far, &[true, true], &mut f).is_none());
    assert!(merge(&far, &[false, false], &mut f).is_none());
    // An opaque twin cannot grow beyond 0.99; the result is finite and within bounds.
    let mut f = functions(&[0.98, 0.98], &[[1.0; 3], [1.0; 3]]);
    merge(&[1.0; 4], &[true, false], &mut f).unwrap();
    assert!(f.alpha[0] <= 0.99 && f.sh.iter().all(|x| x.is_finite()));
}

proptest! {
    #[test]
    fn merging_never_makes_the_local_error_worse(seed in any::<u64>(), m in 2..20_usize) {
        let u = |k: u64, i: usize| uniform(&[seed, k, i as u64]);
        // Functions on a line: exp(-d^2/4) is a Gram matrix.
        let n: Vec<f32> = (0..m * m).map(|k| (-(u(0, k / m) * 4.0 - u(0, k % m) * 4.0).powi(2) / 4.0).exp() as f32).collect();
        let keep: Vec<bool> = (0..m).map(|i| u(1, i) < 0.4).collect();
        let mut f = Functions {
            alpha: (0..m).map(|i| u(2, i)).collect(),
            sh: (0..m * 12).map(|i| 2.0 * u(3, i) - 1.0).collect(),
            width: 12,
            self_overlaps: (0..m).map(|i| (6.0 * u(4, i) - 3.0).exp()).collect(),
        };
        let before = f.clone();
        if let Some(done) = merge(&n, &keep, &mut f) {
            prop_assert!(done.accepted == (done.merged < done.dropped));
            for i in 0..m {
                if !keep[i] || !done.accepted {
                    prop_assert_eq!(f.alpha[i], before.alpha[i]);
                } else {
                    prop_assert!(f.alpha[i] >= 0.5 * before.alpha[i] && f.alpha[i] <= 0.99_f64.max(before.alpha[i]));
                }
            }
            prop_assert!(f.sh.iter().all(|x| x.is_finite()));
        }
    }
}
