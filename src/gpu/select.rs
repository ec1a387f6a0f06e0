//! Which device: what there is, what each can do, and the choice among them.

use super::error::{During, Error};
use super::instance::Instance;
use ash::{ext, khr, vk};
use serde::Serialize;
use std::ffi::CStr;

/// What a Vulkan device is and can do, as `qirf-vk device` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceInfo {
    /// Position in Vulkan's list: `--device INDEX`.
    pub index: usize,
    /// The device's own name.
    pub name: String,
    /// `discrete`, `integrated`, `virtual`, `cpu` or `other`.
    pub kind: &'static str,
    /// Driver name and version as the driver writes them.
    pub driver: String,
    /// Vulkan version, such as `1.4.305`.
    pub api: String,
    /// Invocations in a subgroup, as pinned.
    pub subgroup_size: u32,
    /// Smallest and largest subgroup that can be asked for.
    pub subgroup_range: [u32; 2],
    /// Largest buffer that a kernel can bind, in bytes.
    pub max_buffer_bytes: u64,
    /// Memory of the largest device-local heap, in bytes.
    pub memory_bytes: u64,
    /// Shared memory of a workgroup, in bytes.
    pub shared_bytes: u32,
    /// Largest workgroup.
    pub max_workgroup: u32,
    /// Nanoseconds per timestamp tick; 0 where the device has no timestamps.
    pub timestamp_period: f32,
    /// Optional features found: variants that may be chosen, never requirements.
    pub optional: Vec<&'static str>,
    /// Why the engine cannot use this device, if so.
    pub missing: Option<String>,
}

impl DeviceInfo {
    /// Whether its lanes are a CPU's: there long runs of work pay, and few of them suffice.
    pub fn is_cpu(&self) -> bool {
        self.kind == "cpu"
    }
}

pub(super) struct Candidate {
    pub physical: vk::PhysicalDevice,
    pub queue_family: u32,
    pub subgroup_control: bool,
    pub atomic_float: bool,
    pub memory_budget: bool,
    pub pipeline_cache_uuid: [u8; 16],
    pub info: DeviceInfo,
}

/// Lists every Vulkan device of this machine, usable or not, in Vulkan's order.
///
/// # Errors
/// [`Error::NoLoader`] without a Vulkan loader; Vulkan's own errors.
pub fn list() -> Result<Vec<DeviceInfo>, Error> {
    let instance = Instance::new(false)?;
    Ok(candidates(&instance)?.into_iter().map(|c| c.info).collect())
}

pub(super) fn candidates(instance: &Instance) -> Result<Vec<Candidate>, Error> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.raw.enumerate_physical_devices() }.during("enumerate devices")?;
    physical.into_iter().enumerate().map(|(index, p)| candidate(instance, index, p)).collect()
}

/// The device that `wanted` names (index, or part of its name in any case), or else the best usable one: discrete before
/// integrated before virtual before CPU.
pub(super) fn choose(mut all: Vec<Candidate>, wanted: Option<&str>) -> Result<Candidate, Error> {
    let position = if let Some(wanted) = wanted {
        let by_index = wanted.parse::<usize>().ok().filter(|i| *i < all.len());
        let lower = wanted.to_lowercase();
        let by_name = || all.iter().position(|c| c.info.name.to_lowercase().contains(&lower));
        by_index.or_else(by_name).ok_or_else(|| Error::UnknownDevice {
            wanted: wanted.to_owned(),
            there: all.iter().map(|c| format!("{} {}", c.info.index, c.info.name)).collect::<Vec<_>>().join(", "),
        })?
    } else {
        let rank = |c: &Candidate| match c.info.kind {
            _ if c.info.missing.is_some() => 9,
            "discrete" => 0,
            "integrated" => 1,
            "virtual" => 2,
            "cpu" => 3,
            _ => 4,
        };
        (0..all.len()).min_by_key(|i| rank(&all[*i])).ok_or(Error::NoDevice)?
    };
    let chosen = all.swap_remove(position);
    match &chosen.info.missing {
        Some(feature) => Err(Error::MissingFeature { device: chosen.info.name.clone(), feature: feature.clone() }),
        None => Ok(chosen),
    }
}

