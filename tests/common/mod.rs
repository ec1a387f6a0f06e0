//! What the integration tests share: a validated device, and where shared data lie.
#![allow(dead_code)]

use qirf_vk::gpu::{Device, DeviceOptions};
use std::path::PathBuf;

/// The device under test, validation layers on.
pub fn device() -> Device {
    Device::open(&DeviceOptions { validation: true, ..Default::default() }).expect("a Vulkan device")
}

/// Fails the test when the validation layers said anything.
pub fn finish(device: &Device) {
    assert!(device.validates(), "the validation layers are installed (tools/setup)");
    assert_eq!(Device::validation_messages(), 0, "validation messages are printed above");
}

/// The folder of shared data, or none; the test then says that it was skipped.
pub fn shared() -> Option<PathBuf> {
    let path = std::env::var_os("QIRF_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    if path.is_dir() {
        Some(path)
    } else {
        println!("skipped: no shared data");
        None
    }
}
