//! Errors of Vulkan devices.

use super::info::DeviceKind;
use ash::vk;
use std::path::PathBuf;

/// An error of the device floor; each message names the cause.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// No Vulkan loader on this machine.
    #[error("no Vulkan loader was found ({0})")]
    NoLoader(String),
    /// A loader without a driver that it can load.
    #[error("the Vulkan loader can load no driver")]
    NoDriver,
    /// Drivers without a device.
    #[error("Vulkan reports no device")]
    NoDevice,
    /// No device has the name or index asked for.
    #[error("no device matches '{wanted}'; there are: {there}")]
    UnknownDevice { wanted: String, there: String },
    /// Not a device address.
    #[error("{0}")]
    Address(String),
    /// Other processes hold all devices.
    #[error("all devices of the best kind ({kind}: {held}) are held by other processes that asked for a free one")]
    NoFreeDevice { held: usize, kind: DeviceKind },
    /// The environment hides every device.
    #[error("{variable} hides every device")]
    HiddenDevices { variable: &'static str },
    /// The folder of leases cannot be used.
    #[error("{}: leases of devices cannot be kept there: {source}", path.display())]
    Lease { path: PathBuf, source: std::io::Error },
    /// A tuning that does not exist, or that does not fit the device.
    #[error("tuning: {0}")]
    Tuning(String),
    /// An environment variable with an invalid value.
    #[error("{name}={text}: {what}")]
    Variable { name: &'static str, text: String, what: String },
    /// The device lacks a required feature.
    #[error("{device} lacks {feature}, which qirf-vk needs")]
    MissingFeature { device: String, feature: String },
    /// The driver computes wrong results.
    #[error("the driver of {device} ({driver}) is unreliable: {what}")]
    Driver { device: String, driver: String, what: String },
    /// A module that replaces one of the program's own cannot be read.
    #[error("{}: {what}", path.display())]
    Shader { path: PathBuf, what: String },
    /// One buffer is larger than the device can bind.
    #[error("buffer '{name}' needs {needed} bytes, but {device} binds at most {limit}")]
    TooLarge { name: String, needed: u64, limit: u64, device: String },
    /// Memory ran out.
    #[error("out of memory on {device}: '{name}' needs {needed} bytes, {used} are in use and {limit} may be")]
    OutOfMemory {
        name: String,
        needed: u64,
        /// Bytes in use by this program.
        used: u64,
        /// Bytes that the device, or the limit that was set, allows.
        limit: u64,
        device: String,
    },
    /// The system or the driver ran out of memory in a call.
    #[error("{of} memory ran out during {call}")]
    Exhausted { call: &'static str, of: &'static str },
    /// The device stopped answering in this call.
    #[error(
        "the device was lost during {0}: its driver reset it (it crashed, hung, or ran one submission for longer than the driver allows), or it was removed; the system's log has details"
    )]
    Lost(&'static str),
    /// Any other Vulkan error.
    #[error("Vulkan failed in {call}: {result}")]
    Vulkan { call: &'static str, result: vk::Result },
}

impl Error {
    /// Whether the cause is a lack of resources (exit code 5) rather than the device itself (exit code 4).
    pub fn is_resources(&self) -> bool {
        matches!(self, Self::TooLarge { .. } | Self::OutOfMemory { .. } | Self::Exhausted { .. })
    }

    /// Whether the device is lost: it cannot be used any more.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Lost(_))
    }
}

/// Names the call that a Vulkan result came from.
pub(super) trait During<T> {
    fn during(self, call: &'static str) -> Result<T, Error>;
}

impl<T> During<T> for Result<T, vk::Result> {
    fn during(self, call: &'static str) -> Result<T, Error> {
        self.map_err(|result| match result {
            vk::Result::ERROR_DEVICE_LOST => Error::Lost(call),
            vk::Result::ERROR_OUT_OF_HOST_MEMORY => Error::Exhausted { call, of: "the host's" },
            vk::Result::ERROR_OUT_OF_DEVICE_MEMORY => Error::Exhausted { call, of: "the device's" },
            result => Error::Vulkan { call, result },
        })
    }
}
