//! A logical device with its queue, memory and pipelines.

use super::choose;
use super::choose::lease::{self, Lease};
use super::choose::select::{self, Candidate, DeviceInfo, DeviceKind, Feature};
use super::compiled::{self, Compiled};
use super::descriptors::{Binder, Descriptors};
use super::error::{During, Error};
use super::frame::Frame;
use super::harness::imitation::Limits;
use super::harness::order::Disorder;
use super::harness::red_zone::Guards;
use super::hazards::Hazards;
use super::instance::{self, Instance};
use super::memory::{self, Memory};
use super::module::Modules;
use super::options::DeviceOptions;
use super::pace::{self, Pace};
use super::pipeline::Pipelines;
use super::probe;
use super::queue::Queue;
use super::tuning::Tuning;
use super::tuning::choice::TuningChoice;
use super::tuning::store;
use super::work::{Counters, Traffic};
use ash::{ext, khr, vk};
use gpu_allocator::vulkan::AllocatorCreateDesc;
use serde::Serialize;
use std::ffi::CString;
use std::mem::ManuallyDrop;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A Vulkan device, ready to run kernels; clones share it.
#[derive(Clone)]
pub struct Device {
    context: Arc<Context>,
    tuning: Arc<Tuning>,
    /// Bytes of the buffers asked for, where they are only counted.
    counted: Option<Arc<AtomicU64>>,
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

pub(super) struct Context {
    pub raw: ash::Device,
    pub info: DeviceInfo,
    pub queue: Queue,
    pub binder: Binder,
    /// Whether kernels request a subgroup size.
    pub pins_subgroups: bool,
    pub debug: Option<ext::debug_utils::Device>,
    pub modules: Modules,
    pub pipelines: Pipelines,
    pub hazards: Mutex<Hazards>,
    pub counters: Counters,
    /// Whether nothing is ever submitted.
    pub compile_only: bool,
    /// The limit on the length of submissions.
    pub pace: Option<Pace>,
    pub executables: Option<khr::pipeline_executable_properties::Device>,
    pub compiled: Mutex<Vec<Compiled>>,
    pub frames: Mutex<Vec<Frame>>,
    pub guards: Option<Guards>,
    pub disorder: Option<Disorder>,
    pub memory: ManuallyDrop<Memory>,
    /// Held while the device is open.
    _lease: Option<Lease>,
    instance: Instance,
}

/// Locks a mutex, poisoned or not. Poisoning only means that another thread panicked; the guarded values are valid
/// after every step.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Device {
    /// Opens the device that the options or the ranking choose, and checks its driver.
    ///
    /// # Errors
    /// No loader, no device, no device of that name, a missing feature, a tuning that does not exist or fit, or a
    /// driver that computes wrong results.
    pub fn open(options: &DeviceOptions) -> Result<Self, Error> {
        let instance = Instance::new(options.validation)?;
        let claim = options.harness.claim;
        let candidates = select::candidates(&instance, options.harness.limits.unwrap_or(Limits::NONE), claim)?;
        let leases = options.leases.clone().unwrap_or_else(lease::folder);
        let candidate = choose::choose(candidates, options.device.as_deref(), &leases)?;
        let choice = options.tuning.clone();
        let stored = if choice.is_none() { store::read(&candidate.info) } else { None };
        let choice = choice.unwrap_or_default();
        let tuning = stored.map_or_else(|| choice.on(&candidate.info), Ok)?;
        // A device with a single size has nothing to pin; a request would only limit the number of subgroups (llvmpipe:
        // 32 of 4).
        let [least, most] = candidate.info.subgroup_range;
        let pins = candidate.info.has(Feature::SubgroupSizeControl) && least < most && claim.is_none();
        let context = Context::new(instance, candidate, options, pins)?;
        let device = Self { context: Arc::new(context), tuning: Arc::new(tuning), counted: None };
        if options.compile_only {
            return Ok(device);
        }
        let width = probe::check(&device)?;
        device.context.memory.enforce();
        if width == device.info().subgroup_size { Ok(device) } else { device.with_subgroups_of(width, &choice) }
    }

