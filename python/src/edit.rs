//! Edits: each makes a new model.

use crate::arrays::{Resolution, four_rows, tuple, unmasked, vector};
use crate::device::{Device, or_usual};
use crate::errors::{file, given, number, raised, some_file, warn, whole, wrong};
use crate::fork::detached;
use crate::model::Model;
use crate::of_run::OfRun;
use crate::photos::Photos;
use crate::watch::{Callbacks, followed, tell_skipped};
use crate::words::in_python;
use engine::edit::{
    Edit, NEEDLE, Region, Similarity, Unwanted, common_origin, floater_warning, rounding, rounding_warning,
};
use engine::gaussians::{Gaussians, MAX_SH_DEGREE};
use engine::glam::DVec3;
use engine::gpu;
use engine::job::{Error, Selection, Session};
use engine::metrics::Networks;
use engine::pipeline::virtual_views::VirtualCameras;
use engine::pipeline::{floaters, place};
use engine::render::Style;
use engine::scene::{OpenOptions, Scene};
use numpy::{PyArrayDescrMethods, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyIndexError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PySlice;
use std::fmt::Display;
use std::path::PathBuf;

impl Model {
    fn edited(&self, py: Python<'_>, edit: Edit) -> PyResult<Self> {
        let edited = detached(py, || {
            let mut model = Gaussians::clone(&self.inner);
            edit.apply(&mut model).map(|_| model)
        })?;
        Ok(self.like(checked(edited)?))
    }

    /// Moves the model, and warns if float32 rounds its positions there.
    fn transformed(&self, py: Python<'_>, map: Result<Similarity, engine::edit::Error>) -> PyResult<Self> {
        let moved = self.edited(py, Edit::Transform(checked(map)?))?;
        if let Some(step) = rounding(&moved.inner).filter(|_| rounding(&self.inner).is_none()) {
            warn(py, &rounding_warning("the model now lies far from its origin", step))?;
        }
        Ok(moved)
    }

    /// Removes floaters by these photos, or by pictures of the model, and warns if there are very many.
    fn without_floaters(&self, py: Python<'_>, photos: Option<&Selection>, device: gpu::Device) -> PyResult<Self> {
        let style = Style::of(self.mode);
        let (model, removed) = followed(py, Callbacks::default(), |watcher| {
            let networks = Networks::default();
            let session = Session { watcher, ..Session::new(&device, &networks) };
            let found = match photos {
                Some(photos) => floaters::by_photos(&session, &self.inner, self.origin, photos, style)?,
                None => floaters::by_own_pictures(&session, &self.inner, &VirtualCameras::default(), style)?,
            };
            let mut model = Gaussians::clone(&self.inner);
            model.compact(&found.iter().map(Option::is_none).collect::<Vec<bool>>());
            Ok((model, found.iter().flatten().count()))
        })?;
        if let Some(warning) = floater_warning(removed, self.inner.len(), photos.is_some()) {
            warn(py, &in_python(&warning))?;
        }
        Ok(self.like(model))
    }

    fn cropped(&self, py: Python<'_>, region: Result<Region, engine::edit::Error>, outside: bool) -> PyResult<Self> {
        self.edited(py, Edit::Crop { region: checked(region)?, outside })
    }
}

fn checked<T>(made: Result<T, engine::edit::Error>) -> PyResult<T> {
    made.map_err(|e| raised(engine::job::Error::from(e)))
}

#[pymethods]
impl Model {
    /// Applies a similarity, (3, 4) or (4, 4), and rotates the spherical harmonics accordingly. Like move_by, turn and scale, warns if float32
    /// rounds positions far from the origin.
    fn transform(&self, py: Python<'_>, matrix: &Bound<'_, PyAny>) -> PyResult<Self> {
        let rows = four_rows(matrix, "matrix")?;
        self.transformed(py, Similarity::of_matrix(rows.as_flattened()))
    }

    /// Translates by (x, y, z) in world units.
    fn move_by(&self, py: Python<'_>, #[pyo3(from_py_with = vector::offset)] offset: [f64; 3]) -> PyResult<Self> {
        let offset = DVec3::from_array(offset);
        if !offset.is_finite() {
            return Err(wrong(format!("offset={offset}: give finite numbers")));
        }
        self.transformed(py, Ok(Similarity::shift(offset)))
    }

    /// Rotates about an axis through the origin (right-handed).
    fn turn(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = vector::axis)] axis: [f64; 3],
        degrees: f64,
    ) -> PyResult<Self> {
        self.transformed(py, Similarity::turn(DVec3::from_array(axis), degrees))
    }

    /// Scales about the origin.
    fn scale(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        self.transformed(py, Similarity::scaling(factor))
    }

    /// Keeps the Gaussians with their centre in an axis-aligned box, or outside of it.
    #[pyo3(signature = (low, high, *, outside=false))]
    fn crop_box(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = vector::low)] low: [f64; 3],
        #[pyo3(from_py_with = vector::high)] high: [f64; 3],
        outside: bool,
    ) -> PyResult<Self> {
        self.cropped(py, Region::cube(low.into(), high.into()), outside)
    }

    /// Keeps the Gaussians with their centre in a sphere, or outside of it.
    #[pyo3(signature = (centre, radius, *, outside=false))]
    fn crop_ball(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = vector::centre)] centre: [f64; 3],
        radius: f64,
        outside: bool,
    ) -> PyResult<Self> {
        self.cropped(py, Region::ball(centre.into(), radius), outside)
    }

    /// Keeps the Gaussians with their centre in the view of at least `least` of a scene's cameras, occluded or not, or the others. images:
    /// the folder of its photos, such as "images_4". Tells of the scene as cameras does.
    #[pyo3(signature = (scene, *, images=None, least=1, outside=false))]
    fn crop_views(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = file)] scene: PathBuf,
        #[pyo3(from_py_with = some_file)] images: Option<PathBuf>,
        #[pyo3(from_py_with = whole)] least: i64,
        outside: bool,
    ) -> PyResult<Self> {
        let least = number("least", least, 1)?;
        let region = detached(py, || {
            let opened = Scene::open(&scene, &OpenOptions { images, ..OpenOptions::default() })?;
            let region = place::seen(&self.inner, self.origin, &opened, least)?;
            Ok::<_, Error>((region, opened.skipped))
        })?;
        let (region, skipped) = region.map_err(raised)?;
        tell_skipped(py, &scene, &skipped)?;
        self.cropped(py, Ok(region), outside)
    }

    /// Drops the bands above this SH degree.
    fn with_degree(&self, py: Python<'_>, #[pyo3(from_py_with = whole)] degree: i64) -> PyResult<Self> {
        let within = usize::try_from(degree).ok().filter(|degree| *degree <= MAX_SH_DEGREE);
        let degree =
            within.ok_or_else(|| wrong(format!("{}: give one from 0 to {MAX_SH_DEGREE}", given("degree", degree))))?;
        self.edited(py, Edit::ShDegree(degree))
    }

    /// Removes Gaussians with a lower opacity, 0 to 1.
    fn min_opacity(&self, py: Python<'_>, opacity: f64) -> PyResult<Self> {
        if !(0.0..=1.0).contains(&opacity) {
            return Err(wrong(format!("opacity={opacity}: give one from 0 to 1")));
        }
        self.edited(py, Edit::MinOpacity(opacity))
    }

    /// Removes Gaussians whose longest axis has a larger standard deviation, in world units.
    fn max_size(&self, py: Python<'_>, size: f64) -> PyResult<Self> {
        if size.is_nan() || size <= 0.0 {
            return Err(wrong(format!("size={size}: give one above 0, in world units")));
        }
        self.edited(py, Edit::MaxSize(size))
    }

    /// Removes "invisible" Gaussians, which no picture can show; or "needles", whose longest axis is `ratio` times the middle one, 100 by
    /// default; or "floaters", Gaussians in empty space, which the photos of `scene`, in its folder images and at a resolution such as 640
    /// (pixels wide) or "/2", show to be wrong, or without a scene pictures of the model (docs/edit.md). A UserWarning tells of very many
    /// floaters.
    #[pyo3(signature = (kind, *, ratio=None, scene=None, images=None, resolution=None, device=None))]
    fn remove(
        &self,
        py: Python<'_>,
        kind: &str,
        ratio: Option<f64>,
        #[pyo3(from_py_with = some_file)] scene: Option<PathBuf>,
        #[pyo3(from_py_with = some_file)] images: Option<PathBuf>,
        resolution: Option<Resolution>,
        device: Option<&Bound<'_, Device>>,
    ) -> PyResult<Self> {
        if kind != "floaters" && scene.is_some() {
            return Err(wrong(format!("scene is for kind=\"floaters\", not for {kind:?}: leave it out")));
        }
        if kind != "needles" && ratio.is_some() {
            return Err(wrong(format!("ratio is for kind=\"needles\", not for {kind:?}: leave it out")));
        }
        let ratio = ratio.unwrap_or(NEEDLE);
        let photos = Photos { scene, images, resolution, ..Photos::default() }.selection()?;
        let unwanted = match kind {
            "invisible" => Unwanted::Invisible,
            "needles" if ratio >= 1.0 => Unwanted::Needles(ratio),
            "needles" => return Err(wrong(format!("ratio={ratio}: give one of 1 or more"))),
            "floaters" => return self.without_floaters(py, photos.as_ref(), or_usual(py, device)?),
            other => {
                let kinds = "\"invisible\", \"needles\" and \"floaters\"";
                return Err(wrong(format!("{other:?} is not a kind to remove: there are {kinds}")));
            }
        };
        self.edited(py, Edit::Remove(unwanted))
    }

    /// Orders Gaussians along a Z-order curve, so that neighbours in space are neighbours in the file.
    fn morton_order(&self, py: Python<'_>) -> PyResult<Self> {
        self.edited(py, Edit::MortonOrder)
    }

    /// The Gaussians selected by a mask (n,) of bools, by indices (k,), in their order, or by a slice. Negative indices count from the end.
    fn select(&self, py: Python<'_>, chosen: &Bound<'_, PyAny>) -> PyResult<Self> {
        let n = self.inner.len();
        unmasked(chosen, "chosen")?;
        let numpy = py.import("numpy")?;
        let array = match chosen.cast::<PySlice>() {
            Ok(slice) => numpy.call_method1("arange", (n,))?.get_item(slice)?,
            Err(_) => numpy.call_method1("asarray", (chosen,))?,
        };
        let beyond = |index: &dyn Display| PyIndexError::new_err(format!("there is no Gaussian {index} among {n}"));
        let untyped = array.cast::<PyUntypedArray>()?;
        let (shape, kind) = (untyped.shape(), untyped.dtype().kind());
        let indices: Vec<i64> = match kind {
            b'b' if shape != [n] => {
                return Err(wrong(format!("a mask has the shape {}, and should have ({n},)", tuple(shape))));
            }
            b'b' => numpy.call_method1("flatnonzero", (&array,))?.call_method0("tolist")?.extract()?,
            b'O' | b'S' | b'U' if shape.is_empty() => {
                let what = "give a mask or indices as a list or an array, or a slice";
                return Err(PyTypeError::new_err(format!("chosen is of type {}: {what}", chosen.get_type().name()?)));
            }
            _ if shape.len() != 1 => {
                return Err(wrong(format!("indices have the shape {}, and should have (k,)", tuple(shape))));
            }
            b'i' | b'u' => match array.call_method0("tolist")?.extract::<Vec<i64>>() {
                Ok(indices) => indices,
                // Unsigned numbers beyond those of i64.
                Err(_) => return Err(beyond(&array.call_method0("max")?)),
            },
            _ if shape == [0] => Vec::new(),
            _ => return Err(PyTypeError::new_err("indices should be whole numbers, and a mask should be of bools")),
        };
        let within = |i: &i64| {
            let from_start = if *i < 0 { i.checked_add_unsigned(n as u64)? } else { *i };
            usize::try_from(from_start).ok().filter(|i| *i < n)
        };
        if let Some(index) = indices.iter().find(|i| within(i).is_none()) {
            return Err(beyond(index));
        }
        let indices: Vec<usize> = indices.iter().filter_map(within).collect();
        Ok(self.like(detached(py, || self.inner.select(&indices))?))
    }
}

