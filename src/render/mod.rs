//! From Gaussians and a camera to a picture: project, depth sort, bin, tile sort, rasterise.

mod atomic_sums;
mod backward;
mod bin;
mod frame;
mod frustum;
mod parts;
mod project;
mod project_backward;
mod rasterise;
mod rasterise_backward;
mod rasterise_backward_atomic;
mod renderer;
mod settings;
mod slot_sums;
mod slots;
mod training;

pub use atomic_sums::AtomicSums;
pub use backward::{Backward, BackwardCounts};
pub use frame::{Purpose, Uses};
pub use frustum::visible;
pub use parts::{Beside, Outcome, Painter, Part, Parts, Source, binds, capacity, largest};
pub use renderer::{Image, LEAST_PAIRS, Released, Renderer, STAGES};
pub use settings::{Culling, Settings, Style, view};
pub use slot_sums::SlotSums;
pub use slots::{GradientRows, Slots};
pub use training::{BACKWARD_STAGES, TrainingRenderer};
