//! The Vulkan devices of this machine and their capabilities.

use crate::gpu::choose::address::{PciAddress, Uuid};
use crate::gpu::choose::lease::Lease;
use crate::gpu::choose::properties::Report;
use crate::gpu::choose::visible::{Named, Visibility, visibility};
use crate::gpu::error::{During, Error};
use crate::gpu::harness::imitation::{Claim, Limits};
use crate::gpu::instance::Instance;
use crate::gpu::tuning::DeviceClass;
use crate::wording::named;
use ash::vk;
use serde::Serialize;

named! {
    /// Kinds of devices, in the order of preference.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum DeviceKind {
        /// A GPU with memory of its own.
        Discrete = "discrete",
        /// A GPU that shares the host's memory.
        Integrated = "integrated",
        /// A share of a GPU, in a virtual machine.
        Virtual = "virtual",
        /// A driver that runs kernels on the CPU.
        Cpu = "cpu",
        /// Any other kind.
        Other = "other",
    }
}

impl From<vk::PhysicalDeviceType> for DeviceKind {
    fn from(kind: vk::PhysicalDeviceType) -> Self {
        match kind {
            vk::PhysicalDeviceType::DISCRETE_GPU => Self::Discrete,
            vk::PhysicalDeviceType::INTEGRATED_GPU => Self::Integrated,
            vk::PhysicalDeviceType::VIRTUAL_GPU => Self::Virtual,
            vk::PhysicalDeviceType::CPU => Self::Cpu,
            _ => Self::Other,
        }
    }
}

named! {
    /// Optional features: used if present, never required.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Feature {
        /// Kernels can request a subgroup size.
        SubgroupSizeControl = "subgroup-size-control",
        /// Atomic addition to floats in buffers.
        FloatAtomics = "float-atomics",
        /// The driver reports how much memory is free.
        MemoryBudget = "memory-budget",
        /// The driver reports statistics of compiled kernels.
        KernelStatistics = "kernel-statistics",
        /// Kernels may request that infinities and NaN are kept.
        NanPreserve = "nan-preserve",
        /// Buffers can be bound inside command buffers.
        PushDescriptors = "push-descriptors",
        /// Subgroups that enter a branch or loop as one leave it as one, if kernels declare it.
        UniformSubgroups = "uniform-subgroups",
        /// Kernels can request workgroups of whole subgroups.
        FullSubgroups = "full-subgroups",
        /// The device sits on another interface, such as Metal, and may lack parts of Vulkan.
        PortabilitySubset = "portability-subset",
    }
}

/// A Vulkan device's identity and capabilities, as `qirf-vk device` prints them.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceInfo {
    /// Position in Vulkan's list: `--device INDEX`.
    pub index: usize,
    /// The device's own name.
    pub name: String,
    /// Its kind.
    pub kind: DeviceKind,
    /// Its class, by which kernels are tuned.
    pub class: DeviceClass,
    /// Driver name and version as the driver writes them.
    pub driver: String,
    /// Vulkan version, such as `1.4.305`.
    pub api: String,
    /// Invocations per subgroup, as pinned.
    pub subgroup_size: u32,
    /// Smallest and largest subgroup size that can be requested.
    pub subgroup_range: [u32; 2],
    /// Largest buffer that can be made and bound by a kernel, in bytes.
    pub max_buffer_bytes: u64,
    /// Most buffers that a kernel can bind.
    pub max_storage_buffers: u32,
    /// Bytes of push constants.
    pub push_bytes: u32,
    /// Memory of the largest device-local heap, in bytes; where the device shares the host's memory, of the largest heap.
    pub memory_bytes: u64,
    /// Shared memory of a workgroup, in bytes.
    pub shared_bytes: u32,
    /// Largest workgroup.
    pub max_workgroup: u32,
    /// Nanoseconds per timestamp tick; 0 where the device has no timestamps.
    pub timestamp_period: f32,
    /// Optional features found.
    pub optional: Vec<Feature>,
    /// Its vendor's PCI number.
    pub vendor: u32,
    /// Its UUID: `--device uuid:UUID`.
    pub uuid: Option<Uuid>,
    /// Its PCI address, if its driver reports it: `--device pci:ADDRESS`.
    pub pci: Option<PciAddress>,
    /// The environment variable that reserves it for other jobs, if any: it must then be named to be used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hidden_by: Option<&'static str>,
    /// The reason why the engine cannot use this device, if any.
    pub missing: Option<String>,
}

impl DeviceInfo {
    /// Whether the device has an optional feature.
    pub fn has(&self, feature: Feature) -> bool {
        self.optional.contains(&feature)
    }
}

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

/// Lists every Vulkan device of this machine, usable or not, in Vulkan's order.
///
/// # Errors
/// [`Error::NoLoader`] without a Vulkan loader; Vulkan's own errors.
pub fn list() -> Result<Vec<DeviceInfo>, Error> {
    let instance = Instance::new(false)?;
    Ok(candidates(&instance, Limits::NONE, None)?.into_iter().map(|c| c.info).collect())
}

/// The devices, as they are or imitating others.
pub(in crate::gpu) fn candidates(
    instance: &Instance,
    limits: Limits,
    claim: Option<Claim>,
) -> Result<Vec<Candidate>, Error> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.raw.enumerate_physical_devices() }.during("enumerate devices")?;
    let candidate = |(i, p)| {
        let report = Report::of(&instance.raw, p)?;
        let mut info = report.info(i);
        limits.on(&mut info);
        claim.inspect(|claim| claim.on(&mut info));
        info.missing = report.missing(&info);
        Ok(report.candidate(p, info))
    };
    let mut all: Vec<Candidate> = physical.into_iter().enumerate().map(candidate).collect::<Result<_, Error>>()?;
    let named: Vec<Named> = all.iter().map(|c| Named::of(&c.info)).collect();
    let visible = visibility(&named, &|name| std::env::var(name).ok());
    for (candidate, visible) in all.iter_mut().zip(visible) {
        match visible {
            Visibility::Place(place) => candidate.place = place,
            Visibility::Hidden(variable) => candidate.info.hidden_by = Some(variable),
        }
    }
    Ok(all)
}
