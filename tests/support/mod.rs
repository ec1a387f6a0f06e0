//! What the three test programs share: a validated device, small scenes, golden cases, input files, and where shared data lie.
#![allow(dead_code, unused_imports)] // each program uses its own part

pub mod files;
pub mod golden;
mod shared;
pub mod synthetic;

pub use shared::shared;

use qirf_vk::gpu::{Device, DeviceOptions};

/// The device under test: validation layers on, every buffer born full of NaN and with a red zone behind it.
pub fn device() -> Device {
    Device::open(&DeviceOptions { validation: true, guarded: true, ..Default::default() }).expect("a Vulkan device")
}

/// Fails the test when the validation layers said anything, or a kernel wrote behind a buffer's end.
pub fn finish(device: &Device) {
    assert!(device.validates(), "the validation layers are installed (tools/setup)");
    assert_eq!(Device::validation_messages(), 0, "validation messages are printed above");
    assert_eq!(device.overrun_buffers(), Vec::<String>::new(), "kernels wrote behind these buffers");
}

/// A number that the test prints, so that its failure can be had again.
pub fn seed() -> u64 {
    let seed = std::env::var("QIRF_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    println!("QIRF_SEED={seed}");
    seed
}
