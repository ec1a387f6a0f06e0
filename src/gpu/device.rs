//! A logical device with its queue, allocator, pipelines and pipeline cache.

use super::error::{During, Error};
use super::fault::Fault;
use super::guard::Guards;
use super::hazards::Hazards;
use super::instance::{self, Instance};
use super::kernel::{Pipeline, PipelineKey, Shader};
use super::probe;
use super::queue::Queue;
use super::select::{self, Candidate, DeviceInfo};
use super::submit::Frame;
use ash::{ext, khr, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::collections::HashMap;
use std::ffi::CString;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How to open a device.
#[derive(Clone, Debug, Default)]
pub struct DeviceOptions {
    /// Index, or part of the name; else `QIRF_DEVICE`; else the best there is.
    pub device: Option<String>,
    /// Switch the validation layers on (also `QIRF_VALIDATION=1`).
    pub validation: bool,
    /// Bytes of device memory that this program may use; the device's own size where absent.
    pub memory_limit: Option<u64>,
    /// Fill new buffers with NaN and fence them (tests): see [`Device::broken_fences`].
    pub guarded: bool,
    /// A fault to make (tests); else `QIRF_DEVICE_FAULT`.
    pub fault: Option<Fault>,
}

/// A Vulkan device, ready to run kernels; clones share it.
#[derive(Clone)]
pub struct Device(Arc<Context>);

pub(super) struct Context {
    pub raw: ash::Device,
    pub info: DeviceInfo,
    pub subgroup_control: bool,
    pub queue: Queue,
    pub push: khr::push_descriptor::Device,
    pub debug: Option<ext::debug_utils::Device>,
    pub pipeline_cache: vk::PipelineCache,
    pub hazards: Mutex<Hazards>,
    pub frames: Mutex<Vec<Frame>>,
    pub guards: Option<Guards>,
    pipelines: Mutex<HashMap<PipelineKey, Arc<Pipeline>>>,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    cache_file: Option<PathBuf>,
    used: AtomicU64,
    peak: AtomicU64,
    limit: u64,
    instance: Instance,
}

/// A poisoned lock only says that another thread panicked; what it guards here is valid after every step.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Device {
    /// Opens the device that the options, `QIRF_DEVICE`, or the ranking choose, and checks its driver.
    ///
    /// # Errors
    /// No loader, no device, none of that name, a missing feature, or a driver that computes wrong results.
    pub fn open(options: &DeviceOptions) -> Result<Self, Error> {
        let flag = |name| std::env::var(name).is_ok_and(|v| !v.is_empty() && v != "0");
        let instance = Instance::new(options.validation || flag("QIRF_VALIDATION"))?;
        let from_environment = std::env::var("QIRF_DEVICE").ok().filter(|s| !s.is_empty());
        let wanted = options.device.clone().or(from_environment);
        let candidate = select::choose(select::candidates(&instance)?, wanted.as_deref())?;
        let device = Self(Arc::new(Context::new(instance, candidate, options)?));
        if device.info().is_cpu() {
            probe::check(&device)?;
        }
        Ok(device)
    }

    /// What this device is and can do.
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// Validation warnings and errors that this process has seen.
    pub fn validation_messages() -> usize {
        instance::validation_messages()
    }

    /// Whether validation layers are on.
    pub fn validates(&self) -> bool {
        self.0.instance.validation
    }

    /// Bytes in buffers now, and at most so far.
    pub fn memory_used(&self) -> (u64, u64) {
        (self.0.used.load(Ordering::Relaxed), self.0.peak.load(Ordering::Relaxed))
    }

    /// Bytes that this program may use on the device.
    pub fn memory_limit(&self) -> u64 {
        self.0.limit
    }

    pub(super) fn context(&self) -> &Arc<Context> {
        &self.0
    }
}

