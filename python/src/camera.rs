//! Cameras.

use crate::arrays::{Resolution, four_rows, matrix, vector};
use crate::errors::{file, number, raised, size, some_file, some_whole, views, whole, wrong};
use crate::fork::detached;
use crate::model::Model;
use crate::watch::tell_skipped;
use engine::gaussians::outline::outline;
use engine::glam::{DMat3, DVec2, DVec3};
use engine::job::{Error, Selection};
use engine::pipeline::prepare;
use engine::render::Settings;
use engine::scene::{
    camera, near_at,
    orbit::{Look, UP},
};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::path::PathBuf;

/// A pinhole camera with the axes of COLMAP and OpenCV: x right, y down, z forward; the centre of the first pixel is (0.5, 0.5).
///
/// K: (3, 3) in pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. world_to_camera: (3, 4) or (4, 4). size: width and height in pixels.
/// near: near plane, in world units along the camera's axis; closer Gaussians are not drawn. 0.2 by default, which small models need less of:
/// the cameras of `orbit` and `cameras` have one that fits. For a model with an origin, world_to_camera counts from it, as the means do: of a
/// pose P in the world it is P with P[:3, 3] + P[:3, :3] @ origin. Cameras can be pickled; a camera equals only itself.
#[pyclass(frozen, weakref, module = "qirf_vk")]
#[derive(Clone)]
pub struct Camera {
    pub(crate) inner: camera::Camera,
    /// Gaussians nearer than this are left out; the usual distance if absent.
    pub(crate) near: Option<f32>,
}

#[pymethods]
impl Camera {
    /// From K (3, 3) in pixels, world_to_camera (3, 4) or (4, 4), and the size (width, height).
    #[new]
    #[pyo3(signature = (K, world_to_camera, size, *, near=None))]
    #[allow(non_snake_case, reason = "the name in Python")]
    fn new(
        K: &Bound<'_, PyAny>,
        world_to_camera: &Bound<'_, PyAny>,
        #[pyo3(from_py_with = size)] size: (u32, u32),
        near: Option<f64>,
    ) -> PyResult<Self> {
        Self::of_matrices(K, world_to_camera, size, near)
    }

    /// A camera at `eye` that looks at `target`; fov is vertical, in degrees.
    #[staticmethod]
    #[pyo3(signature = (eye, target=[0.0; 3], *, up=UP.to_array(), fov=40.0, size=(1280, 720), near=None),
        text_signature = "(eye, target=(0.0, 0.0, 0.0), *, up=(0.0, -1.0, 0.0), fov=40.0, size=(1280, 720), near=None)")]
    fn look_at(
        #[pyo3(from_py_with = vector::eye)] eye: [f64; 3],
        #[pyo3(from_py_with = vector::target)] target: [f64; 3],
        #[pyo3(from_py_with = vector::up)] up: [f64; 3],
        fov: f64,
        #[pyo3(from_py_with = size)] size: (u32, u32),
        near: Option<f64>,
    ) -> PyResult<Self> {
        if !(fov > 0.0 && fov < 180.0) {
            return Err(wrong(format!("a field of view of {fov} degrees: give one above 0 and below 180")));
        }
        let [eye, target, up] = [eye, target, up].map(DVec3::from_array);
        for (name, place) in [("eye", eye), ("target", target), ("up", up)] {
            if !place.is_finite() {
                return Err(wrong(format!("{name}={place}: give finite numbers")));
            }
        }
        if eye == target {
            return Err(wrong(format!("eye and target are both {eye}: a camera looks from eye to another point")));
        }
        if up == DVec3::ZERO {
            return Err(wrong("up has length 0: give a direction"));
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

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let make = py.import("qirf_vk")?.getattr("_camera")?;
        Ok((make, (self.k(py), self.world_to_camera(py), self.size(), self.near).into_pyobject(py)?))
    }

    fn __copy__<'py>(this: &Bound<'py, Self>) -> Bound<'py, Self> {
        this.clone()
    }

    fn __deepcopy__<'py>(this: &Bound<'py, Self>, _memo: &Bound<'py, PyDict>) -> Bound<'py, Self> {
        this.clone()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let builtins = py.import("builtins")?;
        // The sum has no negative zero.
        let short = |x: f64| builtins.call_method1("format", (x + 0.0, ".6g"))?.extract::<String>();
        let [x, y, z] = self.inner.centre().to_array();
        let place = [short(x)?, short(y)?, short(z)?].join(", ");
        Ok(format!("Camera({} x {}, at [{place}])", self.inner.width, self.inner.height))
    }
}

