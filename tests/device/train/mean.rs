//! The mean of the last iterates: against float64, over changes of the number of Gaussians, and with the same bytes
//! after resuming.

use super::runs::{bits, options, resumed, train, trainer};
use crate::support::{device, finish, repeats};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gpu::Device;
use qirf_vk::train::Options;
use qirf_vk::train::schedule::Schedule;

const TAIL: usize = 40;
const LAST: u32 = 110;

/// Options that average the iterates after this share of the run.
fn averaging(mean_from: f64) -> Options {
    Options { schedule: Schedule { mean_from, ..options().schedule }, tail: TAIL, ..options() }
}

#[test]
fn the_result_is_the_mean_of_the_last_iterates() {
    let (device, again) = (device(), repeats());
    // Iterations 100 to 110.
    let mut whole = trainer(&device, averaging(0.9));
    let [before, within] = [99, 105].map(|at| {
        train(&mut whole, at);
        whole.snapshot().unwrap()
    });
    train(&mut whole, LAST);
    let mean = whole.download().unwrap();

    let mut plain = resumed(&again, &before, averaging(1.0));
    let iterates: Vec<Gaussians> = (100..=LAST)
        .map(|iteration| {
            train(&mut plain, iteration);
            plain.download().unwrap()
        })
        .collect();
    assert!(plain.snapshot().unwrap().mean.is_none());
    for (a, values) in mean.attributes().into_array().into_iter().enumerate() {
        for (i, value) in values.iter().enumerate() {
            let sum: f64 = iterates.iter().map(|m| f64::from(m.attributes().into_array()[a][i])).sum();
            let right = sum / iterates.len() as f64;
            assert!((f64::from(*value) - right).abs() < 1e-5 * right.abs().max(1.0), "{a}, {i}: {value}, {right}");
        }
    }
    let last = iterates.last().unwrap();
    assert!(mean.means != last.means && mean.means[mean.len() - TAIL..] == last.means[mean.len() - TAIL..]);

    for snapshot in [before, within] {
        let mut second = resumed(&again, &snapshot, averaging(0.9));
        assert_eq!(second.snapshot().unwrap().mean, snapshot.mean);
        train(&mut second, LAST);
        assert!(bits(&second.download().unwrap()) == bits(&mean), "resumed after {}", snapshot.iteration);
    }
    finish(&device);
}

/// Rows of different Gaussians, reset opacities, and models of different degrees are not averaged.
#[test]
fn other_changes_begin_it_anew() {
    let (device, again) = (device(), repeats());
    let changed = |change: &dyn Fn(&mut Schedule)| {
        let mut options = averaging(0.8);
        (options.schedule.densify_until, options.schedule.degree_every) = (1.0, 2.0);
        (options.schedule.densify_every, options.schedule.opacity_reset_every) = (1000, 1000);
        change(&mut options.schedule);
        options
    };
    // Until the mean begins, the runs are one.
    let mut common = trainer(&device, changed(&|_| ()));
    train(&mut common, 88);
    let common = common.snapshot().unwrap();
    let begins = |device: &Device, change: &dyn Fn(&mut Schedule), first: u32| {
        let mut trainer = resumed(device, &common, changed(change));
        train(&mut trainer, LAST - 2);
        // Every second iterate from 90 on.
        let mean = trainer.snapshot().unwrap().mean.expect("a mean");
        assert_eq!((mean.iterates, mean.model.len()), ((LAST - 2 - first) / 2 + 1, trainer.len()), "from {first}");
        train(&mut trainer, LAST);
        assert!(trainer.snapshot().unwrap().mean.is_none());
    };
    begins(&again, &|_| (), 90);
    begins(&device, &|schedule| schedule.densify_every = 100, 100);
    begins(&again, &|schedule| schedule.opacity_reset_every = 102, 102);
    // A band is added at iteration 103.
    begins(&again, &|schedule| schedule.degree_every = 103.0 / f64::from(LAST), 104);
    finish(&device);
}
