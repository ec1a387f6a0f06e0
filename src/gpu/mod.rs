//! Vulkan, and nothing of splats. Devices, memory, kernels, recordings with derived barriers, timestamps.
#![allow(unsafe_code)] // Vulkan is called from this floor alone; each block states its invariant.

mod address;
mod buffer;
mod choice;
mod compiled;
mod descriptors;
mod device;
mod encode;
mod error;
mod fault;
mod feed;
mod frame;
mod hazards;
mod imitation;
mod instance;
mod kernel;
mod lease;
mod memory;
mod module;
mod order;
mod pipeline;
mod probe;
mod profiler;
mod properties;
mod queue;
mod readback;
mod recording;
mod red_zone;
mod select;
mod staging;
mod submit;
mod tuning;
mod tuning_choice;
mod tuning_store;
mod tuning_variants;
mod variables;
mod visible;
mod work;

pub use address::{PciAddress, Uuid};
pub use buffer::{Buffer, RawBuffer};
pub use compiled::Compiled;
pub use descriptors::Descriptors;
pub use device::{Device, DeviceOptions, TunedDevice};
pub use error::Error;
pub use fault::{Answer, Call, Fault};
pub use feed::Feed;
pub use hazards::{Barrier, Hazard, Hazards, Use};
pub use imitation::{Claim, Limits};
pub use kernel::{Access, BindingInfo, Kernel, Shader};
pub use order::{Derived, Forget, Order};
pub use profiler::Timings;
pub use readback::Readback;
pub use recording::{Groups, Recording};
pub use select::{DeviceInfo, DeviceKind, Feature, list};
pub use staging::staging_bytes;
pub use submit::Ticket;
pub use tuning::{DeviceClass, Tuning};
pub use tuning_choice::TuningChoice;
pub use tuning_variants::{Variant, variants};
pub use work::{Traffic, Work};

/// Results of this floor.
pub type Result<T> = std::result::Result<T, Error>;