impl Camera {
    /// A camera from K (3, 3) and a pose (3, 4) or (4, 4).
    pub(crate) fn of_matrices(
        k: &Bound<'_, PyAny>,
        world_to_camera: &Bound<'_, PyAny>,
        size: (u32, u32),
        near: Option<f64>,
    ) -> PyResult<Self> {
        let k: [[f64; 3]; 3] = matrix(k, "K")?;
        let [pose @ .., last] = four_rows(world_to_camera, "world_to_camera")?;
        let rows = pose.map(|row| DVec3::new(row[0], row[1], row[2]));
        let rotation = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
        let off = rotation * rotation.transpose() - DMat3::IDENTITY;
        if !(off.to_cols_array().iter().all(|x| x.abs() < 1e-4) && rotation.determinant() > 0.0) {
            return Err(wrong("world_to_camera does not begin with a rotation"));
        }
        if !matches!(last, [0.0, 0.0, 0.0, 1.0]) {
            return Err(wrong("the last row of world_to_camera should be 0, 0, 0, 1"));
        }
        check_intrinsics(&k)?;
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

    pub(crate) fn checked(inner: camera::Camera, near: Option<f64>) -> PyResult<Self> {
        if !(inner.translation.is_finite() && inner.rotation.is_finite() && inner.principal.is_finite()) {
            return Err(wrong("a camera's place and direction should be finite numbers"));
        }
        let narrow = |near: f64| match near as f32 {
            narrow if narrow > 0.0 && narrow.is_finite() => Ok(narrow),
            _ => Err(wrong(format!("near={near:?}: give a distance above 0 that float32 holds"))),
        };
        Ok(Self { inner, near: near.map(narrow).transpose()? })
    }
}

/// Refuses a matrix that is no pinhole camera's, by its first wrong entry.
fn check_intrinsics(k: &[[f64; 3]; 3]) -> PyResult<()> {
    for (at, x) in k.as_flattened().iter().enumerate() {
        let right = match at {
            0 | 4 => *x > 0.0 && x.is_finite(),
            2 | 5 => x.is_finite(),
            8 => x - 1.0 == 0.0,
            _ => *x == 0.0,
        };
        if !right {
            let form = "K should be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0";
            return Err(wrong(format!("{form}, but K[{}, {}] is {x:?}", at / 3, at % 3)));
        }
    }
    Ok(())
}

/// The camera that was pickled.
#[pyfunction(name = "_camera")]
pub fn unpickled(
    k: &Bound<'_, PyAny>,
    world_to_camera: &Bound<'_, PyAny>,
    size: (u32, u32),
    near: Option<f64>,
) -> PyResult<Camera> {
    Camera::of_matrices(k, world_to_camera, size, near)
}

/// Cameras on a circle around a model, those of `qirf-vk render --orbit`; fov is vertical, elevation above the horizon, in degrees.
#[pyfunction]
#[pyo3(signature = (model, count, *, size=(1280, 720), fov=40.0, elevation=15.0, up=UP.to_array()),
    text_signature = "(model, count, *, size=(1280, 720), fov=40.0, elevation=15.0, up=(0.0, -1.0, 0.0))")]
