//! Models.

use crate::arrays::{borrowed, floats, rows, tuple, vector};
use crate::errors::{file, given, raised, some_sh_bits, warn, whole, wrong};
use crate::fork::detached;
use crate::of_run::OfRun;
use engine::edit::{reading_warnings, rounding, rounding_warning};
use engine::gaussians::formats::{self, Format, Loaded, Precision, RenderMode, SpzPrecision, SpzVersion};
use engine::gaussians::{Gaussians, MAX_SH_DEGREE};
use engine::glam::DVec3;
use engine::job::Error;
use engine::job::earlier::spare_model;
use engine::pipeline::compress::fit::Target;
use engine::pipeline::place::place;
use engine::wording::counted;
use numpy::ndarray::{ArrayView, Dimension, IntoDimension};
use numpy::{PyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A model of n Gaussians on the host, made by load, from_arrays and functions. It never changes: edits return new models. Arrays are
/// read-only views of its memory. Models can be pickled; copies are the model itself, and a model equals only itself.
///
/// A model of train, or loaded from beside a run's config.toml, remembers how its run draws and scores it: dilation, depth order, background and
/// exposures. Edits, compress and pickles keep that; Renderer, evaluate and compress use it for arguments that are None, as the program does,
/// and say so in the log.
#[pyclass(frozen, weakref, module = "qirf_vk")]
pub struct Model {
    pub(crate) inner: Arc<Gaussians>,
    pub(crate) mode: RenderMode,
    pub(crate) origin: [f64; 3],
    /// The format that it was read from; none for one from memory.
    pub(crate) format: Option<Format>,
    pub(crate) run: OfRun,
}

/// Gaussians, the place in the world from which their means count, and a warning.
pub type Placed = (Gaussians, [f64; 3], Option<String>);

impl Model {
    /// A model that was read, of this run.
    pub(crate) fn of_file(Loaded { gaussians, mode, origin, format, .. }: Loaded, run: OfRun) -> Self {
        Self { inner: Arc::new(gaussians), mode, origin, format: Some(format), run }
    }

    /// These Gaussians, drawn alike and in the same place of the world.
    pub(crate) fn like(&self, model: Gaussians) -> Self {
        Self { inner: Arc::new(model), ..*self }
    }

    /// A copy of the Gaussians whose means count from where the coordinates of a scene with these photos do, that place, and a warning if its
    /// own record of a place may be lost.
    pub(crate) fn placed(&self, scene: Option<(&Path, Option<&Path>)>) -> Result<Placed, Error> {
        let (mut model, mut origin) = (Gaussians::clone(&self.inner), self.origin);
        let doubt = match scene {
            Some((scene, images)) => place((&mut model, &mut origin), self.format, scene, images)?,
            None => None,
        };
        Ok((model, origin, doubt.map(|doubt| format!("the model {doubt}"))))
    }

    pub(crate) fn ply(&self) -> Result<Vec<u8>, Error> {
        let how = (Precision::Fixed, SpzVersion::default());
        formats::encode(Path::new("model.ply"), &self.inner, (self.mode, self.origin), how).map_err(Error::writing)
    }

    pub(crate) fn ply_bytes(&self) -> Result<u64, Error> {
        self.ply().map(|bytes| bytes.len() as u64)
    }

    /// A copy of the Gaussians whose means count from another place in the world.
    pub(crate) fn counted_from(&self, origin: [f64; 3]) -> Gaussians {
        let mut model = Gaussians::clone(&self.inner);
        model.shift(DVec3::from(self.origin) - DVec3::from(origin));
        model
    }

    /// A read-only array over numbers of a model.
    #[allow(unsafe_code)]
    fn view<'py, D: Dimension>(
        this: &Bound<'py, Self>,
        numbers: &[f32],
        shape: impl IntoDimension<Dim = D>,
    ) -> PyResult<Bound<'py, PyArray<f32, D>>> {
        let view = ArrayView::from_shape(shape.into_dimension(), numbers).map_err(|e| wrong(e.to_string()))?;
        // SAFETY: the numbers are those of the model's arrays, which belong to `this`, a frozen object that never changes them.
        unsafe { borrowed(view, this.clone().into_any()) }
    }
}

