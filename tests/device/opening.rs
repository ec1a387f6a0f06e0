//! Devices other than this machine's, as far as options can imitate them: they get the same bits, or are refused by name.

use super::train::runs::{bits, options, train, trainer};
use crate::support::finish;
use qirf_vk::gpu::{Descriptors, Device, DeviceOptions};

/// The model after some iterations on a device opened with these options; density control included.
fn trained(options_of_device: DeviceOptions) -> Vec<u32> {
    let device = Device::open(&DeviceOptions { validation: true, guarded: true, ..options_of_device }).unwrap();
    let mut trainer = trainer(&device, options());
    train(&mut trainer, 25);
    let model = bits(&trainer.download().unwrap());
    drop(trainer);
    finish(&device);
    model
}

#[test]
fn descriptor_sets_give_the_bits_of_pushed_descriptors() {
    let [pushed, sets] = [Descriptors::Push, Descriptors::Sets]
        .map(|way| trained(DeviceOptions { descriptors: Some(way), ..DeviceOptions::default() }));
    assert!(pushed == sets);
}
