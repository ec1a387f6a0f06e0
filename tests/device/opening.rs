//! Devices other than this machine's, as far as options can imitate them: they give the same bits, or are refused by
//! name.

use super::train::runs::{self, bits, train, trainer};
use crate::support::{finish, opened, options, skip};
use qirf_vk::gpu::{Claim, Descriptors, Device, DeviceClass, DeviceOptions, Error, Limits, TuningChoice};
use std::sync::OnceLock;
use std::time::Duration;

fn limited(limits: Limits) -> DeviceOptions {
    let mut options = options();
    options.harness.limits = Some(limits);
    options
}

fn claiming(subgroup: u32, pinned: bool) -> DeviceOptions {
    let mut options = options();
    options.harness.claim = Some(Claim { subgroup, pinned });
    options
}

/// The model after some iterations on a device opened with these options.
fn trained(iterations: u32, of_device: &DeviceOptions) -> Vec<u32> {
    let device = Device::open(of_device).unwrap();
    let mut trainer = trainer(&device, runs::options());
    train(&mut trainer, iterations);
    let model = bits(&trainer.download().unwrap());
    drop(trainer);
    finish(&device);
    model
}

/// The model after three iterations on the device as it is, made once.
fn trained_as_usual() -> &'static [u32] {
    static MADE: OnceLock<Vec<u32>> = OnceLock::new();
    MADE.get_or_init(|| trained(3, &options()))
}

#[test]
fn descriptor_sets_give_the_bits_of_pushed_descriptors() {
    let any = trained(25, &options());
    assert!(any == trained(25, &DeviceOptions { descriptors: Some(Descriptors::Sets), ..options() }));
}

#[test]
fn short_submissions_give_the_same_bits() {
    let trained = |max_submission| {
        let device = Device::open(&DeviceOptions { max_submission, ..options() }).unwrap();
        let mut trainer = trainer(&device, runs::options());
        train(&mut trainer, 25);
        let model = bits(&trainer.download().unwrap());
        drop(trainer);
        finish(&device);
        (model, device.traffic().submissions)
    };
    let (whole, few) = trained(None);
    // Shorter than any kernel: each gets a submission of its own.
    let (cut, many) = trained(Some(Duration::from_nanos(1)));
    assert!(whole == cut, "other bits");
    assert!(many > 8 * few, "{few} {many}");
    let (roomy, some) = trained(Some(Duration::from_secs(3600)));
    assert!(whole == roomy && some < many / 2, "{some} {many}");
}

#[test]
fn tighter_limits_change_nothing() {
    for limits in [Limits::ADRENO, Limits::APPLE, Limits::INTEL, Limits::SMALL_BUFFERS] {
        assert!(trained_as_usual() == trained(3, &limited(limits)), "{limits:?}");
    }
}

#[test]
fn limits_that_are_too_tight_are_named() {
    let none = Limits::NONE;
    let cases = [
        (Limits { storage_buffers: 16, ..none }, "storage buffers in a kernel (it has 16)"),
        (Limits { push_bytes: 32, ..none }, "bytes of push constants (it has 32)"),
        (Limits { workgroup: 128, ..none }, "256 invocations in a workgroup (it has 128)"),
        (Limits { shared_bytes: 8 << 10, ..none }, "16384 bytes of shared memory (it has 8192)"),
    ];
    for (limits, named) in cases {
        let opened = Device::open(&limited(limits));
        match opened.map(|device| device.info().clone()) {
            Err(Error::MissingFeature { feature, .. }) => assert!(feature.ends_with(named), "{feature}"),
            other => panic!("{limits:?}: {other:?}"),
        }
    }
}

#[test]
fn buffers_beyond_the_limit_are_a_lack_of_resources() {
    let device = Device::open(&limited(Limits::SMALL_BUFFERS)).unwrap();
    let error = device.buffer::<u32>("pairs", (32 << 20) + 1).err().expect("more than 128 MiB");
    assert!(error.is_resources() && error.to_string().contains("'pairs' needs 134217732 bytes"), "{error}");
    // Where buffers are only counted, the largest is known, whether it could be made or not, and that of an estimate within.
    let largest = device.largest_of(|counts| {
        counts.bytes_of(|counts| counts.buffer::<u32>("within", 40 << 20));
        counts.buffer::<u32>("small", 7)
    });
    assert_eq!((largest.name.as_str(), largest.bytes), ("within", 160 << 20));
}

#[test]
fn the_width_of_subgroups_is_probed() {
    let width = opened(|_| ()).info().subgroup_size;
    for subgroup in [width / 2, width * 2].into_iter().filter(|width| *width >= 4) {
        let error =
            Device::open(&claiming(subgroup, true)).err().expect("a driver that is asked for a size and gives another");
        let what = format!("its subgroups have {width} invocations, not the {subgroup} that it reports");
        assert!(error.to_string().contains(&what), "{error}");
    }
    // If no size can be requested, the measured width is used.
    let device = Device::open(&claiming(width * 2, false)).unwrap();
    assert_eq!((device.info().subgroup_size, device.tuning().subgroup), (width, width));
    assert!(trained_as_usual() == trained(3, &claiming(width * 2, false)));
}

#[test]
fn a_tuning_is_that_of_the_class_asked_for() {
    let usual = opened(|_| ());
    let fits = 1024 * (usual.info().subgroup_size + 2) <= usual.info().shared_bytes;
    for (class, tile) in [(DeviceClass::Cpu, 8), (DeviceClass::Gpu, 16)] {
        if class == DeviceClass::Cpu && !fits {
            skip("a serial sort's counters exceed the shared memory");
            continue;
        }
        let device = opened(|options| options.tuning = Some(TuningChoice::class(class)));
        assert_eq!((device.tuning().class, device.tuning().tile), (class, tile));
        finish(&device);
    }
    // Numbers that no device has are refused, not multiplied.
    for field in ["tile", "loss_tile", "backward_batch"] {
        let choice = format!("cpu,{field}=4000000000").parse().unwrap();
        let error = Device::open(&DeviceOptions { tuning: Some(choice), ..options() }).err().expect("a refusal");
        assert!(error.to_string().contains(&format!("{field} must be")), "{error}");
    }
}
