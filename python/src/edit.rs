//! Edits: each makes a new model.

use crate::arrays::Resolution;
use crate::device::{Device, or_usual};
use crate::errors::{number, raised, warn, whole, wrong};
use crate::model::Model;
use crate::watch::Follower;
use engine::edit::{Edit, NEEDLE, Region, Similarity, Unwanted, common_origin, rounding};
use engine::gaussians::{Gaussians, MAX_SH_DEGREE};
use engine::glam::DVec3;
use engine::gpu;
use engine::job::{Error, Preset, RunConfig, Session};
use engine::metrics::Networks;
use engine::pipeline::virtual_views::VirtualCameras;
use engine::pipeline::{floaters, place};
use engine::render::Style;
use engine::scene::{OpenOptions, Scene};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use std::path::PathBuf;

impl Model {
    fn edited(&self, py: Python<'_>, edit: Edit) -> PyResult<Self> {
        let edited = py.detach(|| {
            let mut model = Gaussians::clone(&self.inner);
            edit.apply(&mut model).map(|_| model)
        });
        Ok(self.like(checked(edited)?))
    }

    fn transformed(&self, py: Python<'_>, map: Result<Similarity, engine::edit::Error>) -> PyResult<Self> {
        self.edited(py, Edit::Transform(checked(map)?))
    }