/// Concatenates models; SH bands that one lacks are zero. The result has the origin of the first model, unless another one's is
/// much nearer to all. It remembers a run (see Model) if all remember the same.
#[pyfunction]
pub fn merge(py: Python<'_>, models: Vec<Bound<'_, Model>>) -> PyResult<Model> {
    let models: Vec<&Model> = models.iter().map(Bound::get).collect();
    let Some(first) = models.first() else { return Err(wrong("there is no model to merge")) };
    if models.iter().any(|other| other.mode != first.mode) {
        return Err(wrong("anti-aliased models and others cannot be one: they are drawn differently"));
    }
    let (merged, origin, rounded) = detached(py, || {
        let own: Vec<_> = models.iter().map(|model| (&*model.inner, model.origin)).collect();
        let (mut all, origin) = (Gaussians::default(), common_origin(&own));
        let mut rounded = None::<f64>;
        for model in &models {
            let moved = model.counted_from(origin);
            let step = rounding(&moved).filter(|_| DVec3::from(model.origin) != DVec3::from(origin));
            rounded = rounded.into_iter().chain(step).reduce(f64::max);
            all.append(&moved);
        }
        (all, origin, rounded)
    })?;
    if let Some(step) = rounded {
        warn(py, &rounding_warning("a model lies far from the origin of the merged model", step))?;
    }
    let unplaced = models.iter().filter(|model| model.origin.iter().all(|x| *x == 0.0));
    let format = place::most_doubtful(unplaced.filter_map(|model| model.format));
    let common = models.iter().all(|other| other.run == first.run);
    let run = if common { first.run } else { OfRun::default() };
    Ok(Model { origin, format, run, ..first.like(merged) })
}
