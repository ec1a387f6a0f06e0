//! The Vulkan layer, independent of splats: devices, memory, kernels, recordings with derived barriers, timestamps.
#![allow(unsafe_code)] // Vulkan is called from this floor alone; each block states its invariant.

mod buffer;
mod cache;
mod choose;
mod compiled;
mod context;
mod descriptors;
mod device;
mod encode;
mod error;
mod feed;
mod frame;
mod harness;
mod hazards;
mod info;
mod instance;
mod kernel;
mod logical;
mod memory;
mod module;
mod open;
mod options;
mod pace;
mod pipeline;
mod probe;
mod profiler;
mod queue;
mod readback;
mod recording;
mod shader;
mod staging;
mod submit;
mod traffic;
mod tuning;
mod work;

pub use buffer::{Buffer, RawBuffer};
pub use choose::address::{PciAddress, Uuid};
pub use choose::select::list;
pub use compiled::Compiled;
pub use descriptors::Descriptors;
pub use device::{Device, LargestBuffer, TunedDevice};
pub use error::Error;
pub use feed::Feed;
pub use harness::{Answer, Call, Claim, Derived, Fault, Forget, Harness, Limits, Order};
pub use hazards::{Barrier, Hazard, Hazards, Use};
pub use info::{DeviceClass, DeviceInfo, DeviceKind, Feature};
pub use kernel::Kernel;
pub use options::{DeviceOptions, Milliseconds};
pub use profiler::Timings;
pub use readback::Readback;
pub use recording::{Groups, Recording};
pub use shader::{Access, Shader};
pub use staging::staging_bytes;
pub use submit::Ticket;
pub use traffic::Traffic;
pub use tuning::Tuning;
pub use tuning::choice::TuningChoice;
pub use tuning::variants::{Variant, variants};
pub use work::Work;

/// Results of this floor.
pub type Result<T> = std::result::Result<T, Error>;