/// The part of a record about a model in memory: it has no path.
pub fn in_memory(model: &mut Value) {
    model["path"] = Value::Null;
}

/// Warns of what reading a file lost, of an unclear tag, and of a file without Gaussians.
pub fn warn_of(py: Python<'_>, loaded: &Loaded, path: &Path) -> PyResult<()> {
    for warning in reading_warnings(loaded) {
        warn(py, &format!("{}: {warning}", path.display()))?;
    }
    Ok(())
}

/// The model that was pickled.
#[pyfunction(name = "_model")]
pub fn unpickled(
    arrays: &Bound<'_, PyTuple>,
    antialiased: bool,
    origin: [f64; 3],
    run: OfRun,
    format: Option<&str>,
) -> PyResult<Model> {
    let item = |at| arrays.get_item(at);
    let model = gathered(&item(0)?, &item(1)?, &item(2)?, &item(3)?, &item(4)?)?;
    let format = Format::ALL.into_iter().find(|known| Some(known.name()) == format);
    // It was a model: edits may have led to Gaussians that cannot be drawn, and files of large ones are read.
    model.validate().map_err(|e| raised(Error::from(e)))?;
    Ok(Model { inner: Arc::new(model), mode: RenderMode::of(antialiased), origin, format, run })
}

/// Gaussians of arrays, of which neither the values nor all of the lengths are checked.
fn gathered(
    means: &Bound<'_, PyAny>,
    log_scales: &Bound<'_, PyAny>,
    rotations: &Bound<'_, PyAny>,
    opacity_logits: &Bound<'_, PyAny>,
    sh: &Bound<'_, PyAny>,
) -> PyResult<Gaussians> {
    let means = rows(means, "means")?;
    let (shape, opacity_logits) = floats(opacity_logits, "opacity_logits")?;
    if shape != [means.len()] {
        return Err(wrong(format!(
            "opacity_logits has the shape {}, and should have ({},)",
            tuple(&shape),
            means.len()
        )));
    }
    Ok(Gaussians {
        log_scales: rows(log_scales, "log_scales")?,
        rotations: rows(rotations, "rotations")?,
        opacity_logits,
        sh: bands(sh, means.len())?,
        means,
    })
}

/// True for a list of bands: its first item has three axes, and that of a list of all coefficients two.
fn is_list_of_bands(sh: &Bound<'_, PyAny>) -> PyResult<bool> {
    if sh.hasattr("dtype")? {
        return Ok(false);
    }
    let Ok(list) = sh.extract::<Vec<Bound<'_, PyAny>>>() else { return Ok(false) };
    let Some(first) = list.first() else { return Ok(true) };
    let axes = sh.py().import("numpy")?.call_method1("ndim", (first,)).and_then(|axes| axes.extract::<usize>());
    Ok(axes.is_ok_and(|axes| axes == 3))
}

/// Bands from a list of them, or from one array of all coefficients (n, (L + 1)^2, 3).
fn bands(sh: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<Vec<f32>>> {
    let of = |at: usize, band: &Bound<'_, PyAny>| {
        let (shape, numbers) = floats(band, &format!("sh[{at}]"))?;
        let expected = [n, 2 * at + 1, 3];
        if shape == expected {
            Ok(numbers)
        } else {
            Err(wrong(format!("sh[{at}] has the shape {}, and should have {}", tuple(&shape), tuple(&expected))))
        }
    };
    if is_list_of_bands(sh)? {
        return sh.extract::<Vec<Bound<'_, PyAny>>>()?.iter().enumerate().map(|(at, band)| of(at, band)).collect();
    }
    let (shape, numbers) = floats(sh, "sh")?;
    let degree = (0..=MAX_SH_DEGREE).find(|l| shape == [n, (l + 1) * (l + 1), 3]);
    let Some(degree) = degree else {
        return Err(wrong(format!("sh has the shape {}, and should have ({n}, 1, 4, 9 or 16, 3)", tuple(&shape))));
    };
    let all = 3 * (degree + 1) * (degree + 1);
    let band = |l: usize| {
        numbers.chunks_exact(all.max(1)).flat_map(|row| &row[3 * l * l..3 * (l + 1) * (l + 1)]).copied().collect()
    };
    Ok((0..=degree).map(band).collect())
}

