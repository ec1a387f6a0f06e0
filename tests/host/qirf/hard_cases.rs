//! The design's hard cases: `hard-cases.json` contains 12 pairs with overlaps from 60-digit arithmetic, and 10 blocks.

use qirf_vk::qirf::dense::LIBRARIES;
use qirf_vk::qirf::participation::{Eigensolver, Gram, norm, solve};
use qirf_vk::qirf::select::{css, rank};
use qirf_vk::reference::overlap::{Primitive, overlap};
use qirf_vk::reference::rrdm;
use qirf_vk::selftest::hard::{Block, Pair, blocks, pairs as figures};

fn pairs() -> impl Iterator<Item = (&'static str, Pair, Primitive, Primitive)> {
    figures().map(|(name, pair)| {
        let a = Primitive { position: pair.p1, scales: pair.s1, quaternion: pair.q1 };
        let b = Primitive { position: pair.p2, scales: pair.s2, quaternion: pair.q2 };
        (name, pair, a, b)
    })
}

/// The first `k` of a ranking, ascending.
fn first(rank: &[u32], k: usize) -> Vec<u32> {
    (0..rank.len() as u32).filter(|&i| (rank[i as usize] as usize) < k).collect()
}

#[test]
fn overlap_of_the_pairs_in_float64() {
    assert_eq!(pairs().count(), 12);
    for (name, pair, a, b) in pairs() {
        // The floor raises only P1's scales; its overlap is still 1.
        for (a, b) in [(&a, &b), (&b, &a)] {
            let n = overlap(a, b);
            assert!((n - pair.expected).abs() <= 1e-9 * pair.expected.max(1e-3), "{name}: {n} for {}", pair.expected);
        }
    }
}

/// Only the direction of a quaternion counts; one without a direction has no overlap.
#[test]
fn quaternions_of_any_length() {
    let gaussian = |size: f32| {
        let rotation = [0.8, 0.3, -0.4, 0.33].map(|x: f32| x * size);
        Primitive::of([0.0; 3], [0.0, -2.0, -5.0], rotation)
    };
    let other = Primitive::of([0.5, 0.1, -0.2], [-1.0, 0.0, -3.0], [0.1, 0.2, 0.3, 0.4]);
    let expected = overlap(&gaussian(1.0), &other);
    assert!((0.01..0.99).contains(&expected), "{expected}");
    for exponent in [-100, 100] {
        let n = overlap(&gaussian(2_f32.powi(exponent)), &other);
        assert!((n - expected).abs() < 1e-12, "2^{exponent}: {n} for {expected}");
    }
    assert!(overlap(&gaussian(0.0), &other).is_nan());
}

#[test]
fn every_solver_solves_the_blocks() {
    assert_eq!(blocks().count(), 10);
    for (name, block) in blocks() {
        let metric = Gram::new(block.m, &block.n.concat(), None, block.eps);
        let w = block.rows();
        let p = rrdm::p(&w);
        let m = block.m;
        let density: Vec<f32> = (0..m).flat_map(|c| (c..m).map(move |r| r * m + c)).map(|k| p[k] as f32).collect();
        for (library, solver) in LIBRARIES.iter().flat_map(|l| Eigensolver::HOST.map(|solver| (*l, solver))) {
            let solved = solve(&metric.clone().by(library), &w, &density, solver, 0.95).0;
            let tolerance = Block::tolerance(name, solver != Eigensolver::LowRank);
            let most = block.lam[0].max(1e-12);
            for (got, expected) in solved.spectrum.iter().zip(&block.lam) {
                assert!(
                    (got - expected).abs() <= tolerance * most,
                    "{name} {solver} {library:?}: lambda {got} for {expected}"
                );
            }
            assert_eq!(solved.r, block.r, "{name} {solver} {library:?}");
            let most = block.q.iter().copied().fold(1e-12, f64::max);
            for (got, expected) in solved.q.iter().zip(&block.q) {
                assert!(
                    (got - expected).abs() <= tolerance * most,
                    "{name} {solver} {library:?}: q {got} for {expected}"
                );
            }
            // Float32 may swap copies.
            let ties = name.contains("duplicates") && solver != Eigensolver::LowRank;
            assert!(ties || first(&rank(&solved.q), block.k) == block.paper_topk, "{name} {solver} {library:?}");
            assert!(!solved.canonical, "{name} {solver} {library:?}");
        }
    }
}

#[test]
fn the_column_subset_of_the_blocks() {
    for (name, block) in blocks() {
        let weights: Vec<f64> = block.rows().iter().map(norm).collect();
        let ranked = css::order(&block.n.concat(), &weights, block.k);
        let mut order = vec![0; block.m];
        ranked.rank.iter().zip(0..).for_each(|(&place, i)| order[place as usize] = i);
        assert_eq!(order[..block.k], block.css_order, "{name}");
    }
}
