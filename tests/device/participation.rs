//! Participation on the device against its float64 twin.

use super::overlap::{blocks, model};
use crate::support::{Random, device, finish};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Device, Error};
use qirf_vk::qirf::assemble::{Assembly, Options, symmetric};
use qirf_vk::qirf::participation::device::Problem;
use qirf_vk::qirf::rrdm::Density;
use qirf_vk::reference::participation::{Participation as Twin, participation};
use qirf_vk::selftest::participation::{Matrices, solutions};

#[test]
fn the_devices_solver_agrees_with_float64() {
    let device = device();
    let sizes = [1, 3, 8, 9, 20, 33, 0, 48, 64, 150];
    let (rows, starts) = blocks(&sizes, 21);
    let n = rows.len();
    let mut r = Random(8);
    let h: Vec<[f32; 8]> = (0..n).map(|_| [0; 8].map(|_| r.unit().powi(3) as f32)).collect();
    let members: Vec<u32> = (0..n as u32).rev().collect();
    let resident = Resident::upload(&device, &model(&rows)).unwrap();
    let options = Options { density: Some(Density::default()), batch_bytes: 4 * 2000, ..Options::default() };
    let assembly = Assembly::new(&device, &resident, &members, &starts, &h, options).unwrap();
    assert!(assembly.batches().len() > 2);
    let problem = Problem::default();
    let mut expected = Vec::new();
    assembly
        .for_each::<Error>(|batch| {
            for (_, block) in batch.iter() {
                let square: Vec<f64> = symmetric(block.m, block.overlap);
                let (w, scales) = (block.rows().0, block.scales());
                let h: Vec<[f64; 8]> = w.iter().map(|row| std::array::from_fn(|c| row[c] * scales[c])).collect();
                let (epsilon, tau) = (f64::from(problem.epsilon), f64::from(problem.tau));
                let twin =
                    |rows: &[[f64; 8]]| participation(&square, rows, epsilon, tau).expect("a positive definite metric");
                expected.push((twin(&w), twin(&h).q));
            }
            Ok(())
        })
        .unwrap();
    let mut seen = 0;
    let mut bits = Vec::new();
    assembly
        .solve_each::<Error>(problem, |b, s| {
            let (Twin { spectrum, r, q }, gain) = &expected[b];
            let lambda: [f64; 8] = std::array::from_fn(|k| spectrum.get(k).copied().unwrap_or(0.0));
            assert_eq!(s.q.len(), sizes[b]);
            assert!(!s.failed, "block {b}");
            let by_lambda =
                (0..8).map(|k| (f64::from(s.lambda[k]) - lambda[k]).abs()).fold(0.0, f64::max) / lambda[0].max(1e-30);
            let apart = |got: &[f32], expected: &[f64]| {
                let most = expected.iter().copied().fold(1e-30, f64::max);
                got.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max) / most
            };
            let (by_q, by_gain) = (apart(s.q, q), apart(s.gain, gain));
            println!(
                "block {b} of {}: r {} ({r}), lambda {by_lambda:.1e}, q {by_q:.1e}, gain {by_gain:.1e}",
                sizes[b], s.r
            );
            assert_eq!(s.r, *r, "block {b}");
            assert!(
                by_lambda < 1e-4 && by_q < 1e-3 && by_gain < 1e-3,
                "block {b}: {by_lambda:.1e}, {by_q:.1e}, {by_gain:.1e}"
            );
            bits.extend(s.q.iter().map(|v| v.to_bits()));
            seen += 1;
            Ok(())
        })
        .unwrap();
    assert_eq!(seen, sizes.len());
    let mut again = Vec::new();
    assembly
        .solve_each::<Error>(problem, |_, s| {
            again.extend(s.q.iter().map(|v| v.to_bits()));
            Ok(())
        })
        .unwrap();
    assert_eq!(bits, again);
    finish(&device);
}

/// Batches of many blocks: the dispatch for one batch touches no other.
#[test]
fn many_blocks_whatever_the_batch() {
    let device = device();
    let (rows, starts) = blocks(&[3; 240], 17);
    let mut r = Random(9);
    let h: Vec<[f32; 8]> = rows.iter().map(|_| [0; 8].map(|_| r.unit() as f32)).collect();
    let members: Vec<u32> = (0..rows.len() as u32).collect();
    let resident = Resident::upload(&device, &model(&rows)).unwrap();
    let results = [4 * 6 * 80, 1 << 20].map(|batch_bytes| {
        let density = Some(Density { full: true, ..Density::default() });
        let options = Options { density, batch_bytes, ..Options::default() };
        let assembly = Assembly::new(&device, &resident, &members, &starts, &h, options).unwrap();
        let mut bits = Vec::new();
        assembly
            .for_each::<Error>(|batch| {
                for (_, block) in batch.iter() {
                    let parts = [block.overlap, block.factor, &block.divisors, block.density];
                    bits.extend(parts.into_iter().flatten().map(|v| v.to_bits()));
                }
                Ok(())
            })
            .unwrap();
        assembly
            .solve_each::<Error>(Problem::default(), |_, solved| {
                bits.extend(solved.q.iter().map(|v| v.to_bits()));
                Ok(())
            })
            .unwrap();
        (assembly.batches().len(), bits)
    });
    let [(few, one), (many, other)] = results;
    assert_eq!((few, many), (3, 1));
    assert!(one == other);
    finish(&device);
}

