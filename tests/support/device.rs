//! Devices, lent to one test at a time.

use qirf_vk::gpu::{Device, DeviceOptions};
use std::ops::Deref;
use std::sync::{Mutex, PoisonError};

/// Devices returned by tests that passed. Opening one and creating its pipelines takes longer than most tests.
type Pool = Mutex<Vec<Device>>;

static WATCHED: Pool = Mutex::new(Vec::new());
static PLAIN: Pool = Mutex::new(Vec::new());

/// A device for one test alone. It is returned to its pool unless the test fails.
pub struct Lent(Option<Device>, &'static Pool);

fn lent(pool: &'static Pool, open: fn() -> Device) -> Lent {
    let free = pool.lock().unwrap_or_else(PoisonError::into_inner).pop();
    Lent(Some(free.unwrap_or_else(open)), pool)
}

impl Deref for Lent {
    type Target = Device;

    fn deref(&self) -> &Device {
        self.0.as_ref().expect("there until it is dropped")
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.1.lock().unwrap_or_else(PoisonError::into_inner).extend(self.0.take());
        }
    }
}

/// A device with validation layers whose buffers begin as NaN and end in red zones; earlier tests may have used it.
pub fn device() -> Lent {
    lent(&WATCHED, new_device)
}

/// A device of the same tuning without layers and guards, for trainings that repeat one which [`device`] has watched.
pub fn repeats() -> Lent {
    lent(&PLAIN, plain)
}

/// The environment's options, with validation layers and guarded buffers.
pub fn options() -> DeviceOptions {
    let mut options = DeviceOptions::from_env().expect("options of the environment");
    options.validation = true;
    options.harness.guarded = true;
    options
}

/// A fresh device with the same options after `change`.
pub fn opened(change: impl FnOnce(&mut DeviceOptions)) -> Device {
    let mut options = options();
    change(&mut options);
    Device::open(&options).expect("a Vulkan device")
}

/// A fresh device without layers and guards, for trainings whose kernels other tests validate: they look at quality alone.
pub fn plain() -> Device {
    Device::open(&DeviceOptions::from_env().expect("options of the environment")).expect("a Vulkan device")
}

/// A fresh device, for tests that break their device or measure its peak of memory.
pub fn new_device() -> Device {
    opened(|_| ())
}

/// Fails the test if the validation layers printed a message, or a kernel wrote behind a buffer's end.
pub fn finish(device: &Device) {
    let unwatched = std::env::var_os("QIRF_SOURCE").is_some(); // a copied program, on a machine that may lack the layers
    assert!(device.validates() || unwatched, "the validation layers are installed (tools/setup)");
    assert_eq!(Device::validation_messages(), 0, "validation messages are printed above");
    assert_eq!(device.overrun_buffers(), Vec::<String>::new(), "kernels wrote behind these buffers");
}
