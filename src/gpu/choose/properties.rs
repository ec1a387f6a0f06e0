//! Properties of a device as Vulkan reports them.

use crate::gpu::choose::address::{PciAddress, Uuid};
use crate::gpu::choose::lease::Lease;
use crate::gpu::error::{During, Error};
use crate::gpu::info::{DeviceClass, DeviceInfo, DeviceKind, Feature};
use crate::kernels::needs;
use ash::{ext, khr, vk};
use std::ffi::CStr;

/// Shared memory that a device must have: the minimum that Vulkan guarantees. Kernels in the usual shapes of GPUs fit into it; others are
/// compared with the device's own by `Tuning::check`.
pub(in crate::gpu) const SHARED_BYTES: u32 = 16 << 10;

/// Subgroup size on Intel's GPUs.
const INTEL_SUBGROUP: u32 = 16;

/// A physical device that may be opened.
pub(in crate::gpu) struct Candidate {
    pub physical: vk::PhysicalDevice,
    pub queue_family: u32,
    pub pipeline_cache_uuid: [u8; 16],
    /// Bytes of the heap of [`DeviceInfo::memory_bytes`] that are free for this program, as reported by the driver.
    pub free_bytes: Option<u64>,
    /// Its place among devices of its kind, in the environment's order or Vulkan's.
    pub place: usize,
    /// The lease, if it was chosen by lease.
    pub lease: Option<Lease>,
    pub info: DeviceInfo,
}

/// Vulkan's report on a physical device. The structures' own pointers to each other are never followed.
#[derive(Default)]
pub(in crate::gpu) struct Report {
    base: vk::PhysicalDeviceProperties,
    memory: vk::PhysicalDeviceMemoryProperties,
    families: Vec<vk::QueueFamilyProperties>,
    extensions: Vec<vk::ExtensionProperties>,
    driver: vk::PhysicalDeviceDriverProperties<'static>,
    subgroup: vk::PhysicalDeviceSubgroupProperties<'static>,
    floats: vk::PhysicalDeviceFloatControlsProperties<'static>,
    control: vk::PhysicalDeviceSubgroupSizeControlProperties<'static>,
    control_features: vk::PhysicalDeviceSubgroupSizeControlFeatures<'static>,
    vulkan_1_2: vk::PhysicalDeviceVulkan12Features<'static>,
    push: vk::PhysicalDevicePushDescriptorPropertiesKHR<'static>,
    atomic: vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT<'static>,
    executables: vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR<'static>,
    budget: vk::PhysicalDeviceMemoryBudgetPropertiesEXT<'static>,
    id: vk::PhysicalDeviceIDProperties<'static>,
    bus: vk::PhysicalDevicePCIBusInfoPropertiesEXT<'static>,
    allocation: vk::PhysicalDeviceMaintenance3Properties<'static>,
    buffers: vk::PhysicalDeviceMaintenance4Properties<'static>,
    uniform: vk::PhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR<'static>,
}