#[test]
fn a_metric_that_is_not_positive_definite_is_said_to_have_failed() {
    let device = device();
    // Three clones without epsilon: the second pivot is zero.
    let (one, _) = blocks(&[1], 3);
    let (other, _) = blocks(&[4], 5);
    let rows: Vec<_> = [one[0], one[0], one[0]].into_iter().chain(other).collect();
    let resident = Resident::upload(&device, &model(&rows)).unwrap();
    let options = Options { density: Some(Density::default()), ..Options::default() };
    let members: Vec<u32> = (0..7).collect();
    let assembly = Assembly::new(&device, &resident, &members, &[0, 3, 7], &[[1.0; 8]; 7], options).unwrap();
    let mut failed = Vec::new();
    assembly
        .solve_each::<Error>(Problem { epsilon: 0.0, ..Problem::default() }, |_, s| {
            assert!(s.q.iter().all(|v| v.is_finite()));
            failed.push(s.failed);
            Ok(())
        })
        .unwrap();
    assert_eq!(failed, [true, false]);
    finish(&device);
}

/// Blocks of 1 to 8 identical members, with equal responses or none: results are finite and equal, and zero without a
/// response.
#[test]
fn equals_in_blocks_of_one_to_eight() {
    let device = device();
    let (one, _) = blocks(&[1], 3);
    let rows: Vec<_> = (1..=8).flat_map(|m| vec![one[0]; m]).collect();
    let starts: Vec<u32> = (0..=8).map(|m| m * (m + 1) / 2).collect();
    let members: Vec<u32> = (0..rows.len() as u32).collect();
    let resident = Resident::upload(&device, &model(&rows)).unwrap();
    for response in [0.0_f32, 1.0, 1e-30, 1e15] {
        let options = Options { density: Some(Density::default()), ..Options::default() };
        let h = vec![[response; 8]; rows.len()];
        let assembly = Assembly::new(&device, &resident, &members, &starts, &h, options).unwrap();
        assembly
            .solve_each::<Error>(Problem::default(), |b, s| {
                let told = format!("{} alike, response {response}: {s:?}", b + 1);
                let all = || s.q.iter().chain(s.gain).chain(&s.lambda);
                assert!(s.q.len() == b + 1 && s.gain.len() == b + 1 && all().all(|v| v.is_finite()), "{told}");
                assert!(!s.failed && (response > 0.0 || all().all(|v| *v == 0.0)), "{told}");
                // m equal functions share one: their parts may differ by rounding divided by epsilon, 6e-8 / 1e-4.
                let most = s.q.iter().copied().fold(0.0, f32::max);
                assert!(s.q.iter().all(|q| most - q <= 2e-2 * most), "{told}");
                Ok(())
            })
            .unwrap();
    }
    finish(&device);
}

/// Blocks with an overlap or a response that is not finite fail and report it; their neighbours are not affected.
#[test]
fn blocks_that_are_not_finite_fail() {
    not_finite(&device());
}

pub fn not_finite(device: &Device) {
    let m = 11_u64;
    let triangle = m * (m + 1) / 2;
    let mut r = Random(12);
    let near = |r: u64, c: u64| if r == c { 1.0 } else { 0.5_f32.powi((r - c) as i32) };
    let overlaps: Vec<f32> = (0..m).flat_map(|c| (c..m).map(move |r| near(r, c))).collect();
    let factors: Vec<f32> = (0..8 * m).map(|_| r.within(0.1, 1.0) as f32).collect();
    let sound = || Matrices { triangle: overlaps.clone(), factor: factors.clone() };
    let right = solutions(device, &[sound()], 1e-4).unwrap();
    assert!(right[0].iter().all(|v| v.is_finite()) && right[0].last() == Some(&0.0));
    for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38] {
        let spoilt_by = |entries: &[u64], factor_entries: &[u64]| {
            let (mut n, mut w) = (overlaps.clone(), factors.clone());
            for k in entries {
                n[*k as usize] = bad;
            }
            for k in factor_entries {
                w[*k as usize] = bad;
            }
            Matrices { triangle: n, factor: w }
        };
        let all: Vec<u64> = (0..8 * m).collect();
        let blocks = [
            spoilt_by(&[3], &[]),
            spoilt_by(&[0], &[]),
            spoilt_by(&[], &[5]),
            sound(),
            spoilt_by(&[triangle - 1], &[]),
            spoilt_by(&[], &[2 * m, 7 * m + 3]),
            spoilt_by(&[], &all),
        ];
        let got = solutions(device, &blocks, 1e-4).unwrap();
        let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&got[3]), bits(&right[0]), "{bad}: the sound one");
        for (b, solution) in got.iter().enumerate().filter(|(b, _)| *b != 3) {
            let (failed, rest) = solution.split_last().unwrap();
            // An overlap of 3e38 is finite, and its Cholesky factor may be finite, too.
            if bad.is_finite() && *failed == 0.0 {
                continue;
            }
            assert!(*failed == 1.0 && rest.iter().all(|v| *v == 0.0), "{bad}, block {b}: {solution:?}");
        }
    }
    finish(device);
}
