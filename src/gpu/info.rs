//! Identity and capabilities of a device.

use super::choose::address::{PciAddress, Uuid};
use crate::wording::{named, unknown};
use ash::vk;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

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
        /// The driver translates to Direct3D 12: a second entry of a GPU that may have a driver of its own.
        Direct3D = "direct3d-12",
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

named! {
    /// Classes of devices, one per row of the table.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum DeviceClass {
        /// A CPU; lanes are the CPU's.
        Cpu = "cpu",
        /// A CPU under SwiftShader, whose compilers have limits of their own.
        SwiftShader = "swiftshader",
        /// A GPU of another maker.
        Gpu = "gpu",
        /// A GPU by NVIDIA.
        Nvidia = "nvidia",
        /// A GPU by AMD.
        Amd = "amd",
        /// A GPU by Intel.
        Intel = "intel",
        /// A GPU by Apple.
        Apple = "apple",
        /// A GPU by Qualcomm.
        Qualcomm = "qualcomm",
    }
}

impl DeviceClass {
    /// The class of a device, CPU or not, from its vendor's number in the Vulkan (or PCI) registry.
    pub(in crate::gpu) fn of(is_cpu: bool, vendor: u32) -> Self {
        match (is_cpu, vendor) {
            (true, 0x1ae0) => Self::SwiftShader,
            (true, _) => Self::Cpu,
            (_, 0x10de) => Self::Nvidia,
            (_, 0x1002) => Self::Amd,
            (_, 0x8086) => Self::Intel,
            (_, 0x106b) => Self::Apple,
            (_, 0x5143) => Self::Qualcomm,
            _ => Self::Gpu,
        }
    }
}

impl FromStr for DeviceClass {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|class| class.name() == name.to_lowercase());
        found.ok_or_else(|| unknown(name, "a class of devices", Self::ALL.map(Self::name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_by_kind_and_maker() {
        assert_eq!(DeviceClass::of(true, 0x8086), DeviceClass::Cpu);
        assert_eq!(DeviceClass::of(false, 0x8086), DeviceClass::Intel);
        assert_eq!(DeviceClass::of(true, 0x1ae0), DeviceClass::SwiftShader);
        assert_eq!(DeviceClass::of(false, 0x1234), DeviceClass::Gpu);
    }

    #[test]
    fn names_of_classes() {
        for class in DeviceClass::ALL {
            assert_eq!(class.to_string().to_uppercase().parse::<DeviceClass>().ok(), Some(class));
        }
        let error = "riva".parse::<DeviceClass>().unwrap_err();
        assert!(error.contains("'riva'") && error.contains("nvidia"), "{error}");
    }
}