#[pymethods]
impl Model {
    /// Reads .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda, .usdz, or a SOG folder; Gaussians that are not finite or have no rotation
    /// are left out, with a UserWarning, which also tells of an unclear tag and of a file without Gaussians.
    #[staticmethod]
    fn load(py: Python<'_>, #[pyo3(from_py_with = file)] path: PathBuf) -> PyResult<Self> {
        let loaded = detached(py, || formats::read(&path))?.map_err(|e| raised(Error::from(e)))?;
        warn_of(py, &loaded, &path)?;
        let run = match OfRun::beside(&path) {
            Ok(run) => run,
            Err(error) => {
                warn(py, &format!("{error}; the style of rendering and exposures are not taken from it"))?;
                OfRun::default()
            }
        };
        Ok(Self::of_file(loaded, run))
    }

    /// Copies arrays, as float32; ValueError names the first Gaussian that cannot be drawn. A UserWarning tells of positions that float32
    /// rounds far from the origin, such as map coordinates: give means - c with origin=c.
    ///
    /// means (n, 3); log_scales (n, 3), natural logarithms of standard deviations, below 30; rotations (n, 4), quaternions w, x, y, z;
    /// opacity_logits (n,); sh: a list of bands (n, 2 l + 1, 3) for l = 0 to L, or all coefficients (n, (L + 1)^2, 3), as an array or
    /// nested lists; L is 0 to 3; origin: see Model.origin.
    #[staticmethod]
    #[pyo3(signature = (means, log_scales, rotations, opacity_logits, sh, *, antialiased=false, origin=[0.0; 3]),
        text_signature = "(means, log_scales, rotations, opacity_logits, sh, *, antialiased=False, origin=(0.0, 0.0, 0.0))")]
    fn from_arrays(
        py: Python<'_>,
        means: &Bound<'_, PyAny>,
        log_scales: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        opacity_logits: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        antialiased: bool,
        #[pyo3(from_py_with = vector::origin)] origin: [f64; 3],
    ) -> PyResult<Self> {
        if origin.iter().any(|x| !x.is_finite()) {
            return Err(wrong("origin should be three finite numbers"));
        }
        let model = gathered(means, log_scales, rotations, opacity_logits, sh)?;
        let model = model.checked().map_err(|e| raised(Error::from(e)))?;
        if let Some(step) = rounding(&model) {
            let far = rounding_warning("the model lies far from its origin", step);
            warn(py, &format!("{far}; give means - c with origin=c, where c is a point among them"))?;
        }
        let mode = RenderMode::of(antialiased);
        Ok(Self { inner: Arc::new(model), mode, origin, format: None, run: OfRun::default() })
    }

    /// Writes .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda or .usdz, completely or not at all; an origin is written to georeference.json
    /// beside it. A model without Gaussians is a ValueError, and so is the name of a run's own model, which its figures describe.
    ///
    /// sh_bits: bits of SH coefficients in an SPZ, 1 to 8, or two numbers: of band 1, and of the others. By default they are the usual ones, not
    /// chosen by pictures as `qirf-vk convert` does: compress(model, 1, output="x.spz") chooses them. spz_version: 4, or 3 for readers from
    /// before 2026.
    #[pyo3(signature = (path, *, sh_bits=None, spz_version=4))]
    fn save(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = file)] path: PathBuf,
        #[pyo3(from_py_with = some_sh_bits)] sh_bits: Option<SpzPrecision>,
        #[pyo3(from_py_with = whole)] spz_version: i64,
    ) -> PyResult<()> {
        if self.inner.is_empty() {
            return Err(wrong("the model has no Gaussian: nothing was written"));
        }
        let spz = match spz_version {
            3 => SpzVersion::Three,
            4 => SpzVersion::Four,
            other => return Err(wrong(format!("{}: give 3 or 4", given("spz_version", other)))),
        };
        let is_spz = formats::written_as(&path) == Some(Format::Spz);
        if !is_spz && (sh_bits.is_some() || spz != SpzVersion::default()) {
            return Err(wrong("sh_bits and spz_version are for SPZ: name an .spz file"));
        }
        spare_model(&path).map_err(raised)?;
        let written = detached(py, || {
            let target = Target { spz, origin: self.origin, ..Target::new(&path) };
            let precision = || sh_bits.map_or_else(|| formats::unmeasured(&path, &self.inner), Precision::Spz);
            let packed = is_spz.then(|| target.pack(&self.inner, self.mode, precision())).transpose()?;
            target.write(packed, &self.inner, self.mode)
        })?;
        written.map_err(raised)?;
        let colours = formats::clip_warning(&path, formats::clipped(&path, &self.inner));
        let sizes = formats::size_warning(&path, formats::outsized(&path, &self.inner));
        colours.into_iter().chain(sizes).try_for_each(|line| warn(py, &line))
    }

    /// Centres in world units, (n, 3).
    #[getter]
    fn means<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let model = &this.get().inner;
        Self::view(this, model.means.as_flattened(), (model.len(), 3))
    }

    /// Natural logarithms of the axes' standard deviations, (n, 3).
    #[getter]
    fn log_scales<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let model = &this.get().inner;
        Self::view(this, model.log_scales.as_flattened(), (model.len(), 3))
    }

    /// Quaternions w, x, y, z of any length, (n, 4).
    #[getter]
    fn rotations<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let model = &this.get().inner;
        Self::view(this, model.rotations.as_flattened(), (model.len(), 4))
    }

    /// Opacities before the sigmoid, (n,).
    #[getter]
    fn opacity_logits<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let model = &this.get().inner;
        Self::view(this, &model.opacity_logits, model.len())
    }

    /// Spherical harmonics by degree, (n, 2 l + 1, 3) for l = 0 to L: coefficients m = -l to l, each red, green, blue.
    #[getter]
    fn sh<'py>(this: &Bound<'py, Self>) -> PyResult<Vec<Bound<'py, PyArray3<f32>>>> {
        let model = &this.get().inner;
        model.sh.iter().enumerate().map(|(l, band)| Self::view(this, band, (model.len(), 2 * l + 1, 3))).collect()
    }

    /// The SH degree L.
    #[getter]
    fn degree(&self) -> usize {
        self.inner.degree()
    }

    /// True if it has to be drawn with anti-aliasing.
    #[getter]
    fn antialiased(&self) -> bool {
        self.mode.antialiased()
    }

    /// Local origin of the means in the world; (0, 0, 0) except for models far from the world's origin, such as those in map coordinates. Edits keep it.
    #[getter]
    fn origin(&self) -> (f64, f64, f64) {
        self.origin.into()
    }

    fn __reduce__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, model) = (this.py(), this.get());
        let arrays = (
            Self::means(this)?,
            Self::log_scales(this)?,
            Self::rotations(this)?,
            Self::opacity_logits(this)?,
            Self::sh(this)?,
        );
        let format = model.format.map(Format::name);
        let make = py.import("qirf_vk")?.getattr("_model")?;
        Ok((make, (arrays, model.antialiased(), model.origin(), model.run, format).into_pyobject(py)?))
    }

    fn __copy__<'py>(this: &Bound<'py, Self>) -> Bound<'py, Self> {
        this.clone()
    }

    fn __deepcopy__<'py>(this: &Bound<'py, Self>, _memo: &Bound<'py, PyDict>) -> Bound<'py, Self> {
        this.clone()
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __repr__(&self) -> String {
        let count = counted(self.inner.len(), "Gaussian");
        format!("Model({count}, SH degree {}, {})", self.inner.degree(), self.mode)
    }
}
