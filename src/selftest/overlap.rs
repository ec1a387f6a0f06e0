//! Overlaps of pairs: the embedded ones with known results, and random ones against the float64 twin.

use super::Allowed::{Exact, Rounding};
use super::Measure;
use super::hard;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{Device, Error, Result};
use crate::qirf::assemble::{Assembly, Options};
use crate::qirf::overlap::{Method, Metric};
use crate::random::Random;
use crate::reference::overlap::{Primitive, overlap};
use glam::{DMat3, DQuat, DVec3};

/// Centre, log-scales, quaternion.
pub type Row = ([f32; 3], [f32; 3], [f32; 4]);

/// A model with these rows, without colour and half transparent.
pub fn model(rows: &[Row]) -> Gaussians {
    Gaussians {
        means: rows.iter().map(|r| r.0).collect(),
        log_scales: rows.iter().map(|r| r.1).collect(),
        rotations: rows.iter().map(|r| r.2).collect(),
        ..Gaussians::zeroed(rows.len(), 0)
    }
}

/// N of each pair of successive rows, computed on the device.
pub fn on_device(device: &Device, rows: &[Row], metric: Metric) -> Result<Vec<f32>> {
    let resident = Resident::upload(device, &model(rows))?;
    let members: Vec<u32> = (0..rows.len() as u32).collect();
    let starts: Vec<u32> = (0..=rows.len() as u32 / 2).map(|b| 2 * b).collect();
    let options = Options { metric, ..Options::default() };
    let mut all = Vec::with_capacity(rows.len() / 2);
    Assembly::new(device, &resident, &members, &starts, &[], options)?.for_each::<Error>(|batch| {
        all.extend(batch.iter().map(|(_, block)| block.overlap[1]));
        Ok(())
    })?;
    Ok(all)
}

/// The pairs of known overlap, each once in each order.
pub fn known_rows() -> Vec<(&'static str, hard::Pair, [Row; 4])> {
    let narrow = |v: [f64; 3]| v.map(|x| x as f32);
    let logs = |v: [f64; 3]| v.map(|x| (x as f32).ln());
    let rows = |pair: &hard::Pair| {
        let a = (narrow(pair.p1), logs(pair.s1), pair.q1.map(|x| x as f32));
        let b = (narrow(pair.p2), logs(pair.s2), pair.q2.map(|x| x as f32));
        [a, b, b, a]
    };
    hard::pairs().map(|(name, pair)| (name, pair.clone(), rows(&pair))).collect()
}

/// The pairs' own tolerances apply without a floor under the scales; with a floor the identical disc must be exact.
pub(super) fn known(device: &Device) -> Result<Vec<Measure>> {
    let mut measures = Vec::new();
    let known = known_rows();
    for (name, pair, rows) in &known {
        let (mut seen, mut floored) = (0.0_f64, 0.0_f64);
        for (floor, worst) in [(0.0, &mut seen), (1e-3, &mut floored)] {
            for n in on_device(device, rows, Metric { floor, ..Metric::default() })? {
                *worst = worse(*worst, (f64::from(n) - pair.expected).abs());
            }
        }
        if name.starts_with("P1_") {
            measures.push((*name, seen, Rounding(pair.abs_tol_f32)));
            // With the floor, its discs are as thick as the others', and its overlap must be as accurate.
            measures.push(("P1 floored", floored, Rounding(1e-5)));
        } else {
            measures.push((*name, worse(seen, floored), Rounding(pair.abs_tol_f32)));
        }
    }
    measures.push(("pairs missing", known.len().abs_diff(12) as f64, Exact(0.0)));
    Ok(measures)
}

/// Maximum; infinite if `b` is NaN.
pub(super) fn worse(a: f64, b: f64) -> f64 {
    if b.is_nan() { f64::INFINITY } else { a.max(b) }
}

