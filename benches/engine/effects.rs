//! `effects`: time that each effect adds to an iteration, compared in turns with one that has all of them off; and all
//! off against all off, which shows how far equal runs differ here.

use super::iteration::{options, scene, train};
use super::{device, facts, group};
use criterion::{BenchmarkId, Criterion};
use qirf_vk::render::Style;
use qirf_vk::scene::{AlphaRole, DepthMap, Photo};
use qirf_vk::train::{Exposures, Options, Trainer};
use std::time::Duration;

/// Iterations per turn.
const TURN: u32 = 2;

/// The rows: the effects that are on in each, and the meaning of the photo's fourth byte.
fn arms() -> Vec<(&'static str, Options, AlphaRole)> {
    let style = |antialias, depth_order| Style { antialias, depth_order, ..Style::default() }.over([0.0; 3]);
    let opaque = AlphaRole::Opaque;
    vec![
        ("all off, again", options(0), opaque),
        ("view_dependence, degree 1", options(1), opaque),
        ("view_dependence, degree 3", options(3), opaque),
        ("exposure", Options { exposure: Some(Exposures::Learnt(Vec::new())), ..options(0) }, opaque),
        ("poses", Options { poses: true, ..options(0) }, opaque),
        ("dropout", Options { dropout: true, ..options(0) }, opaque),
        ("depth loss", Options { depth_loss: true, ..options(0) }, opaque),
        ("antialias", Options { settings: style(true, false), ..options(0) }, opaque),
        ("transparency", options(0), AlphaRole::Alpha),
        ("masks", options(0), AlphaRole::Mask),
        ("depth_order", Options { settings: style(false, true), ..options(0) }, opaque),
    ]
}

/// A trainer after compilation and warm-up.
fn trainer(options: Options, alpha_role: AlphaRole) -> Trainer {
    let (model, _, photo) = scene(options.degree);
    let map = DepthMap { width: 1, height: 1, depths: vec![4.0].into(), unit: 1.0 };
    let photo = Photo { alpha_role, depth: Some(map), ..photo };
    let mut trainer = Trainer::new(device(), &model, vec![photo], 1.0, options).unwrap();
    train(&mut trainer, 16);
    trainer
}

/// Poses cost most here: with one photo cameras move after every iteration, for which the host waits. Distortion is left out: photos are resampled when they are loaded, which does not affect iterations.
pub fn effects(criterion: &mut Criterion) {
    let mut group = group(criterion, "effects");
    let mut off = trainer(options(0), AlphaRole::Opaque);
    for (order, (name, options, alpha_role)) in arms().into_iter().enumerate() {
        let mut on = trainer(options, alpha_role);
        let mut ratios = Vec::new();
        group.bench_function(BenchmarkId::new(name, "10k"), |b| {
            b.iter_custom(|iterations| {
                let (mut left, mut times) = (iterations as u32, [Duration::ZERO; 2]);
                while left > 0 {
                    let turn = left.min(TURN);
                    times[0] += train(&mut off, turn);
                    times[1] += train(&mut on, turn);
                    left -= turn;
                }
                ratios.push(times[1].as_secs_f64() / times[0].as_secs_f64());
                times[1]
            });
        });
        ratios.sort_by(f64::total_cmp);
        if let Some(last) = ratios.len().checked_sub(1) {
            let at = |share: f64| ratios[(last as f64 * share).round() as usize];
            println!("effects/{name}: {:.3} [{:.3}..{:.3}] times all off", at(0.5), at(0.25), at(0.75));
            let numbers = [("order", order as f64), ("times_off", at(0.5)), ("low", at(0.25)), ("high", at(0.75))];
            facts::note("effects", &[name, "10k"], &numbers);
        }
    }
    group.finish();
}
