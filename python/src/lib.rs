//! `qirf_vk` for Python: models, pictures, training, compression and scores. `qirf_vk.pyi` documents it.

// Docstrings are Python's: "key" in brackets is no link.
#![allow(clippy::doc_link_with_quotes)]

mod arrays;
mod camera;
mod compress;
mod device;
mod edit;
mod errors;
mod evaluate;
mod fork;
mod model;
mod of_run;
mod options;
mod photos;
mod render;
mod train;
mod watch;
mod words;

use pyo3::prelude::*;

/// 3D Gaussian Splatting with Vulkan compute: models, pictures, training, compression, scores.
///
/// Units: positions and sizes in world units, pictures in [0, 1], angles in degrees, PSNR in dB, seconds. Cameras have x right, y down, z forward;
/// the middle of the first pixel is (0.5, 0.5). Functions raise ValueError for arguments and file contents that are wrong, FileNotFoundError and other
/// OSErrors for files, MemoryError, DeviceError, KeyboardInterrupt after Ctrl-C, and RuntimeError in a process that was forked after first use.
#[pymodule]
fn qirf_vk(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("DeviceError", module.py().get_type::<errors::DeviceError>())?;
    module.add_class::<model::Model>()?;
    module.add_class::<device::Device>()?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<camera::View>()?;
    module.add_class::<render::Renderer>()?;
    module.add_class::<train::Run>()?;
    module.add_function(wrap_pyfunction!(edit::merge, module)?)?;
    module.add_function(wrap_pyfunction!(train::train, module)?)?;
    module.add_function(wrap_pyfunction!(compress::compress, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(camera::orbit, module)?)?;
    module.add_function(wrap_pyfunction!(camera::cameras, module)?)?;
    // Unpickling calls these.
    module.add_function(wrap_pyfunction!(model::unpickled, module)?)?;
    module.add_function(wrap_pyfunction!(camera::unpickled, module)?)?;
    fork::register(module)
}
