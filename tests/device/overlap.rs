//! Overlaps on the device.

mod known_pairs;
mod twin;

use crate::support::{Random, device, finish};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::Device;
use qirf_vk::qirf::assemble::{Assembly, Options, symmetric};
use qirf_vk::qirf::overlap::Metric;
use qirf_vk::qirf::plan::triangle;
use twin::Twin;

pub use qirf_vk::selftest::overlap::{Row, model};

/// All blocks' packed overlaps, one after the other.
fn overlaps(device: &Device, rows: &[Row], starts: &[u32], metric: Metric, batch_bytes: usize) -> Vec<f32> {
    let resident = Resident::upload(device, &model(rows)).unwrap();
    let members: Vec<u32> = (0..rows.len() as u32).collect();
    let options = Options { metric, batch_bytes, ..Options::default() };
    let assembly = Assembly::new(device, &resident, &members, starts, &[], options).unwrap();
    let mut all = Vec::new();
    assembly
        .for_each::<qirf_vk::gpu::Error>(|batch| {
            batch.iter().for_each(|(_, b)| all.extend_from_slice(b.overlap));
            Ok(())
        })
        .unwrap();
    all
}

/// N of each pair of successive rows.
fn pairs(device: &Device, rows: &[Row], metric: Metric) -> Vec<f32> {
    let starts: Vec<u32> = (0..=rows.len() as u32 / 2).map(|b| 2 * b).collect();
    let all = overlaps(device, rows, &starts, metric, 1 << 20);
    assert_eq!(all.len(), 3 * (rows.len() / 2));
    assert!(all.chunks_exact(3).all(|t| t[0] == 1.0 && t[2] == 1.0), "the diagonal is exactly 1");
    all.chunks_exact(3).map(|t| t[1]).collect()
}

fn errors(device: &Device, rows: &[Row], metric: Metric) -> (Vec<f64>, usize, f64) {
    let twin = |r: &Row| Twin::new(r.0, r.1, r.2, f64::from(metric.floor), f64::from(metric.dilation));
    let got = pairs(device, rows, metric);
    let nans = got.iter().filter(|n| n.is_nan()).count();
    let expected: Vec<f64> = rows.chunks_exact(2).map(|p| twin(&p[0]).overlap(&twin(&p[1]))).collect();
    let felt = expected.iter().filter(|n| **n > 0.01).count() as f64 / expected.len() as f64;
    let mut errors: Vec<f64> =
        got.iter().zip(&expected).filter(|(g, _)| !g.is_nan()).map(|(g, e)| (f64::from(*g) - e).abs()).collect();
    errors.sort_by(f64::total_cmp);
    (errors, nans, felt)
}

#[test]
fn dilation_is_a_sphere_added() {
    let device = device();
    let (rows, _) = blocks(&[600], 3);
    for dilation in [1e-4_f32, 0.3, 1e3] {
        let (errors, nans, felt) = errors(&device, &rows, Metric { dilation, ..Metric::default() });
        println!("dilation {dilation}: worst error {:.1e}, {felt:.2} felt", errors[errors.len() - 1]);
        assert!(nans == 0 && errors[errors.len() - 1] <= 1e-5);
    }
    finish(&device);
}

/// Blocks of these sizes, with random Gaussians.
pub fn blocks(sizes: &[usize], seed: u64) -> (Vec<Row>, Vec<u32>) {
    let mut r = Random(seed);
    let n: usize = sizes.iter().sum();
    let rows = (0..n)
        .map(|_| {
            (
                [0; 3].map(|_| r.within(-1.0, 1.0) as f32),
                [0; 3].map(|_| r.within(-5.0, 0.0) as f32),
                [0; 4].map(|_| r.within(-1.0, 1.0) as f32),
            )
        })
        .collect();
    let starts = std::iter::once(0)
        .chain(sizes.iter().scan(0, |at, m| {
            *at += *m as u32;
            Some(*at)
        }))
        .collect();
    (rows, starts)
}

#[test]
fn every_entry_of_every_block_whatever_the_batch() {
    let device = device();
    let sizes = [1, 2, 7, 8, 9, 0, 31, 33, 64, 65, 1, 300, 3, 129];
    let (rows, starts) = blocks(&sizes, 11);
    let metric = Metric::default();
    let whole = overlaps(&device, &rows, &starts, metric, 64 << 20);
    assert_eq!(whole.len(), sizes.iter().map(|m| triangle(*m)).sum::<usize>());
    for bytes in [0, 4 * 300, 1 << 15] {
        let other = overlaps(&device, &rows, &starts, metric, bytes);
        assert!(whole.iter().zip(&other).all(|(a, b)| a.to_bits() == b.to_bits()), "batches of {bytes} bytes");
    }
    let mut at = 0;
    for (b, m) in sizes.iter().enumerate() {
        let twins: Vec<Twin> =
            (0..*m).map(|k| rows[starts[b] as usize + k]).map(|r| Twin::new(r.0, r.1, r.2, 1e-3, 0.0)).collect();
        for c in 0..*m {
            for r in c..*m {
                let expected = if r == c { 1.0 } else { twins[r].overlap(&twins[c]) };
                assert!((f64::from(whole[at]) - expected).abs() <= 1e-5, "block {b}, row {r}, column {c}");
                at += 1;
            }
        }
    }
    finish(&device);
}

#[test]
fn values_that_are_no_numbers_stay_where_they_are() {
    values_not_finite(&device());
}

pub fn values_not_finite(device: &Device) {
    let fine: Row = ([0.0; 3], [-1.0, -2.0, -3.0], [1.0, 0.0, 0.0, 0.0]);
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38];
    let mut rows = vec![fine, fine];
    for v in bad {
        rows.push(([v, 0.0, 0.0], fine.1, fine.2));
        rows.push((fine.0, [v, -2.0, -3.0], fine.2));
        rows.push((fine.0, fine.1, [v, 0.0, 0.0, 0.0]));
    }
    rows.push((fine.0, fine.1, [0.0; 4]));
    let m = rows.len();
    let got = overlaps(device, &rows, &[0, m as u32], Metric::default(), 1 << 20);
    assert!(got.iter().all(|n| (0.0..=1.0).contains(n)), "{got:?}");
    let square: Vec<f64> = symmetric(m, &got);
    assert!((0..m).all(|i| square[i * m + i] == 1.0));
    assert!((square[1] - 1.0).abs() < 1e-6 && (square[m - 1] - 1.0).abs() < 1e-6, "same Gaussian; no rotation");
    assert!(square[2] == 0.0, "a NaN mean overlaps with nothing");
    finish(device);
}
