//! Models whose bytes are not proportional to the number of Gaussians: a poster, copies, and a file of few Gaussians with a long header.

use super::*;

/// Values by rung, of lines between known points.
type ByRung<'a> = &'a [(f64, &'a [(f64, f64)])];

/// The value at a rung and a number of Gaussians.
fn at(known: ByRung, rung: usize, n: usize) -> f64 {
    let of_rung: Vec<_> = known.iter().map(|(rung, by_number)| (*rung, between(by_number, n as f64))).collect();
    between(&of_rung, rung as f64)
}

/// The most dB that files of these sizes lack against the best one there is of a number in steps of `step`, and that one lacks against
/// that of a smaller size; the least share of the size.
fn worst<B: Fn(usize, usize) -> u64, P: Fn(usize, usize) -> f64>(
    files: impl Fn() -> Files<B, P>,
    (whole, step): (usize, usize),
    steps: &[usize],
    sizes: impl Iterator<Item = u64>,
) -> [f64; 3] {
    let model = files();
    let numbers = (0..=steps[steps.len() - 1]).flat_map(|rung| (1..=whole).rev().step_by(step).map(move |n| (rung, n)));
    let all: Vec<(u64, f64)> = numbers.map(|(rung, n)| ((model.size)(rung, n), (model.quality)(rung, n))).collect();
    let (mut lost, mut fall, mut share, mut before) = (0.0_f64, 0.0_f64, 1.0_f64, 0.0_f64);
    for size in sizes {
        let mut trials = files();
        let (best, tried) = found(&mut trials, whole, steps, Aim::Bytes(size));
        assert!(best.bytes <= size && trials.encodes <= MOST, "{size}: {best:?}; {tried:?}");
        let psnr = best.psnr.unwrap();
        let most = all.iter().filter(|(bytes, _)| *bytes <= size).map(|(_, psnr)| *psnr).fold(0.0, f64::max);
        (lost, fall, before) = (lost.max(most - psnr), fall.max(before - psnr), before.max(psnr));
        if best.gaussians < whole {
            share = share.min(best.bytes as f64 / size as f64);
        }
    }
    [lost, fall, share]
}

/// Gaussians of [`poster`].
const POSTER: usize = 28_000;

/// Equal Gaussians on a grid, after measured files: merged ones take more bytes.
fn poster() -> Files<impl Fn(usize, usize) -> u64, impl Fn(usize, usize) -> f64> {
    const BYTES: ByRung = &[
        (0.0, &[(1.0, 1100.0), (13_586.0, 29_600.0), (23_489.0, 39_530.0), (28_000.0, 32_500.0)]),
        (8.0, &[(1.0, 1100.0), (10_046.0, 27_000.0), (20_703.0, 41_900.0), (24_500.0, 43_000.0), (28_000.0, 38_694.0)]),
        (16.0, &[(1.0, 1100.0), (6859.0, 23_097.0), (15_009.0, 38_900.0), (25_780.0, 48_114.0), (28_000.0, 43_426.0)]),
        (24.0, &[(1.0, 1200.0), (7263.0, 27_631.0), (13_261.0, 42_036.0), (25_145.0, 58_562.0), (28_000.0, 54_000.0)]),
        (
            48.0,
            &[(1.0, 1500.0), (7263.0, 53_600.0), (13_261.0, 81_500.0), (25_145.0, 113_600.0), (28_000.0, 104_800.0)],
        ),
    ];
    const MERGED: [(f64, f64); 8] = [
        (1.0, 8.0),
        (1324.0, 20.0),
        (7000.0, 29.0),
        (13_000.0, 32.9),
        (21_500.0, 40.3),
        (25_000.0, 42.5),
        (27_478.0, 48.0),
        (28_000.0, 54.0),
    ];
    const ROUNDING: [(f64, f64); 5] = [(0.0, 41.0), (8.0, 48.0), (16.0, 50.1), (24.0, 52.0), (48.0, 62.0)];
    let size = |rung, n| at(BYTES, rung, n) as u64;
    let quality = |rung: usize, n| sum([between(&MERGED, n as f64), between(&ROUNDING, rung as f64)], n == POSTER);
    Files { size, quality, encodes: 0 }
}

#[test]
fn a_whole_model_that_takes_fewer_bytes_than_merged_ones_is_found() {
    let [(_, steps), ..] = ladders();
    let [lost, fall, _] = worst(poster, (POSTER, 100), &steps, (33_000..=46_000).step_by(250));
    assert!(lost < 1.0 && fall < 0.3, "{lost} dB, {fall}");
    for halves in 84..=100 {
        let wanted = f64::from(halves) / 2.0;
        let (best, tried) = found(&mut poster(), POSTER, &steps, Aim::Psnr(wanted));
        let trials = poster();
        let whole = (0..=48).find(|rung| (trials.quality)(*rung, POSTER) >= wanted).unwrap();
        let most = 1.02 * (trials.size)(whole, POSTER) as f64;
        assert!(best.psnr >= Some(wanted) && best.bytes as f64 <= most, "{wanted}: {best:?}, {most}; {tried:?}");
        assert!(tried.len() <= MOST + 3 + psnr::TO_SHRINK, "{wanted}: {tried:?}");
    }
}

/// Gaussians of [`copies`].
const COPIES: usize = 12_000;

/// 4,000 Gaussians three times each, after measured files: the first merges save hardly any bytes.
fn copies() -> Files<impl Fn(usize, usize) -> u64, impl Fn(usize, usize) -> f64> {
    const BYTES: ByRung = &[
        (0.0, &[(1.0, 200.0), (1738.0, 25_574.0), (6000.0, 74_000.0), (8633.0, 84_489.0), (12_000.0, 88_000.0)]),
        (2.0, &[(1.0, 200.0), (2575.0, 42_122.0), (6588.0, 87_697.0), (8633.0, 96_647.0), (12_000.0, 102_500.0)]),
        (4.0, &[(1.0, 200.0), (1063.0, 24_696.0), (4000.0, 85_000.0), (6000.0, 118_000.0), (12_000.0, 150_000.0)]),
        (9.0, &[(1.0, 300.0), (1063.0, 36_300.0), (4000.0, 125_000.0), (6000.0, 173_000.0), (12_000.0, 220_000.0)]),
    ];
    const MERGED: [(f64, f64); 6] =
        [(1.0, 8.0), (1000.0, 25.0), (1738.0, 28.2), (4000.0, 36.0), (8000.0, 41.0), (12_000.0, 60.0)];
    const ROUNDING: [(f64, f64); 4] = [(0.0, 32.0), (2.0, 36.0), (4.0, 42.0), (9.0, 52.0)];
    let size = |rung, n| at(BYTES, rung, n) as u64;
    let quality = |rung: usize, n| sum([between(&MERGED, n as f64), between(&ROUNDING, rung as f64)], n == COPIES);
    Files { size, quality, encodes: 0 }
}

#[test]
fn files_whose_bytes_hardly_fall_with_the_first_merges_are_filled() {
    let (_, steps) = &ladders()[1];
    let [lost, fall, share] = worst(copies, (COPIES, 40), steps, (30_000..=100_000).step_by(1500));
    assert!(lost < 1.0 && fall < 0.3 && share >= 0.95, "{lost} dB, {fall}, {share}");
}

/// A file of floats: the header grows with the degree of SH.
#[test]
fn headers_that_grow_with_the_rung_are_allowed_for() {
    let size = |rung: usize, n: usize| ([1536, 2028, 2872, 4124][rung] + [60, 96, 156, 240][rung] * n) as u64;
    let merged = [(1.0, 8.0), (12.0, 16.5), (26.0, 19.0), (69.0, 24.8), (146.0, 31.0), (192.0, 40.0), (200.0, 50.0)];
    let quality = |rung: usize, n| sum([between(&merged, n as f64), [29.6, 32.5, 38.0, f64::INFINITY][rung]], n == 200);
    let files = || Files { size, quality, encodes: 0 };
    let [lost, fall, share] = worst(files, (200, 1), &[0, 1, 2, 3], (2300..=12_000).step_by(100));
    assert!(lost < 0.7 && fall < 0.1 && share >= 0.95, "{lost} dB, {fall}, {share}");
}

/// A model of strong SH, after measured files: PSNR rises by 2 to 4 dB a step of the ladder, down to a quarter of its Gaussians.
#[test]
fn the_climb_ends_at_the_best_rung() {
    const WHOLE: usize = 5923;
    const ROUNDING: [(f64, f64); 5] = [(0.0, 31.0), (16.0, 39.0), (24.0, 43.0), (32.0, 46.3), (48.0, 58.0)];
    const MERGED: [(f64, f64); 4] = [(363.0, 40.5), (728.0, 44.5), (1557.0, 48.6), (5923.0, 60.0)];
    const EACH: [(f64, f64); 6] = [(0.0, 4.7), (16.0, 8.7), (24.0, 11.1), (32.0, 15.3), (40.0, 22.9), (48.0, 45.0)];
    let size = |rung: usize, n: usize| {
        (600.0 + between(&EACH, rung as f64) * n as f64 * (1.0 - 0.02 * (n as f64 / 3000.0).ln())) as u64
    };
    let quality = |rung: usize, n| sum([between(&MERGED, n as f64), between(&ROUNDING, rung as f64)], n == WHOLE);
    let files = || Files { size, quality, encodes: 0 };
    let [(_, steps), ..] = ladders();
    let [lost, fall, share] = worst(files, (WHOLE, 20), &steps, (8_000..=60_000).step_by(1000));
    assert!(lost < 0.7 && fall < 0.1 && share >= 0.95, "{lost} dB, {fall}, {share}");
}