impl Report {
    pub fn of(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Result<Self, Error> {
        // SAFETY: `physical` comes from this instance.
        let mut report = unsafe {
            Self {
                base: instance.get_physical_device_properties(physical),
                memory: instance.get_physical_device_memory_properties(physical),
                families: instance.get_physical_device_queue_family_properties(physical),
                extensions: instance
                    .enumerate_device_extension_properties(physical)
                    .during("enumerate device extensions")?,
                ..Self::default()
            }
        };
        if report.is_modern() {
            report.extend(instance, physical);
        }
        Ok(report)
    }

    /// Adds the properties that devices of Vulkan 1.2 report beyond the basic ones.
    fn extend(&mut self, instance: &ash::Instance, physical: vk::PhysicalDevice) {
        let names = [
            ext::subgroup_size_control::NAME,
            ext::shader_atomic_float::NAME,
            ext::memory_budget::NAME,
            khr::push_descriptor::NAME,
            khr::pipeline_executable_properties::NAME,
            ext::pci_bus_info::NAME,
            khr::maintenance4::NAME,
            khr::shader_subgroup_uniform_control_flow::NAME,
        ];
        let [control, atomic, budget, push, executables, bus, buffers, uniform] = names.map(|name| self.has(name));
        let mut properties = vk::PhysicalDeviceProperties2::default()
            .push_next(&mut self.driver)
            .push_next(&mut self.subgroup)
            .push_next(&mut self.floats)
            .push_next(&mut self.id)
            .push_next(&mut self.allocation);
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut self.vulkan_1_2);
        let mut memory = vk::PhysicalDeviceMemoryProperties2::default();
        // Structures of extensions are chained if the extension is there.
        macro_rules! chain {
            ($($there:ident: $into:ident.$field:ident),*) => {
                $(if $there {
                    $into = $into.push_next(&mut self.$field);
                })*
            };
        }
        chain!(
            control: properties.control, control: features.control_features, push: properties.push, bus: properties.bus,
            buffers: properties.buffers, uniform: features.uniform, atomic: features.atomic,
            executables: features.executables, budget: memory.budget
        );
        // SAFETY: every chained structure belongs to Vulkan 1.2 or to an extension that the device has.
        unsafe {
            instance.get_physical_device_properties2(physical, &mut properties);
            instance.get_physical_device_features2(physical, &mut features);
            instance.get_physical_device_memory_properties2(physical, &mut memory);
        }
    }