/// `count` pairs of anisotropy 1..1e6 at scene scales 2^-40..2^40, half of them up to 1e4 units from the origin, a few
/// deviations apart, with random orientations and sizes or, if `parallel`, nearly parallel.
pub fn random_rows(count: usize, parallel: bool, seed: u64) -> Vec<Row> {
    let mut r = Random(seed);
    let mut rows = Vec::with_capacity(2 * count);
    for _ in 0..count {
        let unit = 2_f64.powf(r.within(-40.0, 40.0));
        let scales = |r: &mut Random| {
            let thin = 10_f64.powf(-r.within(0.0, 6.0));
            let mut s = [1.0, thin.powf(r.within(0.0, 1.0)), thin];
            s.rotate_left(r.within(0.0, 3.0) as usize);
            s
        };
        let quaternion = |r: &mut Random| [0; 4].map(|_| r.within(-1.0, 1.0));
        let (sa, qa) = (scales(&mut r), quaternion(&mut r));
        let (sb, qb) = if parallel {
            let tilt = 10_f64.powf(r.within(-7.0, -1.0));
            (sa.map(|s| s * r.within(0.5, 2.0)), qa.map(|q| q + tilt * r.within(-1.0, 1.0)))
        } else {
            let size = 2_f64.powf(r.within(-3.0, 3.0));
            (scales(&mut r).map(|s| s * size), quaternion(&mut r))
        };
        let far = [0; 3].map(|_| r.within(-1e4, 1e4) * unit);
        let far = if r.within(0.0, 1.0) < 0.5 { far } else { [0.0; 3] };
        let axes = DMat3::from_quat(DQuat::from_xyzw(qa[1], qa[2], qa[3], qa[0]).normalize());
        let reach = 10_f64.powf(r.within(-1.0, 0.5)) * unit;
        let apart = axes * (DVec3::from(sa) * DVec3::from([0; 3].map(|_| r.within(-1.0, 1.0)))) * reach;
        let narrow = |v: DVec3| v.as_vec3().to_array();
        let logs = |s: [f64; 3]| s.map(|x| (x * unit).ln() as f32);
        rows.push((narrow(DVec3::from(far)), logs(sa), qa.map(|x| x as f32)));
        rows.push((narrow(DVec3::from(far) + apart), logs(sb), qb.map(|x| x as f32)));
    }
    rows
}

/// Errors against the twin, ascending, and the number of NaNs.
pub fn errors(device: &Device, rows: &[Row], method: Method) -> Result<(Vec<f64>, usize)> {
    let primitive = |r: &Row| Primitive::of(r.0, r.1, r.2);
    let got = on_device(device, rows, Metric { method, ..Metric::default() })?;
    let expected = rows.chunks_exact(2).map(|p| overlap(&primitive(&p[0]), &primitive(&p[1])));
    let mut errors: Vec<f64> = got.iter().zip(expected).map(|(g, e)| (f64::from(*g) - e).abs()).collect();
    errors.retain(|e| !e.is_nan());
    errors.sort_by(f64::total_cmp);
    let nan = got.len() - errors.len();
    Ok((errors, nan))
}

/// Compares the overlaps of `count` random pairs with the twin's.
pub(super) fn random(device: &Device, count: usize) -> Result<Vec<Measure>> {
    let mut measures = Vec::new();
    // Float32 rounds each axis by 6e-8. Near-parallel discs at the floor of 1e-3 amplify this a thousandfold, in
    // distance and in tilt: 5e-5, and 1.8e-4 if roots and quotients are off by two roundings.
    for (parallel, seed, allowed) in [(false, 41, 1e-5), (true, 42, 4e-4)] {
        let (errors, nan) = errors(device, &random_rows(count, parallel, seed), Method::Qr)?;
        let most = errors.last().copied().unwrap_or(f64::INFINITY);
        measures.push((if parallel { "near-parallel, largest" } else { "any, largest" }, most, Rounding(allowed)));
        measures.push((if parallel { "near-parallel, NaN" } else { "any, NaN" }, nan as f64, Exact(0.0)));
    }
    Ok(measures)
}
