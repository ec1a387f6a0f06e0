//! Cameras and pictures.

use crate::arrays::matrix;
use crate::device::{Device, or_usual};
use crate::errors::{colour, raised, size, some_size, views, whole, wrong};
use crate::model::Model;
use engine::gaussians::Gaussians;
use engine::gaussians::outline::outline;
use engine::gaussians::resident::Resident;
use engine::glam::{DMat3, DVec2, DVec3};
use engine::gpu;
use engine::job::Error;
use engine::pipeline::budget;
use engine::pipeline::depth::DepthPainter;
use engine::pipeline::render::near_at;
use engine::render::{Painter, Settings, Source};
use engine::scene::{
    camera,
    orbit::{Look, UP},
};
use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray2, PyArray3};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard};

/// A pinhole camera with the axes of COLMAP and OpenCV: x right, y down, z forward; the centre of the first pixel is (0.5, 0.5).
///
/// k: (3, 3) in pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. world_to_camera: (3, 4) or (4, 4). size: width and height in pixels.
/// near: near plane, in world units along the camera's axis; closer Gaussians are not drawn. 0.2 by default, which small models need less of:
/// the cameras of `orbit` have one that fits.
#[pyclass(frozen, module = "qirf_vk")]
#[derive(Clone)]
pub struct Camera {
    inner: camera::Camera,
    /// Gaussians nearer than this are left out; the usual distance if absent.
    near: Option<f32>,
}

#[pymethods]
impl Camera {
    /// From K (3, 3) in pixels, world_to_camera (3, 4) or (4, 4), and the size (width, height).
    #[new]
    #[pyo3(signature = (k, world_to_camera, size, *, near=None))]
    fn new(
        k: &Bound<'_, PyAny>,
        world_to_camera: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = size)] size: (u32, u32),
        near: Option<f32>,
    ) -> PyResult<Self> {
        let k: [[f64; 3]; 3] = matrix(k, "K")?;
        let (pose, last): ([[f64; 4]; 3], _) = match matrix::<4, 4>(world_to_camera, "world_to_camera") {
            Ok([a, b, c, last]) => ([a, b, c], last),
            Err(_) => (matrix(world_to_camera, "world_to_camera")?, [0.0, 0.0, 0.0, 1.0]),
        };
        let rows = pose.map(|row| DVec3::new(row[0], row[1], row[2]));
        let rotation = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
        let off = rotation * rotation.transpose() - DMat3::IDENTITY;
        if !(off.to_cols_array().iter().all(|x| x.abs() < 1e-4) && rotation.determinant() > 0.0) {
            return Err(wrong("world_to_camera does not begin with a rotation"));
        }
        if !matches!(last, [0.0, 0.0, 0.0, 1.0]) {
            return Err(wrong("the last row of world_to_camera should be 0, 0, 0, 1"));
        }
        let [[fx, skew, _], [below, fy, _], [left, under, one]] = k;
        let usual = [skew, below, left, under, one - 1.0].iter().all(|x| *x == 0.0);
        if !(usual && fx > 0.0 && fy > 0.0 && k.as_flattened().iter().all(|x| x.is_finite())) {
            return Err(wrong("K should be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0"));
        }
        Self::checked(
            camera::Camera {
                rotation,
                translation: DVec3::from_array(pose.map(|row| row[3])),
                focal: DVec2::new(k[0][0], k[1][1]),
                principal: DVec2::new(k[0][2], k[1][2]),
                width: size.0,
                height: size.1,
                whole: None,
            },
            near,
        )
    }

    /// A camera at `eye` that looks at `target`; fov is vertical, in degrees.
    #[staticmethod]
    #[pyo3(signature = (eye, target=[0.0; 3], *, up=UP.to_array(), fov=40.0, size=(1280, 720), near=None))]
    fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov: f64,
        #[pyo3(from_py_with = size)] size: (u32, u32),
        near: Option<f32>,
    ) -> PyResult<Self> {
        if !(fov > 0.0 && fov < 180.0) {
            return Err(wrong(format!("a field of view of {fov} degrees: give one above 0 and below 180")));
        }
        let [eye, target, up] = [eye, target, up].map(DVec3::from_array);
        if eye == target || up == DVec3::ZERO || ![eye, target, up].iter().all(|v| v.is_finite()) {
            return Err(wrong("a camera looks from eye to another point, target, and up is a direction"));
        }
        Self::checked(camera::Camera::look_at(eye, target, up, fov.to_radians(), size.0, size.1), near)
    }

    /// The near plane, in world units along the camera's axis; None for the usual distance, 0.2.
    #[getter]
    fn near(&self) -> Option<f32> {
        self.near
    }

    /// The camera's place in the world, (x, y, z).
    #[getter]
    fn centre(&self) -> (f64, f64, f64) {
        self.inner.centre().into()
    }

    /// Width and height in pixels.
    #[getter]
    fn size(&self) -> (u32, u32) {
        (self.inner.width, self.inner.height)
    }

    /// The intrinsic matrix in pixels, (3, 3).
    #[getter(K)]
    fn k<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let camera::Camera { focal, principal, .. } = &self.inner;
        let rows = [[focal.x, 0.0, principal.x], [0.0, focal.y, principal.y], [0.0, 0.0, 1.0]];
        Array2::from(rows.to_vec()).into_pyarray(py)
    }

    /// The pose, (4, 4).
    #[getter]
    fn world_to_camera<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let (r, t) = (self.inner.rotation.transpose(), self.inner.translation);
        let mut pose = Array2::eye(4);
        for i in 0..3 {
            for j in 0..3 {
                pose[(i, j)] = r.col(i)[j];
            }
            pose[(i, 3)] = t[i];
        }
        pose.into_pyarray(py)
    }

    fn __repr__(&self) -> String {
        format!("Camera({} x {}, at {})", self.inner.width, self.inner.height, self.inner.centre())
    }
}