impl Context {
    fn new(instance: Instance, candidate: Candidate, options: &DeviceOptions) -> Result<Self, Error> {
        let mut extensions = vec![khr::push_descriptor::NAME.as_ptr()];
        if candidate.subgroup_control {
            extensions.push(ext::subgroup_size_control::NAME.as_ptr());
        }
        if candidate.memory_budget {
            extensions.push(ext::memory_budget::NAME.as_ptr());
        }
        let mut control = vk::PhysicalDeviceSubgroupSizeControlFeatures::default().subgroup_size_control(true);
        let mut atomic =
            vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default().shader_buffer_float32_atomic_add(true);
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(candidate.queue_family).queue_priorities(&[1.0])];
        if candidate.atomic_float {
            extensions.push(ext::shader_atomic_float::NAME.as_ptr());
        }
        let mut info = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
        if candidate.subgroup_control {
            info = info.push_next(&mut control);
        }
        if candidate.atomic_float {
            info = info.push_next(&mut atomic);
        }
        // SAFETY: only extensions and features that the device reported are asked for.
        let raw = unsafe { instance.raw.create_device(candidate.physical, &info, None) }.during("create device")?;
        // SAFETY: the family was found on this device and one queue was asked for.
        let queue = unsafe { raw.get_device_queue(candidate.queue_family, 0) };
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: candidate.physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::default(),
        })
        .map_err(|e| Error::MissingFeature { device: candidate.info.name.clone(), feature: format!("memory ({e})") })?;

        let cache_file = cache_file(&candidate.pipeline_cache_uuid);
        let cached = cache_file.as_ref().and_then(|p| std::fs::read(p).ok()).unwrap_or_default();
        let cache_info = vk::PipelineCacheCreateInfo::default().initial_data(&cached);
        // SAFETY: Vulkan checks the data's header and ignores what is not its own.
        let pipeline_cache = unsafe { raw.create_pipeline_cache(&cache_info, None) }.during("create pipeline cache")?;
        let limit = options.memory_limit.unwrap_or(candidate.info.memory_bytes);
        Ok(Self {
            push: khr::push_descriptor::Device::new(&instance.raw, &raw),
            debug: instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.raw, &raw)),
            queue: Queue::new(queue, candidate.queue_family, options.fault.or_else(Fault::from_environment)),
            subgroup_control: candidate.subgroup_control,
            info: candidate.info,
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            pipelines: Mutex::default(),
            hazards: Mutex::default(),
            frames: Mutex::default(),
            guards: options.guarded.then(Guards::default),
            used: AtomicU64::new(0),
            peak: AtomicU64::new(0),
            pipeline_cache,
            cache_file,
            limit,
            raw,
            instance,
        })
    }

    pub fn allocator(&self) -> MutexGuard<'_, Allocator> {
        lock(&self.allocator)
    }

    /// Counts `bytes` as used, unless they go beyond the limit.
    pub fn reserve(&self, name: &str, bytes: u64) -> Result<(), Error> {
        let used = self.used.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if used > self.limit {
            self.release(bytes);
            return Err(self.out_of_memory(name, bytes));
        }
        self.peak.fetch_max(used, Ordering::Relaxed);
        Ok(())
    }

    pub fn release(&self, bytes: u64) {
        self.used.fetch_sub(bytes, Ordering::Relaxed);
    }

    fn out_of_memory(&self, name: &str, needed: u64) -> Error {
        Error::OutOfMemory {
            name: name.to_owned(),
            needed,
            used: self.used.load(Ordering::Relaxed),
            limit: self.limit,
            device: self.info.name.clone(),
        }
    }

    pub fn allocation_error(&self, name: &str, bytes: u64, error: &gpu_allocator::AllocationError) -> Error {
        match error {
            gpu_allocator::AllocationError::OutOfMemory => self.out_of_memory(name, bytes),
            // The allocator's words for a host without memory, and for too many allocations.
            gpu_allocator::AllocationError::FailedToMap(why) | gpu_allocator::AllocationError::Internal(why) => {
                tracing::warn!("allocation of '{name}', {bytes} bytes: {why}");
                Error::Exhausted { call: "allocate memory", of: "the host's" }
            }
            other => {
                tracing::error!("allocation of '{name}': {other}");
                Error::Vulkan { call: "allocate memory", result: vk::Result::ERROR_UNKNOWN }
            }
        }
    }

    /// Drops a buffer's hazards when it goes.
    pub fn forget(&self, buffer: u64) {
        lock(&self.hazards).forget(buffer);
    }

    pub fn pipeline(&self, shader: &'static Shader, constants: Vec<u32>) -> Result<Arc<Pipeline>, Error> {
        let key = (shader.name, constants);
        let mut pipelines = lock(&self.pipelines);
        if let Some(found) = pipelines.get(&key) {
            return Ok(Arc::clone(found));
        }
        let made = Arc::new(Pipeline::new(self, shader, &key.1)?);
        pipelines.insert(key, Arc::clone(&made));
        Ok(made)
    }

    pub fn name_object(&self, object: impl vk::Handle, name: &str) {
        if let (Some(debug), Ok(name)) = (&self.debug, CString::new(name)) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }

    /// Takes an object's name back before it goes: validation layers keep the names of what is gone (64 bytes each in 1.3.239).
    pub fn unname_object(&self, object: impl vk::Handle) {
        if let Some(debug) = self.debug.as_ref().filter(|_| self.instance.validation) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }

    fn save_pipeline_cache(&self) {
        // What a driver still holds after a loss is not worth a risk to the next start.
        let Some(file) = self.cache_file.as_ref().filter(|_| !self.queue.is_lost()) else { return };
        // SAFETY: the cache is alive.
        let Ok(data) = (unsafe { self.raw.get_pipeline_cache_data(self.pipeline_cache) }) else { return };
        if std::fs::metadata(file).is_ok_and(|m| m.len() == data.len() as u64) {
            return;
        }
        // A cache that cannot be written costs the next start some time and nothing else.
        let temporary = file.with_extension(std::process::id().to_string());
        let saved = file
            .parent()
            .map_or(Ok(()), std::fs::create_dir_all)
            .and_then(|()| std::fs::write(&temporary, &data))
            .and_then(|()| std::fs::rename(&temporary, file));
        if let Err(e) = saved {
            let _ = std::fs::remove_file(&temporary);
            tracing::debug!("the pipeline cache was not saved: {e}");
        }
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        self.save_pipeline_cache();
        let _ = self.queue.idle(&self.raw);
        // SAFETY: every submission was waited for (or lost, and no work is under way on a lost device) and every buffer is
        // gone, since both hold this context; each handle is destroyed once, children before the device, the allocator's
        // memory before it too.
        unsafe {
            for frame in lock(&self.frames).drain(..) {
                frame.destroy(&self.raw);
            }
            for (_, pipeline) in lock(&self.pipelines).drain() {
                pipeline.destroy(&self.raw);
            }
            self.raw.destroy_pipeline_cache(self.pipeline_cache, None);
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_device(None);
        }
    }
}

fn cache_file(uuid: &[u8; 16]) -> Option<PathBuf> {
    let name = format!("{:032x}", u128::from_be_bytes(*uuid));
    dirs::cache_dir().map(|d| d.join("qirf-vk").join(format!("pipelines-{name}.bin")))
}