    fn has(&self, extension: &CStr) -> bool {
        self.extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(extension))
    }

    fn is_modern(&self) -> bool {
        self.base.api_version >= vk::API_VERSION_1_2
    }

    fn queue_family(&self) -> Option<usize> {
        self.families.iter().position(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE))
    }

    /// The largest device-local heap, or the largest one of a device that shares the host's memory, of which drivers may
    /// declare only a part as local (AMD's on Windows: some hundred megabytes): its index and bytes.
    fn heap(&self) -> Option<(usize, u64)> {
        let shared = self.base.device_type == vk::PhysicalDeviceType::INTEGRATED_GPU;
        let heaps = self.memory.memory_heaps_as_slice().iter().enumerate();
        let local = heaps.filter(|(_, h)| shared || h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        local.map(|(i, h)| (i, h.size)).max_by_key(|(_, size)| *size)
    }

    /// The first requirement of the engine that the device does not meet, given its limits in `info`.
    pub fn missing(&self, info: &DeviceInfo) -> Option<String> {
        let operations = vk::SubgroupFeatureFlags::BASIC
            | vk::SubgroupFeatureFlags::VOTE
            | vk::SubgroupFeatureFlags::ARITHMETIC
            | vk::SubgroupFeatureFlags::BALLOT
            | vk::SubgroupFeatureFlags::SHUFFLE
            | vk::SubgroupFeatureFlags::SHUFFLE_RELATIVE;
        let subgroups = self.subgroup.supported_operations.contains(operations)
            && self.subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE);
        let size = info.subgroup_size;
        let width = (4..=128).contains(&size) && size.is_power_of_two();
        let at_least =
            |there: u32, needed: u32, what: &str| (there >= needed, format!("{needed} {what} (it has {there})"));
        let needs = [
            (self.is_modern(), "Vulkan 1.2".to_owned()),
            (self.queue_family().is_some(), "a compute queue".to_owned()),
            (
                !self.ignores_sizes_of_arrays(),
                "MoltenVK 1.3 or newer: older ones ignore constants that size arrays".to_owned(),
            ),
            (subgroups, "subgroup arithmetic, ballot and shuffles in compute".to_owned()),
            (self.vulkan_1_2.subgroup_broadcast_dynamic_id != 0, "subgroupBroadcastDynamicId".to_owned()),
            (
                // Such drivers choose the width of each kernel, and report the widest.
                info.class != DeviceClass::Intel || info.has(Feature::SubgroupSizeControl),
                "control over the size of subgroups, which differs between kernels of Intel's GPUs".to_owned(),
            ),
            (width, format!("a subgroup of 4, 8, 16, 32, 64 or 128 invocations (it has {size})")),
            at_least(info.max_workgroup, 256, "invocations in a workgroup"),
            at_least(info.max_storage_buffers, needs::STORAGE_BUFFERS, "storage buffers in a kernel"),
            at_least(info.push_bytes, needs::PUSH_BYTES, "bytes of push constants"),
            at_least(info.shared_bytes, SHARED_BYTES, "bytes of shared memory"),
        ];
        needs.into_iter().find(|(there, _)| !there).map(|(_, what)| what)
    }

    /// Whether this is MoltenVK before 1.3: arrays whose sizes are specialization constants keep their default sizes there.
    fn ignores_sizes_of_arrays(&self) -> bool {
        // MoltenVK writes version 1.2.11 as 1 02 11.
        self.driver.driver_id == vk::DriverId::MOLTENVK && self.base.driver_version < 1_03_00
    }

    fn optional(&self) -> Vec<Feature> {
        let control = self.control_features.subgroup_size_control != 0
            && self.control.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE);
        let atomics = self.atomic.shader_buffer_float32_atomic_add != 0;
        let features = [
            (Feature::SubgroupSizeControl, control),
            (Feature::FloatAtomics, atomics),
            (Feature::MemoryBudget, self.has(ext::memory_budget::NAME)),
            (Feature::KernelStatistics, self.executables.pipeline_executable_info != 0),
            (Feature::NanPreserve, self.floats.shader_signed_zero_inf_nan_preserve_float32 != 0),
            (Feature::PushDescriptors, self.push.max_push_descriptors >= needs::STORAGE_BUFFERS),
            (Feature::UniformSubgroups, self.uniform.shader_subgroup_uniform_control_flow != 0),
            (Feature::FullSubgroups, self.control_features.compute_full_subgroups != 0),
            (Feature::PortabilitySubset, self.has(khr::portability_subset::NAME)),
            (Feature::Direct3D, self.driver.driver_id == vk::DriverId::MESA_DOZEN),
        ];
        features.into_iter().filter(|(_, there)| *there).map(|(feature, _)| feature).collect()
    }

    /// The subgroup size to use. Intel's GPUs report their widest, with which a lane has 32 registers where the rasterisers
    /// need 60 to 90; with half of it, it has 64.
    fn subgroup_size(&self, class: DeviceClass, pinned: bool) -> u32 {
        let range = self.control.min_subgroup_size..=self.control.max_subgroup_size;
        let half = INTEL_SUBGROUP;
        if pinned && class == DeviceClass::Intel && range.contains(&half) { half } else { self.subgroup.subgroup_size }
    }

    /// Bytes of the largest buffer that can be made and bound by a kernel.
    fn largest_buffer(&self) -> u64 {
        let given = [self.allocation.max_memory_allocation_size, self.buffers.max_buffer_size];
        let limits = given.into_iter().filter(|bytes| *bytes > 0);
        limits.fold(u64::from(self.base.limits.max_storage_buffer_range), u64::min)
    }

    fn pci(&self) -> Option<PciAddress> {
        let vk::PhysicalDevicePCIBusInfoPropertiesEXT { pci_domain, pci_bus, pci_device, pci_function, .. } = self.bus;
        let address = PciAddress { domain: pci_domain, bus: pci_bus, device: pci_device, function: pci_function };
        (self.is_modern() && self.has(ext::pci_bus_info::NAME)).then_some(address)
    }

    pub fn candidate(&self, physical: vk::PhysicalDevice, info: DeviceInfo) -> Candidate {
        let free = |(heap, _)| self.budget.heap_budget[heap];
        Candidate {
            physical,
            queue_family: self.queue_family().unwrap_or(0) as u32,
            pipeline_cache_uuid: self.base.pipeline_cache_uuid,
            place: 0,
            lease: None,
            free_bytes: self.heap().map(free).filter(|_| info.has(Feature::MemoryBudget)),
            info,
        }
    }

    pub fn info(&self, index: usize) -> DeviceInfo {
        let optional = self.optional();
        let text = |s: Result<&CStr, _>| s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let kind = DeviceKind::from(self.base.device_type);
        let (version, limits) = (self.base.api_version, &self.base.limits);
        let [major, minor, patch] =
            [vk::api_version_major(version), vk::api_version_minor(version), vk::api_version_patch(version)];
        let class = DeviceClass::of(kind == DeviceKind::Cpu, self.base.vendor_id);
        let pinned = optional.contains(&Feature::SubgroupSizeControl);
        let workgroup = limits.max_compute_work_group_invocations.min(limits.max_compute_work_group_size[0]);
        let size = self.subgroup_size(class, pinned);
        // If kernels request a subgroup size, a workgroup has at most this many subgroups.
        let asked = pinned && self.control.min_subgroup_size < self.control.max_subgroup_size;
        let subgroups = if asked { self.control.max_compute_workgroup_subgroups } else { u32::MAX };
        let max_workgroup = workgroup.min(subgroups.saturating_mul(size));
        let timestamps = self.queue_family().is_some_and(|f| self.families[f].timestamp_valid_bits > 0);
        DeviceInfo {
            index,
            name: text(self.base.device_name_as_c_str()),
            kind,
            class,
            driver: format!(
                "{} {}",
                text(self.driver.driver_name_as_c_str()),
                text(self.driver.driver_info_as_c_str())
            ),
            api: format!("{major}.{minor}.{patch}"),
            subgroup_size: size,
            subgroup_range: if pinned {
                [self.control.min_subgroup_size, self.control.max_subgroup_size]
            } else {
                [size, size]
            },
            max_buffer_bytes: self.largest_buffer(),
            max_storage_buffers: limits
                .max_per_stage_descriptor_storage_buffers
                .min(limits.max_descriptor_set_storage_buffers)
                .min(limits.max_per_stage_resources),
            push_bytes: limits.max_push_constants_size,
            memory_bytes: self.heap().map_or(0, |(_, size)| size),
            shared_bytes: limits.max_compute_shared_memory_size,
            max_workgroup,
            timestamp_period: if timestamps { limits.timestamp_period } else { 0.0 },
            optional,
            vendor: self.base.vendor_id,
            uuid: self.is_modern().then_some(Uuid(self.id.device_uuid)),
            pci: self.pci(),
            hidden_by: None,
            missing: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tuning::choice::TuningChoice;

    /// The report of a Mac with Apple's GPU through a version of MoltenVK.
    fn moltenvk(version: u32) -> Report {
        let mut report = Report { families: vec![vk::QueueFamilyProperties::default()], ..Report::default() };
        report.families[0].queue_flags = vk::QueueFlags::COMPUTE;
        report.driver.driver_id = vk::DriverId::MOLTENVK;
        (report.base.api_version, report.base.driver_version) = (vk::API_VERSION_1_2, version);
        report.base.limits = vk::PhysicalDeviceLimits {
            max_compute_work_group_invocations: 1024,
            max_compute_work_group_size: [1024; 3],
            max_per_stage_descriptor_storage_buffers: 31,
            max_descriptor_set_storage_buffers: 155,
            max_per_stage_resources: 127,
            max_push_constants_size: 4096,
            max_compute_shared_memory_size: 32 << 10,
            ..Default::default()
        };
        report.subgroup.subgroup_size = 32;
        report.subgroup.supported_stages = vk::ShaderStageFlags::COMPUTE;
        report.subgroup.supported_operations = vk::SubgroupFeatureFlags::from_raw(0xff);
        report.vulkan_1_2.subgroup_broadcast_dynamic_id = vk::TRUE;
        report
    }

    #[test]
    fn limits_that_makers_report() {
        let mut report = moltenvk(1_03_00);
        report.base.limits.max_storage_buffer_range = u32::MAX;
        assert_eq!(report.info(0).max_buffer_bytes, u64::from(u32::MAX), "a device that tells no more");
        // AMD's drivers for Windows.
        report.allocation.max_memory_allocation_size = 2 << 30;
        report.memory.memory_heap_count = 2;
        report.memory.memory_heaps[0] = vk::MemoryHeap { size: 512 << 20, flags: vk::MemoryHeapFlags::DEVICE_LOCAL };
        report.memory.memory_heaps[1] = vk::MemoryHeap { size: 15 << 30, flags: vk::MemoryHeapFlags::empty() };
        for (kind, bytes) in
            [(vk::PhysicalDeviceType::INTEGRATED_GPU, 15 << 30), (vk::PhysicalDeviceType::DISCRETE_GPU, 512 << 20)]
        {
            report.base.device_type = kind;
            assert_eq!((report.info(0).memory_bytes, report.info(0).max_buffer_bytes), (bytes, 2 << 30));
        }
    }

    #[test]
    fn intel_has_subgroups_of_16_where_they_can_be_requested() {
        let mut report = moltenvk(1_03_00);
        report.base.vendor_id = 0x8086;
        assert_eq!(report.info(0).subgroup_size, 32);
        let missing = report.missing(&report.info(0));
        assert!(missing.is_some_and(|what| what.contains("size of subgroups")), "MoltenVK on a Mac with such a GPU");
        report.control_features.subgroup_size_control = vk::TRUE;
        report.control = vk::PhysicalDeviceSubgroupSizeControlProperties {
            min_subgroup_size: 8,
            max_subgroup_size: 32,
            max_compute_workgroup_subgroups: 64,
            required_subgroup_size_stages: vk::ShaderStageFlags::COMPUTE,
            ..Default::default()
        };
        let info = report.info(0);
        assert_eq!((info.subgroup_size, info.subgroup_range, info.max_workgroup), (16, [8, 32], 1024));
        assert_eq!(TuningChoice::default().on(&info).map(|tuning| tuning.subgroup).ok(), Some(16));
        report.base.vendor_id = 0x1002;
        assert_eq!(report.info(0).subgroup_size, 32);
    }

    /// A serial sort has counters for each invocation: in the shapes of CPUs, 34 KiB on subgroups of 32.
    #[test]
    fn sorts_beyond_the_shared_memory_are_refused() {
        let info = moltenvk(1_03_00).info(0);
        let chosen = |text: &str| text.parse().map(|choice: TuningChoice| choice.on(&info)).expect("a choice");
        for fits in ["", "gpu", "gpu,sort_workgroup=512"] {
            assert!(chosen(fits).is_ok(), "{fits}: {:?}", chosen(fits));
        }
        for beyond in ["cpu", "gpu,sort_workgroup=1024"] {
            let told = chosen(beyond).expect_err(beyond).to_string();
            assert!(told.contains("sort_workgroup") && told.contains("34816") && told.contains("32768"), "{told}");
        }
    }

    #[test]
    fn moltenvk_before_1_3_is_refused_by_name() {
        let missing = |report: Report| report.missing(&report.info(0));
        for version in [1_01_05, 1_02_11] {
            assert!(
                missing(moltenvk(version)).is_some_and(|what| what.starts_with("MoltenVK 1.3 or newer")),
                "{version}"
            );
        }
        assert_eq!(missing(moltenvk(1_03_00)), None);
        let mut other = moltenvk(1_02_11);
        other.driver.driver_id = vk::DriverId::MESA_RADV;
        assert_eq!(missing(other), None, "another driver's versions mean something else");
    }
}