pub fn orbit(
    py: Python<'_>,
    model: &Bound<'_, Model>,
    #[pyo3(from_py_with = whole)] count: i64,
    #[pyo3(from_py_with = size)] size: (u32, u32),
    fov: f64,
    elevation: f64,
    #[pyo3(from_py_with = vector::up)] up: [f64; 3],
) -> PyResult<Vec<Camera>> {
    let Some(up) = DVec3::from_array(up).try_normalize() else { return Err(wrong("up should be a direction")) };
    if !(fov > 0.0 && fov < 180.0 && elevation.abs() < 90.0) {
        return Err(wrong("give a field of view above 0 and below 180 degrees, and an elevation between -90 and 90"));
    }
    let count = views("count", count, 1)?;
    let look = Look { fov: fov.to_radians(), elevation: elevation.to_radians(), size };
    let model = model.get().inner.clone();
    let (near, cameras) = detached(py, || {
        let outline = outline(&model, up);
        (near_at(Settings::default().near, outline.framing(&look).distance), outline.cameras(count, &look))
    })?;
    cameras.into_iter().map(|camera| Camera::checked(camera, Some(f64::from(near)))).collect()
}

/// A view of a scene, made by cameras.
#[pyclass(frozen, weakref, module = "qirf_vk")]
pub struct View {
    /// The photo's name; that of a face of a panorama has the face before the extension.
    #[pyo3(get)]
    name: String,
    /// The camera of the picture that is compared with the photo.
    #[pyo3(get)]
    camera: Py<Camera>,
    /// True if the photo is held out.
    #[pyo3(get)]
    held_out: bool,
}

#[pymethods]
impl View {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let role = if self.held_out { "held out" } else { "trained on" };
        Ok(format!("View({:?}, {}, {role})", self.name, self.camera.bind(py).repr()?))
    }
}

/// The views of a scene that train and evaluate use, in the order of their names: Renderer(model).render(view.camera) is the picture that is
/// compared with the photo, before exposures, on the background of the scores.
///
/// resolution, images and eval_every: as in evaluate; eval_every=0 holds out none. Photos that do not exist or have another shape than their
/// camera are left out; photos are not decoded, so damaged ones, which train leaves out before the split, are among the views. UserWarnings
/// tell of what is left out, ignored or doubtful; the log, at INFO, of choices by which nothing is lost, such as the folder of the photos.
///
/// Cameras are ideal pinholes: distorted photos are resampled to them, panoramas and wide fisheyes are cut into faces with a view each. They
/// count from the scene's local origin, where it has one, as the model of a run on it does (Model.origin), and have the scene's near plane.
#[pyfunction]
#[pyo3(signature = (scene, *, resolution=None, images=None, eval_every=None))]
pub fn cameras(
    py: Python<'_>,
    #[pyo3(from_py_with = file)] scene: PathBuf,
    resolution: Option<Resolution>,
    #[pyo3(from_py_with = some_file)] images: Option<PathBuf>,
    #[pyo3(from_py_with = some_whole)] eval_every: Option<i64>,
) -> PyResult<Vec<View>> {
    let eval_every = eval_every.map(|every| number("eval_every", every, 0)).transpose()?;
    let usual = Selection::of(scene.clone());
    let (resolution, eval_every) = (resolution.map(|r| r.0), eval_every.unwrap_or(usual.eval_every));
    let selection = Selection { images, resolution, eval_every, ..usual };
    let found = detached(py, || {
        let opened = prepare::open(&selection)?;
        let cameras = opened.cameras();
        Ok::<_, Error>((opened.scene, cameras))
    })?;
    let (opened, cameras) = found.map_err(raised)?;
    tell_skipped(py, &scene, &opened.skipped)?;
    let split = opened.split(selection.eval_every);
    let mut views = Vec::new();
    for (at, (view, camera)) in opened.views.into_iter().zip(cameras).enumerate() {
        let held_out = split.test.binary_search(&at).is_ok();
        if held_out || split.train.binary_search(&at).is_ok() {
            let camera = Py::new(py, Camera::checked(camera, Some(opened.near.into()))?)?;
            views.push(View { name: view.name, camera, held_out });
        }
    }
    Ok(views)
}
