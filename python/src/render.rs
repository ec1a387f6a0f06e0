//! Pictures.

use crate::camera::Camera;
use crate::device::{Device, or_usual};
use crate::errors::{colour, raised, some_size, wrong};
use crate::fork::{Kept, detached};
use crate::model::Model;
use engine::gaussians::Gaussians;
use engine::gaussians::resident::Resident;
use engine::gpu;
use engine::job::Error;
use engine::pipeline::budget;
use engine::pipeline::depth::DepthPainter;
use engine::render::{Painter, Settings, Source};
use engine::wording::counted;
use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard};

/// Draws pictures of one model, in parts if the device cannot hold it.
///
/// background: red, green and blue in [0, 1]. antialias, dilation (in square pixels) and depth_order: as in `qirf-vk render`; by default as in
/// the model's run (see Model), else black, and anti-aliased if the model is, with a dilation of 0.1 then and of 0.3 otherwise. Cameras count
/// from the model's origin, as its means do. A renderer keeps the model on the device, so use one renderer for many pictures.
#[pyclass(frozen, weakref, module = "qirf_vk")]
pub struct Renderer {
    model: Arc<Gaussians>,
    settings: Settings,
    there: Kept<OnDevice>,
}

/// What a renderer has on its device.
struct OnDevice {
    device: gpu::Device,
    /// The model; none if it is too large, and drawn in parts.
    resident: Option<Resident>,
    brushes: Mutex<Brushes>,
}

/// Painters with the near plane that they were made for.
#[derive(Default)]
struct Brushes {
    colour: Option<(f32, Painter)>,
    depth: Option<(f32, DepthPainter)>,
}

/// The painter for this near plane.
fn painter<T>(
    slot: &mut Option<(f32, T)>,
    near: f32,
    make: impl FnOnce() -> Result<T, Error>,
) -> Result<&mut T, Error> {
    let painter = match slot.take() {
        Some((of, painter)) if of.to_bits() == near.to_bits() => painter,
        _ => make()?,
    };
    Ok(&mut slot.insert((near, painter)).1)
}

impl Renderer {
    /// The settings for a camera, and the size of its pictures.
    fn settings(&self, camera: &Camera) -> (Settings, [u32; 2]) {
        let near = camera.near.unwrap_or(self.settings.near);
        (Settings { near, ..self.settings }, [camera.inner.width, camera.inner.height])
    }

    fn brushes(&self) -> MutexGuard<'_, Brushes> {
        // A painter that panicked half-way draws the next picture anew.
        self.there.brushes.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn source(&self) -> Source<'_> {
        self.there.resident.as_ref().map_or(Source::Host(&self.model), Source::Device)
    }
}

/// The error of a device without room for any part of a model, whatever the size of the pictures.
fn no_room(error: Error) -> PyErr {
    match error {
        Error::Memory { there, device, .. } => PyMemoryError::new_err(format!(
            "{device} allows {there} bytes, which hold no part of a model: give another device, or a larger memory_limit if \
             you set one"
        )),
        other => raised(other),
    }
}

