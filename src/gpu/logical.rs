//! A logical device, and what its objects are made with.

use super::choose::properties::Candidate;
use super::descriptors::{Binder, Descriptors};
use super::error::{During, Error};
use super::info::{DeviceClass, DeviceInfo, Feature};
use super::instance::Instance;
use super::module::{Loops, Modules};
use super::options::DeviceOptions;
use ash::{ext, khr, vk};
use std::ffi::CString;

/// A logical device without its queue, memory and pipelines.
pub(super) struct Logical {
    pub raw: ash::Device,
    pub info: DeviceInfo,
    pub binder: Binder,
    pub modules: Modules,
    /// The subgroup size that kernels request, if they do.
    pub pinned_subgroup: Option<u32>,
    /// Whether workgroups are numbered from the last one.
    pub backwards: bool,
    /// Whether nothing is ever submitted.
    pub compile_only: bool,
    /// Whether validation layers are on.
    pub validates: bool,
    pub debug: Option<ext::debug_utils::Device>,
    pub executables: Option<khr::pipeline_executable_properties::Device>,
}

impl Logical {
    /// The logical device of a candidate, with one queue, for kernels of a class.
    pub fn new(
        instance: &Instance,
        candidate: &Candidate,
        class: DeviceClass,
        options: &DeviceOptions,
    ) -> Result<Self, Error> {
        let info = candidate.info.clone();
        let descriptors = Descriptors::choose(options.descriptors, &info)?;
        let raw = create(&instance.raw, candidate.physical, candidate.queue_family, &info)?;
        let executables = info.has(Feature::KernelStatistics);
        // A device with a single size has nothing to pin; a request would only limit the number of subgroups (llvmpipe:
        // 32 of 4).
        let [least, most] = info.subgroup_range;
        let pins = info.has(Feature::SubgroupSizeControl) && least < most && options.harness.claim.is_none();
        Ok(Self {
            binder: Binder::new(descriptors, &instance.raw, &raw),
            modules: Modules {
                folder: options.harness.shaders.clone(),
                keep_nan: info.has(Feature::NanPreserve),
                reconverge: info.has(Feature::UniformSubgroups),
                loops: Loops::of(info.kind, class),
            },
            pinned_subgroup: pins.then_some(info.subgroup_size),
            backwards: options.harness.order.is_some(),
            compile_only: options.compile_only,
            validates: instance.validation,
            debug: instance.debug_utils.then(|| ext::debug_utils::Device::new(&instance.raw, &raw)),
            executables: executables.then(|| khr::pipeline_executable_properties::Device::new(&instance.raw, &raw)),
            info,
            raw,
        })
    }

    /// Names an object for debuggers and validation layers.
    pub fn name(&self, object: impl vk::Handle, name: &str) {
        if let (Some(debug), Ok(name)) = (&self.debug, CString::new(name)) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
        }
    }

    /// Removes an object's name before it is destroyed: validation layers keep the names of destroyed objects (64 bytes
    /// each in 1.3.239).
    pub fn unname(&self, object: impl vk::Handle) {
        if let Some(debug) = self.debug.as_ref().filter(|_| self.validates) {
            let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object);
            // SAFETY: the object is a live child of this device.
            let _ = unsafe { debug.set_debug_utils_object_name(&info) };
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
    let mut uniform = vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::default()
        .shader_subgroup_uniform_control_flow(true);
    let mut executables =
        vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
    let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
    let mut wanted = vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut vulkan_1_2);
    // The extension must be enabled if it is present.
    if info.has(Feature::PortabilitySubset) {
        extensions.push(khr::portability_subset::NAME.as_ptr());
    }
    macro_rules! enable {
        ($there:expr, $name:expr, $features:ident) => {
            if $there {
                extensions.push($name.as_ptr());
                wanted = wanted.push_next(&mut $features);
            }
        };
    }
    enable!(sizes || full, ext::subgroup_size_control::NAME, control);
    enable!(info.has(Feature::FloatAtomics), ext::shader_atomic_float::NAME, atomic);
    enable!(info.has(Feature::UniformSubgroups), khr::shader_subgroup_uniform_control_flow::NAME, uniform);
    enable!(info.has(Feature::KernelStatistics), khr::pipeline_executable_properties::NAME, executables);
    // SAFETY: only extensions and features that the device reported are asked for.
    unsafe { instance.create_device(physical, &wanted.enabled_extension_names(&extensions), None) }
        .during("create device")
}