impl Camera {
    fn checked(inner: camera::Camera, near: Option<f32>) -> PyResult<Self> {
        if !(inner.translation.is_finite() && inner.rotation.is_finite() && inner.principal.is_finite()) {
            return Err(wrong("a camera's place and direction should be finite numbers"));
        }
        if let Some(near) = near.filter(|near| !(near.is_finite() && *near > 0.0)) {
            return Err(wrong(format!("near={near}: give a finite distance above 0")));
        }
        Ok(Self { inner, near })
    }
}

/// Cameras on a circle around a model, those of `qirf-vk render --orbit`; fov is vertical, elevation above the horizon, in degrees.
#[pyfunction]
#[pyo3(signature = (model, count, *, size=(1280, 720), fov=40.0, elevation=15.0, up=UP.to_array()))]
pub fn orbit(
    py: Python<'_>,
    model: &Bound<'_, Model>,
    #[pyo3(from_py_with = whole)] count: i64,
    #[pyo3(from_py_with = size)] size: (u32, u32),
    fov: f64,
    elevation: f64,
    up: [f64; 3],
) -> PyResult<Vec<Camera>> {
    let Some(up) = DVec3::from_array(up).try_normalize() else { return Err(wrong("up should be a direction")) };
    if !(fov > 0.0 && fov < 180.0 && elevation.abs() < 90.0) {
        return Err(wrong("give a field of view above 0 and below 180 degrees, and an elevation between -90 and 90"));
    }
    let count = views("count", count, 1)?;
    let look = Look { fov: fov.to_radians(), elevation: elevation.to_radians(), size };
    let model = model.get().inner.clone();
    let (near, cameras) = py.detach(|| {
        let outline = outline(&model, up);
        (near_at(Settings::default().near, outline.framing(&look).distance), outline.cameras(count, &look))
    });
    cameras.into_iter().map(|camera| Camera::checked(camera, Some(near))).collect()
}

/// Draws pictures of one model, in parts if the device cannot hold it.
///
/// background: red, green and blue in [0, 1]. antialias, dilation (in square pixels) and depth_order: as in `qirf-vk render`; by default
/// anti-aliased if the model is, with a dilation of 0.1 then and of 0.3 otherwise. A renderer keeps the model on the device, so use one
/// renderer for many pictures.
#[pyclass(frozen, module = "qirf_vk")]
pub struct Renderer {
    device: gpu::Device,
    model: Arc<Gaussians>,
    /// The model on the device; none if it is too large, and drawn in parts.
    resident: Option<Resident>,
    settings: Settings,
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
        self.brushes.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn source(&self) -> Source<'_> {
        self.resident.as_ref().map_or(Source::Host(&self.model), Source::Device)
    }
}

