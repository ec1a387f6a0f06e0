//! Imitated devices, for tests: tighter limits, and a driver that reports a wrong subgroup size.

use crate::gpu::info::{DeviceInfo, Feature};
use std::str::FromStr;

/// Upper bounds on a device's reported limits. The numbers for makers are typical, not those of a certain driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Largest buffer that a kernel can bind, in bytes.
    pub buffer_bytes: u64,
    /// Storage buffers that a kernel can bind.
    pub storage_buffers: u32,
    /// Bytes of push constants.
    pub push_bytes: u32,
    /// Largest workgroup.
    pub workgroup: u32,
    /// Shared memory of a workgroup, in bytes.
    pub shared_bytes: u32,
}

impl Limits {
    /// No bounds.
    pub const NONE: Self = Self {
        buffer_bytes: u64::MAX,
        storage_buffers: u32::MAX,
        push_bytes: u32::MAX,
        workgroup: u32::MAX,
        shared_bytes: u32::MAX,
    };
    /// Qualcomm's Adreno 6xx.
    pub const ADRENO: Self =
        Self { buffer_bytes: 128 << 20, storage_buffers: 24, push_bytes: 128, workgroup: 512, shared_bytes: 16 << 10 };
    /// Apple's GPUs through MoltenVK.
    pub const APPLE: Self = Self {
        buffer_bytes: (4 << 30) - 1,
        storage_buffers: 31,
        push_bytes: 4096,
        workgroup: 1024,
        shared_bytes: 32 << 10,
    };
    /// Intel's integrated GPUs.
    pub const INTEL: Self =
        Self { buffer_bytes: 1 << 30, storage_buffers: 64, push_bytes: 128, workgroup: 1024, shared_bytes: 32 << 10 };
    /// The smallest buffers that Vulkan guarantees.
    pub const SMALL_BUFFERS: Self = Self { buffer_bytes: 128 << 20, ..Self::NONE };

    /// Tightens a device's reported limits.
    pub(in crate::gpu) fn on(&self, info: &mut DeviceInfo) {
        info.max_buffer_bytes = info.max_buffer_bytes.min(self.buffer_bytes);
        info.max_storage_buffers = info.max_storage_buffers.min(self.storage_buffers);
        info.push_bytes = info.push_bytes.min(self.push_bytes);
        info.max_workgroup = info.max_workgroup.min(self.workgroup);
        info.shared_bytes = info.shared_bytes.min(self.shared_bytes);
    }
}

impl FromStr for Limits {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(match text {
            "adreno" => Self::ADRENO,
            "apple" => Self::APPLE,
            "intel" => Self::INTEL,
            "small-buffers" => Self::SMALL_BUFFERS,
            other => {
                let bytes = other.strip_prefix("buffers=").and_then(|bytes| bytes.parse().ok());
                let unknown = || format!("'{other}' is none of adreno, apple, intel, small-buffers and buffers=BYTES");
                Self { buffer_bytes: bytes.ok_or_else(unknown)?, ..Self::NONE }
            }
        })
    }
}

/// The subgroup size that a driver is made to report, whatever the real one; as text `16`, or `16,unpinned`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Invocations in a subgroup.
    pub subgroup: u32,
    /// Whether kernels may also request that size.
    pub pinned: bool,
}

impl Claim {
    /// Makes the driver report the claim. Kernels then request no size, because the driver would refuse this one.
    pub(in crate::gpu) fn on(self, info: &mut DeviceInfo) {
        info.subgroup_size = self.subgroup;
        info.subgroup_range = [self.subgroup; 2];
        if !self.pinned {
            info.optional.retain(|feature| *feature != Feature::SubgroupSizeControl);
        }
    }
}

impl FromStr for Claim {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (size, pinned) = text.strip_suffix(",unpinned").map_or((text, true), |size| (size, false));
        let subgroup = size.parse().map_err(|_| format!("'{size}' is not a number of invocations"))?;
        Ok(Self { subgroup, pinned })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_imitations() {
        assert_eq!("adreno".parse(), Ok(Limits::ADRENO));
        assert_eq!("buffers=4096".parse(), Ok(Limits { buffer_bytes: 4096, ..Limits::NONE }));
        assert!("buffers=many".parse::<Limits>().is_err());
        assert!("riva".parse::<Limits>().is_err_and(|e| e.contains("'riva'") && e.contains("small-buffers")));
        assert_eq!("16".parse(), Ok(Claim { subgroup: 16, pinned: true }));
        assert_eq!("4,unpinned".parse(), Ok(Claim { subgroup: 4, pinned: false }));
        assert!("wide".parse::<Claim>().is_err_and(|e| e.contains("'wide'")));
    }
}