    fn without_floaters(
        &self,
        py: Python<'_>,
        scene: Option<PathBuf>,
        resolution: Option<Resolution>,
        device: gpu::Device,
    ) -> PyResult<Self> {
        let (style, resolution, follower) = (Style::of(self.mode), resolution.map(|r| r.0), Follower::new(None, None));
        let cleaned = py.detach(|| -> Result<_, Error> {
            let networks = Networks::default();
            let session = Session { watcher: &follower, ..Session::new(&device, &networks) };
            let found = match scene {
                Some(scene) => {
                    let photos = RunConfig { resolution, ..RunConfig::of(scene, Preset::default()) }.selection();
                    floaters::by_photos(&session, (&self.inner, self.origin), &photos, style)?
                }
                None => floaters::by_own_pictures(&session, &self.inner, &VirtualCameras::default(), style)?,
            };
            let mut model = Gaussians::clone(&self.inner);
            model.compact(&found.iter().map(Option::is_none).collect::<Vec<bool>>());
            Ok(model)
        });
        Ok(self.like(follower.result(cleaned)?))
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
    /// Applies a similarity, (3, 4) or (4, 4), and rotates the spherical harmonics accordingly.
    fn transform(&self, py: Python<'_>, matrix: &Bound<'_, PyAny>) -> PyResult<Self> {
        let flat = py.import("numpy")?.call_method1("ravel", (matrix,))?.call_method0("tolist")?;
        let numbers: Vec<f64> = flat.extract()?;
        self.transformed(py, Similarity::of_matrix(&numbers))
    }

    /// Translates by (x, y, z) in world units.
    fn move_by(&self, py: Python<'_>, offset: [f64; 3]) -> PyResult<Self> {
        let offset = DVec3::from_array(offset);
        if !offset.is_finite() {
            return Err(wrong(format!("offset={offset}: give finite numbers")));
        }
        self.transformed(py, Ok(Similarity::shift(offset)))
    }

    /// Rotates about an axis through the origin (right-handed).
    fn turn(&self, py: Python<'_>, axis: [f64; 3], degrees: f64) -> PyResult<Self> {
        self.transformed(py, Similarity::turn(DVec3::from_array(axis), degrees))
    }

    /// Scales about the origin.
    fn scale(&self, py: Python<'_>, factor: f64) -> PyResult<Self> {
        self.transformed(py, Similarity::scaling(factor))
    }

    /// Keeps the Gaussians with their centre in an axis-aligned box, or outside of it.
    #[pyo3(signature = (low, high, *, outside=false))]
    fn crop_box(&self, py: Python<'_>, low: [f64; 3], high: [f64; 3], outside: bool) -> PyResult<Self> {
        self.cropped(py, Region::cube(low.into(), high.into()), outside)
    }

    /// Keeps the Gaussians with their centre in a sphere, or outside of it.
    #[pyo3(signature = (centre, radius, *, outside=false))]
    fn crop_ball(&self, py: Python<'_>, centre: [f64; 3], radius: f64, outside: bool) -> PyResult<Self> {
        self.cropped(py, Region::ball(centre.into(), radius), outside)
    }

    /// Keeps the Gaussians with their centre in the view of at least `least` of a scene's cameras, occluded or not, or the others.
    #[pyo3(signature = (scene, *, least=1, outside=false))]
    fn crop_views(
        &self,
        py: Python<'_>,
        scene: PathBuf,
        #[pyo3(from_py_with = whole)] least: i64,
        outside: bool,
    ) -> PyResult<Self> {
        let least = number("least", least, 1)?;
        let region = py.detach(|| {
            let scene = Scene::open(&scene, &OpenOptions::default())?;
            place::seen((&self.inner, self.origin), &scene, least)
        });
        self.cropped(py, Ok(region.map_err(raised)?), outside)
    }

    /// Drops the bands above this SH degree.
    fn with_degree(&self, py: Python<'_>, #[pyo3(from_py_with = whole)] degree: i64) -> PyResult<Self> {
        let within = usize::try_from(degree).ok().filter(|degree| *degree <= MAX_SH_DEGREE);
        let degree = within.ok_or_else(|| wrong(format!("degree={degree}: give one from 0 to {MAX_SH_DEGREE}")))?;
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

    /// Removes "invisible" Gaussians, which no picture can show; or "needles", whose longest axis is `ratio` times the middle one; or
    /// "floaters", Gaussians in empty space, which the photos of `scene`, at a resolution such as 640 (pixels wide) or "/2", show to be wrong,
    /// or without a scene pictures of the model (docs/edit.md).
    #[pyo3(signature = (kind, *, ratio=NEEDLE, scene=None, resolution=None, device=None))]
    fn remove(
        &self,
        py: Python<'_>,
        kind: &str,
        ratio: f64,
        scene: Option<PathBuf>,
        resolution: Option<Resolution>,
        device: Option<&Bound<'_, Device>>,
    ) -> PyResult<Self> {
        if kind != "floaters" && scene.is_some() || scene.is_none() && resolution.is_some() {
            return Err(wrong("a scene shows \"floaters\", and resolution is that of its photos"));
        }
        let unwanted = match kind {
            "invisible" => Unwanted::Invisible,
            "needles" if ratio >= 1.0 => Unwanted::Needles(ratio),
            "needles" => return Err(wrong(format!("ratio={ratio}: give one of 1 or more"))),
            "floaters" => return self.without_floaters(py, scene, resolution, or_usual(py, device)?),
            other => {
                let kinds = "\"invisible\", \"needles\" and \"floaters\"";
                return Err(wrong(format!("{other:?} is no kind to remove: there are {kinds}")));
            }
        };
        self.edited(py, Edit::Remove(unwanted))
    }

    /// Orders Gaussians along a Z-order curve, so that neighbours in space are neighbours in the file.
    fn morton_order(&self, py: Python<'_>) -> PyResult<Self> {
        self.edited(py, Edit::MortonOrder)
    }

    /// The Gaussians selected by a mask (n,) of bools, or by indices, in their order.
    fn select(&self, py: Python<'_>, chosen: &Bound<'_, PyAny>) -> PyResult<Self> {
        let numpy = py.import("numpy")?;
        let array = numpy.call_method1("asarray", (chosen,))?;
        let is_mask: bool = array.getattr("dtype")?.getattr("kind")?.eq("b")?;
        let n = self.inner.len();
        let indices: Vec<i64> = if is_mask {
            if array.len()? != n {
                return Err(wrong(format!("a mask of {} for {n} Gaussians", array.len()?)));
            }
            numpy.call_method1("flatnonzero", (array,))?.call_method0("tolist")?.extract()?
        } else {
            array.call_method0("tolist")?.extract()?
        };
        let within = |i: &i64| usize::try_from(*i).ok().filter(|i| *i < n);
        if let Some(beyond) = indices.iter().find(|i| within(i).is_none()) {
            return Err(PyIndexError::new_err(format!("there is no Gaussian {beyond} among {n}: give numbers from 0")));
        }
        let indices: Vec<usize> = indices.iter().filter_map(within).collect();
        Ok(self.like(py.detach(|| self.inner.select(&indices))))
    }
}

/// Concatenates models; SH bands that one lacks are zero. The result has the origin of the first model, unless another one's is
/// much nearer to all.
#[pyfunction]
pub fn merge(py: Python<'_>, models: Vec<Bound<'_, Model>>) -> PyResult<Model> {
    let models: Vec<&Model> = models.iter().map(Bound::get).collect();
    let Some(first) = models.first() else { return Err(wrong("there is no model to merge")) };
    if models.iter().any(|other| other.mode != first.mode) {
        return Err(wrong("anti-aliased models and others cannot be one: they are drawn differently"));
    }
    let (merged, origin, rounded) = py.detach(|| {
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
    });
    if let Some(step) = rounded {
        let what = "a model lies far from the origin of the merged model";
        warn(py, &format!("{what}: its positions are rounded to about {step:.1e} units"))?;
    }
    Ok(Model { origin, ..first.like(merged) })
}