fn candidate(instance: &Instance, index: usize, physical: vk::PhysicalDevice) -> Result<Candidate, Error> {
    let raw = &instance.raw;
    // SAFETY: `physical` comes from this instance.
    let (base, memory, families, extensions) = unsafe {
        (
            raw.get_physical_device_properties(physical),
            raw.get_physical_device_memory_properties(physical),
            raw.get_physical_device_queue_family_properties(physical),
            raw.enumerate_device_extension_properties(physical).during("enumerate device extensions")?,
        )
    };
    let has = |name: &CStr| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
    let modern = base.api_version >= vk::API_VERSION_1_2;

    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut control = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
    let mut control_features = vk::PhysicalDeviceSubgroupSizeControlFeatures::default();
    let mut atomic = vk::PhysicalDeviceShaderAtomicFloatFeaturesEXT::default();
    if modern {
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut driver).push_next(&mut subgroup);
        let mut features = vk::PhysicalDeviceFeatures2::default();
        if has(ext::subgroup_size_control::NAME) {
            properties = properties.push_next(&mut control);
            features = features.push_next(&mut control_features);
        }
        if has(ext::shader_atomic_float::NAME) {
            features = features.push_next(&mut atomic);
        }
        // SAFETY: every chained structure belongs to Vulkan 1.2 or to an extension found above.
        unsafe {
            raw.get_physical_device_properties2(physical, &mut properties);
            raw.get_physical_device_features2(physical, &mut features);
        }
    }
    let subgroup_control = control_features.subgroup_size_control != 0
        && control.required_subgroup_size_stages.contains(vk::ShaderStageFlags::COMPUTE);
    let queue_family = families.iter().position(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE));
    let timestamps = queue_family.is_some_and(|f| families[f].timestamp_valid_bits > 0);

    let operations = vk::SubgroupFeatureFlags::BASIC
        | vk::SubgroupFeatureFlags::VOTE
        | vk::SubgroupFeatureFlags::ARITHMETIC
        | vk::SubgroupFeatureFlags::BALLOT
        | vk::SubgroupFeatureFlags::SHUFFLE
        | vk::SubgroupFeatureFlags::SHUFFLE_RELATIVE;
    let size = subgroup.subgroup_size;
    let missing = if !modern {
        Some("Vulkan 1.2".to_owned())
    } else if queue_family.is_none() {
        Some("a compute queue".to_owned())
    } else if !has(khr::push_descriptor::NAME) {
        Some("VK_KHR_push_descriptor".to_owned())
    } else if !subgroup.supported_operations.contains(operations)
        || !subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE)
    {
        Some("subgroup arithmetic, ballot and shuffles in compute".to_owned())
    } else if !(4..=128).contains(&size) {
        Some(format!("a subgroup of 4 to 128 invocations (it has {size})"))
    } else if base.limits.max_compute_work_group_invocations < 256 {
        Some("workgroups of 256 invocations".to_owned())
    } else {
        None
    };

    let mut optional = Vec::new();
    for (there, name) in [
        (subgroup_control, "subgroup-size-control"),
        (atomic.shader_buffer_float32_atomic_add != 0, "float-atomics"),
        (has(ext::memory_budget::NAME), "memory-budget"),
    ] {
        if there {
            optional.push(name);
        }
    }
    let text = |s: Result<&CStr, _>| s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let version = base.api_version;
    Ok(Candidate {
        physical,
        queue_family: queue_family.unwrap_or(0) as u32,
        subgroup_control,
        atomic_float: atomic.shader_buffer_float32_atomic_add != 0,
        memory_budget: has(ext::memory_budget::NAME),
        pipeline_cache_uuid: base.pipeline_cache_uuid,
        info: DeviceInfo {
            index,
            name: text(base.device_name_as_c_str()),
            kind: match base.device_type {
                vk::PhysicalDeviceType::DISCRETE_GPU => "discrete",
                vk::PhysicalDeviceType::INTEGRATED_GPU => "integrated",
                vk::PhysicalDeviceType::VIRTUAL_GPU => "virtual",
                vk::PhysicalDeviceType::CPU => "cpu",
                _ => "other",
            },
            driver: format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str())),
            api: format!(
                "{}.{}.{}",
                vk::api_version_major(version),
                vk::api_version_minor(version),
                vk::api_version_patch(version)
            ),
            subgroup_size: size,
            subgroup_range: if subgroup_control {
                [control.min_subgroup_size, control.max_subgroup_size]
            } else {
                [size, size]
            },
            max_buffer_bytes: u64::from(base.limits.max_storage_buffer_range),
            memory_bytes: memory
                .memory_heaps_as_slice()
                .iter()
                .filter(|h| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
                .map(|h| h.size)
                .max()
                .unwrap_or(0),
            shared_bytes: base.limits.max_compute_shared_memory_size,
            max_workgroup: base.limits.max_compute_work_group_invocations,
            timestamp_period: if timestamps { base.limits.timestamp_period } else { 0.0 },
            optional,
            missing,
        },
    })
}
