//! Train, prune and measure 3D Gaussian Splatting scenes with Vulkan compute.
//!
//! To render a model, read it, upload it, and give a renderer a camera:
//!
//! ```
//! use qirf_vk::gaussians::{formats, resident::Resident};
//! use qirf_vk::gpu::{Device, DeviceOptions};
//! use qirf_vk::render::{Renderer, Style};
//! use qirf_vk::{glam::DVec3, scene::camera::Camera};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # use qirf_vk::gpu::Error;
//! # if let Err(e @ (Error::NoLoader(_) | Error::NoDriver | Error::NoDevice)) = Device::open(&DeviceOptions::default()) {
//! #     println!("nothing was rendered: {e}");
//! #     return Ok(());
//! # }
//! let loaded = formats::read("tools/examples/ring.ply".as_ref())?;
//! let (model, settings) = (loaded.gaussians, Style::of(loaded.mode).over([0.0; 3])); // over black
//! let device = Device::open(&DeviceOptions::default())?;
//! let resident = Resident::upload(&device, &model)?;
//! let mut renderer = Renderer::new(&device, settings, model.len(), 640, 480)?;
//! let eye = DVec3::new(0.0, -1.0, 3.0); // captures have y pointing down
//! let camera = Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 1.0, 640, 480);
//! let image = renderer.render(&resident, &camera)?; // rows of red, green, blue, alpha
//! assert!(image.pixels.iter().any(|pixel| pixel[3] > 0.5));
//! # Ok(())
//! # }
//! ```
//!
//! `tools/examples` holds three programs: one renders a model, one trains a scene and prints the loss, and one runs a kernel
//! of its own.
//!
//! Functions that use a device can fail because its memory is exhausted or the device is lost, and functions that use files can
//! fail by their I/O. Docstrings name further errors, and the state after a failure.
//!
//! # Features
//!
//! All are on by default. `default-features = false` leaves the readers and writers of models and captures, the renderer, the
//! metrics and the float64 twin.
//!
//! | feature | adds | needs |
//! |---|---|---|
//! | `train` | `train`: loss, schedule, density control, the training loop | |
//! | `faer` | `qirf`: selection of Gaussians to prune | |
//! | `lapack` | `qirf` by LAPACK, which is preferred to `faer` if both are on; Linux only | `faer`; the system's OpenBLAS (`libopenblas-dev`) |
//! | `synth` | `synth`: an embedded scene, ray-traced into a capture | |
//! | `pipeline` | `pipeline`: whole jobs such as run, compress and eval; `job`, what they share; `selftest` | `train`, `synth`, `faer` |
//! | `report` | `report`: pages of a job's results | `pipeline` |
//! | `view` | `view`: a viewer for browsers | `pipeline` |
//! | `pose` | `pose`: camera poses of photos and videos, by COLMAP or OpenMVG-rs | `pipeline` |
//! | `shard` | `shard`: compression and training in tasks, for models and scenes larger than a device | `pipeline` |
//! | `lab` | `lab`: comparisons of pruning methods, and sweeps of accuracy against time | `report` |
//! | `cli` | the program `qirf-vk` | all above but `lapack` |
//!
//! # Floors
//!
//! Modules are floors: imports only go down the list. A stage has one name everywhere: shader (`glsl/`), host room,
//! float64 twin ([`reference`](mod@reference)), debug label, profiler scope and benchmark.

pub use glam;

pub mod gpu;
#[doc(hidden)]
pub mod kernels;

pub mod primitives;

mod checksum;
pub mod edit;
pub mod effects;
mod extension;
pub mod gaussians;
mod lock;
pub mod metrics;
mod percent;
mod ply;
#[cfg(feature = "faer")]
pub mod qirf;
pub mod random;
pub mod reference;
pub mod render;
pub mod response;
mod sample;
pub mod scene;
#[cfg(feature = "synth")]
pub mod synth;
#[cfg(feature = "train")]
pub mod train;
#[doc(hidden)]
pub mod wording;

#[cfg(feature = "pipeline")]
pub mod aim;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[cfg(feature = "pipeline")]
pub mod depth_maps;
#[cfg(feature = "pipeline")]
pub mod job;
#[cfg(feature = "lab")]
pub mod lab;
#[cfg(feature = "pipeline")]
pub mod pipeline;
#[cfg(feature = "pose")]
pub mod pose;
#[cfg(feature = "report")]
pub mod report;
#[cfg(feature = "pipeline")]
pub mod selftest;
#[cfg(feature = "shard")]
pub mod shard;
mod solve;
#[cfg(feature = "view")]
pub mod view;
