//! Pruning a model in training: responses, the choice, and the remaining Gaussians.

use super::runs::{bits, capture, options, resumed, train, trainer};
use crate::support::{device, finish};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::Device;
use qirf_vk::job::config::PruneRule;
use qirf_vk::pipeline::prune::{PruneRequest, prune_by};
use qirf_vk::qirf::select::Selector;
use qirf_vk::qirf::select::budget::{Budget, Keep};
use qirf_vk::qirf::study::{Basis, Observed, Study};
use qirf_vk::response::{Responses, Wanted};
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::{Options, Trainer};
use std::sync::OnceLock;

/// A run after 60 iterations, which are done once.
fn after_60(device: &Device, options: Options) -> Trainer {
    static DONE: OnceLock<Snapshot> = OnceLock::new();
    let done = DONE.get_or_init(|| {
        let mut run = trainer(device, super::runs::options());
        train(&mut run, 60);
        run.snapshot().unwrap()
    });
    let c = capture();
    Trainer::resume(device, done, c.train.clone(), c.extent, options).unwrap()
}

/// The pass over the views changes nothing, and gives the same results every time.
#[test]
fn responses_change_nothing() {
    let device = device();
    let (mut one, mut other) = (after_60(&device, options()), trainer(&device, Options { pairs: 64, ..options() }));
    train(&mut other, 60);
    let before = one.snapshot().unwrap();
    let responses = one.responses(Wanted::BOTH).unwrap();
    assert!(before == one.snapshot().unwrap());
    assert!(responses == other.responses(Wanted::BOTH).unwrap(), "a pair buffer that began too small");
    let n = one.len();
    assert_eq!((responses.channels.len(), responses.scores.len()), (n, n));
    let seen = responses.channels.iter().filter(|r| r[0] > 0.0).count();
    assert!(seen > n / 2, "{seen} of {n} seen");
    assert!(responses.channels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    // A Gaussian has a response exactly where it is visible.
    assert!(responses.channels.iter().zip(&responses.scores).all(|(r, s)| (r[0] > 0.0) == (s.hits > 0.0)));
    finish(&device);
}

/// Kept rows and their moments are unchanged and in order; no others remain.
#[test]
fn the_kept_go_on_as_they_were() {
    let device = device();
    let mut trainer = after_60(&device, options());
    let before = trainer.snapshot().unwrap();
    let keep: Vec<bool> = (0..trainer.len()).map(|i| i % 3 == 1).collect();
    let kept: Vec<usize> = (0..trainer.len()).filter(|i| keep[*i]).collect();
    trainer.keep(&keep, None).unwrap();
    let after = trainer.snapshot().unwrap();
    assert!(bits(&after.model) == bits(&before.model.select(&kept)));
    for (now, then) in after.moments.zip(before.moments).up_to(after.model.degree()) {
        let width = then.len() / keep.len();
        let rows: Vec<f32> = kept.iter().flat_map(|i| &then[i * width..(i + 1) * width]).copied().collect();
        assert!(now == rows && width > 0);
    }
    train(&mut trainer, 100);
    assert_eq!((trainer.len(), trainer.skipped_rows()), (kept.len(), 0));
    finish(&device);
}

/// Every selector under every budget keeps exactly the requested number, merged or not, and the same Gaussians every
/// time.
#[test]
fn counts_are_exact() {
    let device = device();
    let mut trained = after_60(&device, options());
    let responses = trained.responses(Wanted { residual: true, ..Wanted::BOTH }).unwrap();
    let model = trained.download().unwrap();
    let selectors: Vec<Selector> = Selector::ALL.into_iter().filter(|s| *s != Selector::Pairs).collect();
    let resident = trained.model();
    let observed = Observed { resident, model: &model, responses: &responses };
    let study = |seed| Study::new(&device, observed, &Basis::default(), &selectors, seed).unwrap();
    let (one, again) = (study(1), study(1));
    let third = model.len() / 3;
    for &selector in &selectors {
        for budget in [Budget::PerBlock, Budget::Hybrid, Budget::Global] {
            let choice = one.choose(selector, budget, Keep::Count(third), 0.05);
            assert_eq!(choice.keep.iter().filter(|k| **k).count(), third, "{selector}");
            assert!(choice == again.choose(selector, budget, Keep::Count(third), 0.05), "{selector}");
        }
    }
    let choice = one.choose(Selector::Gnso, Budget::Hybrid, Keep::Count(third), 0.05);
    let mut merged = model.clone();
    let merging = one.merge(&device, resident, &mut merged, &choice.keep).unwrap();
    assert!(merging.accepted > 0, "{merging:?}");
    assert!(merged.means == model.means && merged.log_scales == model.log_scales);
    let changed = |i: usize| merged.opacity_logits[i].to_bits() != model.opacity_logits[i].to_bits();
    assert!((0..model.len()).all(|i| choice.keep[i] || !changed(i)), "only kept ones change");
    assert!((0..model.len()).any(changed) && merged.opacity_logits.iter().all(|v| v.is_finite()));
    finish(&device);
}

/// Merging takes discs thinner than a thousandth of their width for discs of that thickness, as their overlaps do.
#[test]
fn thin_discs_are_merged_as_their_overlaps_have_them() {
    let device = device();
    let mut trained = after_60(&device, options());
    let responses = trained.responses(Wanted::BOTH).unwrap();
    let whole = trained.download().unwrap();
    let flattened = |log: fn(f32) -> f32| {
        let mut model = whole.clone();
        model.log_scales.iter_mut().step_by(3).for_each(|s| s[2] = log(s[0].max(s[1])));
        model
    };
    let keep: Vec<bool> = (0..whole.len()).map(|i| i % 2 == 0).collect();
    let merged = |model: &Gaussians| {
        let resident = Resident::upload(&device, model).unwrap();
        let observed = Observed { resident: &resident, model, responses: &responses };
        let study = Study::new(&device, observed, &Basis::default(), &[Selector::Importance], 1).unwrap();
        let mut merged = model.clone();
        let merging = study.merge(&device, &resident, &mut merged, &keep).unwrap();
        (merging, merged.opacity_logits)
    };
    let (of_floor, of_discs) = (merged(&flattened(|s| s + 1e-3_f32.ln())), merged(&flattened(|_| -20.0)));
    assert!(of_floor.0.accepted > 0, "{:?}", of_floor.0);
    assert!(of_discs.0.accepted.abs_diff(of_floor.0.accepted) <= 1, "{:?}, {:?}", of_discs.0, of_floor.0);
    let largest = of_discs.1.iter().zip(&of_floor.1).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(largest < 1e-2, "{largest}");
    finish(&device);
}

/// Merged pairs replace some of their members, exactly as many as requested, and training continues with them.
#[test]
fn pairs_train_on() {
    let device = device();
    let mut ends = Vec::new();
    for _ in 0..2 {
        let mut trainer = after_60(&device, options());
        let before = trainer.download().unwrap();
        let responses = trainer.responses(Wanted::SCORES).unwrap();
        assert!(responses.channels.is_empty());
        let compression = PruneRule { selector: Selector::Pairs, ..PruneRule::default() };
        let third = before.len() / 3;
        let request = PruneRequest { compression: &compression, keep: Keep::Count(third), seed: 1 };
        let pruned = prune_by(&device, &mut trainer, &responses, &request, |_, _| Ok(())).unwrap();
        let pairs = pruned.pairs.expect("merged by pairs");
        assert_eq!((pruned.after, trainer.len()), (third, third));
        assert_eq!(pairs.merged + pairs.dropped, before.len() - third);
        let after = trainer.download().unwrap();
        after.validate().unwrap();
        let moved = after.means.iter().filter(|mean| !before.means.contains(mean)).count();
        assert_eq!(moved, pairs.clusters, "clusters have new centres, the others keep theirs");
        train(&mut trainer, 100);
        assert_eq!((trainer.len(), trainer.skipped_rows()), (third, 0));
        ends.push(bits(&trainer.download().unwrap()));
    }
    assert!(ends[0] == ends[1]);
    finish(&device);
}

/// The paper's averages: a checkpoint taken while they are averaged preserves them, and leads to the same choice.
#[test]
fn averages_survive_a_checkpoint() {
    let device = device();
    let averaging = || Options { averaged: 79..101, ..options() };
    let mut whole = after_60(&device, averaging());
    train(&mut whole, 78);
    assert!(whole.averages().unwrap().is_none());
    train(&mut whole, 90);
    let mut resumed = resumed(&device, &whole.snapshot().unwrap(), averaging());
    let mut ends = Vec::new();
    for trainer in [&mut whole, &mut resumed] {
        train(trainer, 100);
        let responses: Responses = trainer.averages().unwrap().expect("averages");
        assert!(responses.channels.iter().flatten().any(|v| *v > 0.0));
        // The paper's voxel of 0.03 would make every Gaussian here a block of its own.
        let basis = Basis::default();
        let compression = PruneRule { basis, ..PruneRule::paper() };
        let request = PruneRequest { compression: &compression, keep: Keep::Paper { kappa: 0.22 }, seed: 1 };
        let pruned = prune_by(&device, trainer, &responses, &request, |_, _| Ok(())).unwrap();
        assert!(pruned.after < pruned.before / 2 && pruned.after == trainer.len(), "{pruned:?}");
        assert!(trainer.averages().unwrap().is_none(), "the averages were of other Gaussians");
        train(trainer, 110);
        ends.push(bits(&trainer.download().unwrap()));
    }
    assert!(ends[0] == ends[1]);
    finish(&device);
}