    /// The device with the subgroup width that was measured, if it differs from the driver's claim. If kernels
    /// requested the size, the driver cannot be trusted; otherwise the measured width is used.
    fn with_subgroups_of(mut self, width: u32, choice: &TuningChoice) -> Result<Self, Error> {
        let info = self.info();
        let (pinned, told) = (info.has(Feature::SubgroupSizeControl), info.subgroup_size);
        let usable = (4..=128).contains(&width) && width.is_power_of_two();
        let context = Arc::get_mut(&mut self.context).filter(|_| usable && !pinned).map(|context| &mut context.info);
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
        &self.context.info
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
        self.context.instance.validation
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
        self.context.counters.read()
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

    /// Bytes of the buffers that `make` asks for: on the device that it gets, buffers are counted and not made, and nothing
    /// runs. What it returns holds no data.
    pub fn bytes_of<T, E>(&self, make: impl FnOnce(&Self) -> Result<T, E>) -> u64 {
        let counted = Arc::new(AtomicU64::new(0));
        let _ = make(&Self { counted: Some(Arc::clone(&counted)), ..self.clone() });
        counted.load(Ordering::Relaxed)
    }

    /// The count of bytes where nothing runs: see [`Device::bytes_of`].
    pub(super) fn counted(&self) -> Option<&AtomicU64> {
        self.counted.as_deref()
    }

    pub(super) fn context(&self) -> &Arc<Context> {
        &self.context
    }
}

impl Context {
    fn new(
        instance: Instance,
        candidate: Candidate,
        options: &DeviceOptions,
        pins_subgroups: bool,
    ) -> Result<Self, Error> {
        let info = candidate.info;
        let descriptors = Descriptors::choose(options.descriptors, &info)?;
        let raw = create(&instance.raw, candidate.physical, candidate.queue_family, &info)?;
        let executables = info.has(Feature::KernelStatistics);
        let executables = executables.then(|| khr::pipeline_executable_properties::Device::new(&instance.raw, &raw));
        // SAFETY: the family was found on this device and one queue was asked for.
        let queue = unsafe { raw.get_device_queue(candidate.queue_family, 0) };
        // A CPU device's memory is the host's and can be swapped: its free amount says little.
        let free = candidate.free_bytes.filter(|_| info.kind != DeviceKind::Cpu);
        // One block of the allocator may be almost empty, and only the buffers' own bytes are counted.
        let limit = options.memory_limit.unwrap_or(free.unwrap_or(info.memory_bytes).saturating_sub(memory::BLOCK));
        let limit = if options.compile_only { u64::MAX } else { limit };
        let allocator = AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: candidate.physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::new(memory::BLOCK, memory::BLOCK),
        };
        Ok(Self {
            binder: Binder::new(descriptors, &instance.raw, &raw),
            pins_subgroups,
            debug: instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.raw, &raw)),
            queue: Queue::new(queue, candidate.queue_family, options.harness.fault),
            modules: Modules {
                folder: options.harness.shaders.clone(),
                keep_nan: info.has(Feature::NanPreserve),
                reconverge: info.has(Feature::UniformSubgroups),
            },
            pipelines: Pipelines::new(&raw, candidate.pipeline_cache_uuid)?,
            hazards: Mutex::default(),
            counters: Counters::default(),
            compile_only: options.compile_only,
            pace: options.max_submission.or_else(|| pace::usual(info.kind)).map(Pace::new),
            executables,
            compiled: Mutex::default(),
            frames: Mutex::default(),
            guards: options.harness.guarded.then(Guards::default),
            disorder: options.harness.order.map(Disorder::new),
            memory: ManuallyDrop::new(Memory::new(&allocator, &info, limit)?),
            _lease: candidate.lease,
            info,
            raw,
            instance,
        })
    }

    /// Removes the hazards of a freed buffer.
    pub fn forget(&self, buffer: u64) {
        lock(&self.hazards).forget(buffer);
    }

    pub fn name_object(&self, object: impl vk::Handle, name: &str) {
        if let (Some(debug), Ok(name)) = (&self.debug, CString::new(name)) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }

    /// Removes an object's name before it is destroyed: validation layers keep the names of destroyed objects (64 bytes
    /// each in 1.3.239).
    pub fn unname_object(&self, object: impl vk::Handle) {
        if let Some(debug) = self.debug.as_ref().filter(|_| self.instance.validation) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        // A lost driver's cache may be damaged and must not affect the next start.
        if !self.queue.is_lost() {
            self.pipelines.save(&self.raw);
        }
        if !self.compile_only {
            let _ = self.queue.idle(&self.raw);
        }
        // SAFETY: every submission was waited for (or lost, and no work is under way on a lost device) and every buffer is
        // gone, since both hold this context; each handle is destroyed once, children before the device, the allocator's
        // memory before it too.
        unsafe {
            for frame in lock(&self.frames).drain(..) {
                frame.destroy(&self.raw);
            }
            self.pipelines.destroy(&self.raw);
            ManuallyDrop::drop(&mut self.memory);
            self.raw.destroy_device(None);
        }
    }
}

/// Creates the logical device, with one queue and the optional features that variants of kernels use.
fn create(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    queue_family: u32,
    info: &DeviceInfo,
) -> Result<ash::Device, Error> {
    let mut extensions = Vec::new();
    if info.has(Feature::PushDescriptors) {
        extensions.push(khr::push_descriptor::NAME.as_ptr());
    }
    let [sizes, full] = [Feature::SubgroupSizeControl, Feature::FullSubgroups].map(|feature| info.has(feature));
    let mut control = vk::PhysicalDeviceSubgroupSizeControlFeatures::default()
        .subgroup_size_control(sizes)
        .compute_full_subgroups(full);
    let mut vulkan_1_2 = vk::PhysicalDeviceVulkan12Features::default().subgroup_broadcast_dynamic_id(true);
    let mut atomic = vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default().shader_buffer_float32_atomic_add(true);
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
    let mut wanted = vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut vulkan_1_2);
    // The extension must be enabled if it is present.
    if info.has(Feature::PortabilitySubset) {
        extensions.push(khr::portability_subset::NAME.as_ptr());
    }
    if sizes || full {
        extensions.push(ext::subgroup_size_control::NAME.as_ptr());
        wanted = wanted.push_next(&mut control);
    }
    if info.has(Feature::FloatAtomics) {
        extensions.push(ext::shader_atomic_float::NAME.as_ptr());
        wanted = wanted.push_next(&mut atomic);
    }
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
        .shader_subgroup_uniform_control_flow(true);
    if info.has(Feature::UniformSubgroups) {
        extensions.push(khr::shader_subgroup_uniform_control_flow::NAME.as_ptr());
        wanted = wanted.push_next(&mut uniform);
    }
    let mut executables =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    if info.has(Feature::KernelStatistics) {
        extensions.push(compiled::EXTENSION.as_ptr());
        wanted = wanted.push_next(&mut executables);
    }
    // SAFETY: only extensions and features that the device reported are asked for.
    unsafe { instance.create_device(physical, &wanted.enabled_extension_names(&extensions), None) }
        .during("create device")
}