/// A camera from a Camera, or from K, world_to_camera and size.
fn camera_of(
    [camera, k]: [Option<&Bound<'_, PyAny>>; 2],
    pose: Option<&Bound<'_, PyAny>>,
    size: Option<(u32, u32)>,
    near: Option<f64>,
) -> PyResult<Camera> {
    let whole = camera.and_then(|camera| camera.cast::<Camera>().ok());
    match (whole, camera.xor(k), pose, size) {
        (Some(camera), Some(_), None, None) => {
            let camera = camera.get();
            Camera::checked(camera.inner.clone(), near.or(camera.near.map(f64::from)))
        }
        (None, Some(k), Some(pose), Some(size)) => Camera::of_matrices(k, pose, size, near),
        _ => Err(wrong("give a Camera, or K, world_to_camera and size")),
    }
}

#[pymethods]
impl Renderer {
    /// A renderer of `model` over a background colour.
    #[new]
    #[pyo3(signature = (model, device=None, *, background=None, antialias=None, dilation=None, depth_order=None))]
    fn new(
        py: Python<'_>,
        model: &Bound<'_, Model>,
        device: Option<&Bound<'_, Device>>,
        background: Option<[f32; 3]>,
        antialias: Option<bool>,
        dilation: Option<f32>,
        depth_order: Option<bool>,
    ) -> PyResult<Self> {
        let style = model.get().style_of_run(py, antialias, dilation, depth_order)?;
        let background = background.map_or_else(|| model.get().background(py), colour)?;
        let device = or_usual(py, device)?;
        let model = model.get().inner.clone();
        let resident = detached(py, || {
            let place = budget::for_pictures(&device, &model, [1280, 720], style)?;
            place.whole.then(|| Resident::upload(&device, &model).map_err(Error::from)).transpose()
        });
        let resident = resident?.map_err(no_room)?;
        let there = Kept::new(OnDevice { device, resident, brushes: Mutex::default() });
        Ok(Self { model, settings: style.over(background), there })
    }

    /// A picture (height, width, 4): red, green, blue over the background, and alpha. Pass a Camera, or K (3, 3), the pose
    /// (3, 4) or (4, 4), and width and height. The bytes are those of `qirf-vk render --format npy`.
    #[pyo3(signature = (camera=None, world_to_camera=None, size=None, *, near=None, K=None))]
    #[allow(non_snake_case, reason = "the name in Python")]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&Bound<'py, PyAny>>,
        world_to_camera: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = some_size)] size: Option<(u32, u32)>,
        near: Option<f64>,
        K: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let camera = camera_of([camera, K], world_to_camera, size, near)?;
        let image = detached(py, || -> Result<_, Error> {
            let ((settings, size), source) = (self.settings(&camera), self.source());
            let make = || Ok(Painter::of(&self.there.device, settings, source, size)?);
            Ok(painter(&mut self.brushes().colour, settings.near, make)?.render(source, &camera.inner)?)
        });
        let image = image?.map_err(raised)?;
        let shape = (image.height as usize, image.width as usize, 4);
        let pixels = Array3::from_shape_vec(shape, image.pixels.into_flattened()).map_err(|e| wrong(e.to_string()))?;
        Ok(pixels.into_pyarray(py))
    }

    /// Depths (height, width) along the camera's axis, in world units. kind: "expected", the mean over the Gaussians that a pixel blends,
    /// with the weights of their colours, infinite where there are none; or "median", the depth at which the transmittance falls to a
    /// half, infinite where it does not.
    #[pyo3(signature = (camera=None, world_to_camera=None, size=None, *, kind="expected", near=None, K=None))]
    #[allow(non_snake_case, reason = "the name in Python")]
    fn depth<'py>(
        &self,
        py: Python<'py>,
        camera: Option<&Bound<'py, PyAny>>,
        world_to_camera: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = some_size)] size: Option<(u32, u32)>,
        kind: &str,
        near: Option<f64>,
        K: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let camera = camera_of([camera, K], world_to_camera, size, near)?;
        if !["expected", "median"].contains(&kind) {
            return Err(wrong(format!("kind={kind:?}: give \"expected\" or \"median\"")));
        }
        let drawn = detached(py, || {
            let (settings, size) = self.settings(&camera);
            let OnDevice { device, resident, .. } = &*self.there;
            let make = || DepthPainter::new(device, &self.model, settings, size, resident.is_some());
            painter(&mut self.brushes().depth, settings.near, make)?.draw(&camera.inner)
        });
        let drawn = drawn?.map_err(raised)?;
        let shape = (drawn.height as usize, drawn.width as usize);
        let depths = if kind == "median" { drawn.median } else { drawn.expected };
        Ok(Array2::from_shape_vec(shape, depths).map_err(|e| wrong(e.to_string()))?.into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        let place = if self.there.resident.is_some() { "on" } else { "in parts on" };
        format!("Renderer({}, {place} {})", counted(self.model.len(), "Gaussian"), self.there.device.info().name)
    }
}
