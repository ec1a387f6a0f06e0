//! A model of 900 Gaussians whose PSNR was measured at two rungs; it grows by fits and starts.

use super::*;

fn uneven() -> Files<impl Fn(usize, usize) -> u64, impl Fn(usize, usize) -> f64> {
    let coarse = [
        (1.0, 8.0),
        (216.0, 25.0),
        (432.0, 30.23),
        (477.0, 31.01),
        (523.0, 32.07),
        (544.0, 32.61),
        (603.0, 34.236),
        (622.0, 34.26),
        (695.0, 35.335),
        (899.0, 38.0),
    ];
    let fine = [
        (1.0, 8.0),
        (216.0, 26.0),
        (432.0, 30.7),
        (536.0, 33.06),
        (572.0, 33.99),
        (582.0, 34.96),
        (613.0, 35.6),
        (686.0, 37.16),
        (733.0, 38.02),
        (899.0, 42.0),
    ];
    let size = |rung, n| 700 + (n as f64 * 10.6 * 1.0172_f64.powi(rung as i32 - 16)) as u64;
    let quality = move |rung, n| {
        let (finer, n) = (rung as f64 - 16.0, n as f64);
        let [low, high] = [&coarse, &fine].map(|known| between(known, n));
        if n < UNEVEN as f64 { low + (high - low) * finer / 8.0 } else { 40.0 + 0.6 * finer }
    };
    Files { size, quality, encodes: 0 }
}

/// Gaussians of [`uneven`].
const UNEVEN: usize = 900;

#[test]
fn every_psnr_of_a_small_model_is_met_as_nearly_as_one_gaussian_allows_by_a_small_file() {
    let steps: Vec<usize> = (0..=48).step_by(8).collect();
    let mut largest = 0;
    for tenths in 300..380 {
        let wanted = f64::from(tenths) / 10.0;
        let mut trials = uneven();
        let (best, tried) = found(&mut trials, UNEVEN, &steps, Aim::Psnr(wanted));
        let reach = |n: &usize, rung| (trials.quality)(rung, *n) >= wanted;
        let of_rung = |rung| (1..=UNEVEN).find(|n| reach(n, rung)).map(|n| (trials.size)(rung, n));
        let smallest = (0..=48).filter_map(of_rung).min().unwrap();
        let fewer = (trials.quality)(best.rung, best.gaussians - 1);
        assert!(best.psnr <= Some(wanted + 0.1) || fewer < wanted, "{wanted}: {best:?}; {tried:?}");
        assert!(best.bytes as f64 <= 1.1 * smallest as f64, "{wanted}: {best:?}, {smallest}; {tried:?}");
        assert!(tried.iter().all(|file| file.psnr < Some(wanted) || file.bytes >= best.bytes), "{wanted}: {tried:?}");
        assert!(best.bytes as f64 >= 0.92 * largest as f64, "{wanted}: {best:?} after {largest} bytes for less");
        largest = largest.max(best.bytes);
    }
}
