//! An open device: what it is and has.

use super::compiled::Compiled;
use super::context::Context;
use super::error::Error;
use super::info::{DeviceInfo, Feature};
use super::instance;
use super::traffic::Traffic;
use super::tuning::Tuning;
use super::tuning::choice::TuningChoice;
use crate::lock::lock;
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// A Vulkan device, ready to run kernels; clones share it.
#[derive(Clone)]
pub struct Device {
    context: Arc<Context>,
    tuning: Arc<Tuning>,
    /// The buffers asked for, where they are only counted.
    counted: Option<Arc<Counted>>,
}

/// The largest of several buffers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LargestBuffer {
    /// Its name in messages; empty if there is none.
    pub name: String,
    /// Its size in bytes.
    pub bytes: u64,
}

/// A count of buffers that are not made.
#[derive(Default)]
pub(super) struct Counted {
    bytes: AtomicU64,
    largest: Mutex<LargestBuffer>,
}

impl Counted {
    /// Counts a buffer of this size; `bound` is true if kernels can bind it.
    pub fn add(&self, name: &str, bytes: u64, bound: bool) {
        self.bytes.fetch_add(bytes, Ordering::Relaxed);
        if bound {
            self.compare(name, bytes);
        }
    }

    /// Replaces the largest buffer by this one if that is larger.
    fn compare(&self, name: &str, bytes: u64) {
        let mut largest = lock(&self.largest);
        if bytes > largest.bytes {
            *largest = LargestBuffer { name: name.to_owned(), bytes };
        }
    }
}

/// A device as records name it: its properties and the tuning of its kernels.
#[derive(Clone, Debug, Serialize)]
pub struct TunedDevice {
    /// The device.
    #[serde(flatten)]
    pub info: DeviceInfo,
    /// The shapes of its kernels.
    pub tuning: Tuning,
}

impl Device {
    /// The device of a context, with the tuning of its kernels.
    pub(super) fn of(context: Context, tuning: Tuning) -> Self {
        Self { context: Arc::new(context), tuning: Arc::new(tuning), counted: None }
    }

    /// The device with the subgroup width that was measured, if it differs from the driver's claim. If kernels
    /// requested the size, the driver cannot be trusted; otherwise the measured width is used.
    pub(super) fn with_subgroups_of(mut self, width: u32, choice: &TuningChoice) -> Result<Self, Error> {
        let info = self.info();
        let (pinned, told) = (info.has(Feature::SubgroupSizeControl), info.subgroup_size);
        let usable = (4..=128).contains(&width) && width.is_power_of_two();
        let context =
            Arc::get_mut(&mut self.context).filter(|_| usable && !pinned).map(|context| &mut context.logical.info);
        let Some(info) = context else {
            return Err(Error::Driver {
                device: self.info().name.clone(),
                driver: self.info().driver.clone(),
                what: format!("its subgroups have {width} invocations, not the {told} that it reports"),
            });
        };
        tracing::warn!("{}: subgroups have {width} invocations, not the {told} that its driver reports", info.name);
        (info.subgroup_size, info.subgroup_range) = (width, [width; 2]);
        self.tuning = Arc::new(choice.on(info)?);
        Ok(self)
    }

    /// Identity and capabilities of this device.
    pub fn info(&self) -> &DeviceInfo {
        &self.context.logical.info
    }

    /// The tuning of kernels on this device.
    pub fn tuning(&self) -> &Tuning {
        &self.tuning
    }

    /// The same device with another tuning from here on.
    ///
    /// # Errors
    /// [`Error::Tuning`] with the field that does not fit the device.
    pub fn with_tuning(&self, tuning: Tuning) -> Result<Self, Error> {
        tuning.check(self.info()).map_err(Error::Tuning)?;
        Ok(Self { tuning: Arc::new(tuning), ..self.clone() })
    }

    /// The device and its tuning, for records.
    pub fn tuned(&self) -> TunedDevice {
        TunedDevice { info: self.info().clone(), tuning: self.tuning().clone() }
    }

    /// Validation warnings and errors that this process has seen.
    pub fn validation_messages() -> usize {
        instance::validation_messages()
    }

    /// Whether validation layers are on.
    pub fn validates(&self) -> bool {
        self.context.logical.validates
    }

    /// Bytes in buffers: now, and the peak since the device was opened or since [`Device::forget_peak`].
    pub fn memory_used(&self) -> (u64, u64) {
        self.context.memory.used()
    }

    /// Restarts the peak of bytes in buffers.
    pub fn forget_peak(&self) {
        self.context.memory.forget_peak();
    }

    /// The host's requests to the device so far.
    pub fn traffic(&self) -> Traffic {
        *lock(&self.context.traffic)
    }

    /// Checks that `bytes` more stay within [`Device::memory_limit`], for steps that must not fail half-way.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] with this `name`.
    pub fn check_memory(&self, name: &str, bytes: u64) -> Result<(), Error> {
        self.context.memory.check(name, bytes)
    }

    /// Bytes that this program may use on the device.
    pub fn memory_limit(&self) -> u64 {
        self.context.memory.limit()
    }

    /// Every kernel made so far, ordered by name and constants; statistics are empty if the driver reports none. Only
    /// for a device opened with [`super::DeviceOptions::compile_only`].
    pub fn compiled(&self) -> Vec<Compiled> {
        self.context.pipelines.compiled()
    }

    /// Bytes of the buffers that `make` asks for: on the device that it gets, buffers are counted and not made, and nothing
    /// runs. What it returns holds no data.
    pub fn bytes_of<T, E>(&self, make: impl FnOnce(&Self) -> Result<T, E>) -> u64 {
        self.counting(make).bytes.load(Ordering::Relaxed)
    }

    /// The largest buffer among those that `make` asks for, as in [`Device::bytes_of`], and that kernels bind; estimates that
    /// `make` calls count as well. It must not exceed [`DeviceInfo::max_buffer_bytes`].
    pub fn largest_of<T, E>(&self, make: impl FnOnce(&Self) -> Result<T, E>) -> LargestBuffer {
        let counted = self.counting(make);
        lock(&counted.largest).clone()
    }

    /// The count of the buffers that `make` asks for.
    fn counting<T, E>(&self, make: impl FnOnce(&Self) -> Result<T, E>) -> Arc<Counted> {
        let counted = Arc::new(Counted::default());
        let _ = make(&Self { counted: Some(Arc::clone(&counted)), ..self.clone() });
        if let Some(outer) = self.counted() {
            let LargestBuffer { name, bytes } = lock(&counted.largest).clone();
            outer.compare(&name, bytes);
        }
        counted
    }

    /// The count of buffers where nothing runs: see [`Device::bytes_of`].
    pub(super) fn counted(&self) -> Option<&Counted> {
        self.counted.as_deref()
    }

    pub(super) fn context(&self) -> &Arc<Context> {
        &self.context
    }
}
