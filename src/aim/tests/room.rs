//! A room under a far sky, whose files were measured: merging costs much, and only the finest rungs are good.

use super::*;

/// Gaussians of the room: more than a small model has.
const ROOM: usize = 6000;

/// PSNR of the whole model by rung.
const WHOLE: [(f64, f64); 10] = [
    (0.0, 19.0),
    (16.0, 24.69),
    (24.0, 27.05),
    (32.0, 30.0),
    (40.0, 34.88),
    (41.0, 35.9),
    (42.0, 36.9),
    (43.0, 38.31),
    (45.0, 41.79),
    (48.0, 51.89),
];
/// Bytes of a Gaussian by rung.
const EACH: [(f64, f64); 8] =
    [(0.0, 4.5), (16.0, 9.0), (24.0, 12.05), (32.0, 17.6), (40.0, 28.1), (42.0, 32.9), (45.0, 41.6), (48.0, 53.2)];
/// PSNR by the number of Gaussians at rungs 16, 40, 43 and 48.
const AT_16: [(f64, f64); 7] =
    [(1.0, 8.0), (231.0, 18.44), (500.0, 20.73), (926.0, 22.18), (2000.0, 23.03), (3704.0, 23.81), (6000.0, 24.69)];
const AT_40: [(f64, f64); 7] =
    [(1.0, 8.0), (608.0, 22.9), (1366.0, 26.5), (2731.0, 30.18), (4515.0, 32.93), (5689.0, 34.46), (6000.0, 34.88)];
const AT_43: [(f64, f64); 7] =
    [(1.0, 8.0), (608.0, 23.2), (1366.0, 27.0), (3000.0, 31.87), (4500.0, 35.09), (5923.0, 38.16), (6000.0, 38.31)];
const AT_48: [(f64, f64); 13] = [
    (1.0, 8.0),
    (521.0, 22.82),
    (732.0, 24.81),
    (965.0, 26.5),
    (1324.0, 28.12),
    (2076.0, 31.16),
    (2555.0, 33.33),
    (3195.0, 36.24),
    (3820.0, 39.36),
    (4383.0, 42.1),
    (4938.0, 45.07),
    (5346.0, 49.57),
    (6000.0, 51.89),
];

fn room() -> Files<impl Fn(usize, usize) -> u64, impl Fn(usize, usize) -> f64> {
    let size = |rung: usize, n: usize| 2000 + (n as f64 * between(&EACH, rung as f64)) as u64;
    let quality = |rung: usize, n: usize| {
        let (rung, number) = (rung as f64, n as f64);
        let coarse = between(&AT_16, number);
        let [middle, fine, finest] = [&AT_40[..], &AT_43, &AT_48].map(|known| between(known, number));
        let merged = [(0.0, coarse - 5.0), (16.0, coarse), (40.0, middle), (43.0, fine), (48.0, finest)];
        if n == ROOM { between(&WHOLE, rung) } else { between(&merged, rung) }
    };
    Files { size, quality, encodes: 0 }
}

/// The rung that needs the fewest bytes is among the last to be tried: attempts are left for it.
#[test]
fn the_best_rung_of_a_large_model_is_searched_to_its_end() {
    let steps: Vec<usize> = (0..=48).step_by(8).collect();
    let trials = room();
    let numbers = (0..=48).flat_map(|rung| (1..=ROOM).rev().step_by(13).map(move |n| (rung, n)));
    let files: Vec<(u64, f64)> = numbers.map(|(rung, n)| ((trials.size)(rung, n), (trials.quality)(rung, n))).collect();
    let mut sum = 0.0;
    for halves in 54..103 {
        let wanted = f64::from(halves) / 2.0;
        let (best, tried) = found(&mut room(), ROOM, &steps, Aim::Psnr(wanted));
        let smallest = files.iter().filter(|(_, psnr)| *psnr >= wanted).map(|(bytes, _)| *bytes).min().unwrap();
        let share = best.bytes as f64 / smallest as f64;
        assert!(best.psnr >= Some(wanted) && share < 1.1, "{wanted}: {best:?}, {smallest}; {tried:?}");
        assert!(tried.len() <= MOST + 3 + psnr::TO_SHRINK, "{wanted}: {tried:?}");
        sum += share;
    }
    assert!(sum / 49.0 < 1.035, "{}", sum / 49.0);
}