/// A camera from a Camera, or from K, world_to_camera and size.
fn camera_of(
    camera: &Bound<'_, PyAny>,
    pose: Option<&Bound<'_, PyAny>>,
    size: Option<(u32, u32)>,
    near: Option<f32>,
) -> PyResult<Camera> {
    match (camera.cast::<Camera>(), pose, size) {
        (Ok(camera), None, None) => Camera::checked(camera.get().inner.clone(), near.or(camera.get().near)),
        (Err(_), Some(pose), Some(size)) => Camera::new(camera, pose, size, near),
        _ => Err(wrong("give a Camera, or K, world_to_camera and size")),
    }
}

#[pymethods]
impl Renderer {
    /// A renderer of `model` over a background colour.
    #[new]
    #[pyo3(signature = (model, device=None, *, background=[0.0; 3], antialias=None, dilation=None, depth_order=false))]
    fn new(
        py: Python<'_>,
        model: &Bound<'_, Model>,
        device: Option<&Bound<'_, Device>>,
        background: [f32; 3],
        antialias: Option<bool>,
        dilation: Option<f32>,
        depth_order: bool,
    ) -> PyResult<Self> {
        let style = model.get().style(antialias, dilation, depth_order)?;
        let device = or_usual(py, device)?;
        let model = model.get().inner.clone();
        let resident = py.detach(|| {
            let place = budget::for_pictures(&device, &model, [1280, 720], style)?;
            place.whole.then(|| Resident::upload(&device, &model).map_err(Error::from)).transpose()
        });
        let resident = resident.map_err(raised)?;
        Ok(Self { device, model, resident, settings: style.over(colour(background)?), brushes: Mutex::default() })
    }

    /// A picture (height, width, 4): red, green, blue over the background, and alpha. Pass a Camera, or K (3, 3), the pose
    /// (3, 4) or (4, 4), and width and height. The bytes are those of `qirf-vk render --format npy`.
    #[pyo3(signature = (camera, world_to_camera=None, size=None, *, near=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: &Bound<'py, PyAny>,
        world_to_camera: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = some_size)] size: Option<(u32, u32)>,
        near: Option<f32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let camera = camera_of(camera, world_to_camera, size, near)?;
        let image = py.detach(|| -> Result<_, Error> {
            let ((settings, size), source) = (self.settings(&camera), self.source());
            let make = || Ok(Painter::of(&self.device, settings, source, size)?);
            Ok(painter(&mut self.brushes().colour, settings.near, make)?.render(source, &camera.inner)?)
        });
        let image = image.map_err(raised)?;
        let shape = (image.height as usize, image.width as usize, 4);
        let pixels = Array3::from_shape_vec(shape, image.pixels.into_flattened()).map_err(|e| wrong(e.to_string()))?;
        Ok(pixels.into_pyarray(py))
    }

    /// Depths (height, width) along the camera's axis, in world units. kind: "expected", the mean over the Gaussians that a pixel blends,
    /// with the weights of their colours, infinite where there are none; or "median", the depth at which the transmittance falls to a
    /// half, infinite where it does not.
    #[pyo3(signature = (camera, world_to_camera=None, size=None, *, kind="expected", near=None))]
    fn depth<'py>(
        &self,
        py: Python<'py>,
        camera: &Bound<'py, PyAny>,
        world_to_camera: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = some_size)] size: Option<(u32, u32)>,
        kind: &str,
        near: Option<f32>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let camera = camera_of(camera, world_to_camera, size, near)?;
        if !["expected", "median"].contains(&kind) {
            return Err(wrong(format!("kind={kind:?}: give \"expected\" or \"median\"")));
        }
        let drawn = py.detach(|| {
            let (settings, size) = self.settings(&camera);
            let make = || DepthPainter::new(&self.device, &self.model, (settings, size, self.resident.is_some()));
            painter(&mut self.brushes().depth, settings.near, make)?.draw(&camera.inner)
        });
        let drawn = drawn.map_err(raised)?;
        let shape = (drawn.height as usize, drawn.width as usize);
        let depths = if kind == "median" { drawn.median } else { drawn.expected };
        Ok(Array2::from_shape_vec(shape, depths).map_err(|e| wrong(e.to_string()))?.into_pyarray(py))
    }
}
