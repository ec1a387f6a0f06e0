//! Floor 5: from Gaussians and a camera to a picture: project, depth sort, bin, tile sort, rasterise.

mod bin;
mod project;
mod rasterise;
mod renderer;
mod settings;

pub use renderer::{Image, Renderer, STAGES};
pub use settings::{Culling, Settings, view};
