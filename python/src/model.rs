//! Models.

use crate::arrays::{borrowed, floats, rows};
use crate::errors::{raised, wrong};
use engine::gaussians::formats::{self, RenderMode};
use engine::gaussians::{Gaussians, MAX_SH_DEGREE};
use numpy::ndarray::{ArrayView, Dimension, IntoDimension};
use numpy::{PyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// A 3DGS model on the host, which never changes: edits make new ones.
#[pyclass(frozen, module = "qirf_vk")]
pub struct Model {
    pub(crate) inner: Arc<Gaussians>,
    pub(crate) mode: RenderMode,
}

impl Model {
    pub(crate) fn new(model: Gaussians, mode: RenderMode) -> Self {
        Self { inner: Arc::new(model), mode }
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

/// Bands from a list of them, or from one array of all coefficients (n, (L + 1)^2, 3).
fn bands(sh: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<Vec<f32>>> {
    let of = |at: usize, band: &Bound<'_, PyAny>| {
        let (shape, numbers) = floats(band, &format!("sh[{at}]"))?;
        let expected = [n, 2 * at + 1, 3];
        if shape == expected {
            Ok(numbers)
        } else {
            Err(wrong(format!("sh[{at}] has the shape {shape:?}, and should have {expected:?}")))
        }
    };
    if let Ok(list) = sh.extract::<Vec<Bound<'_, PyAny>>>()
        && !sh.hasattr("dtype")?
    {
        return list.iter().enumerate().map(|(at, band)| of(at, band)).collect();
    }
    let (shape, numbers) = floats(sh, "sh")?;
    let degree = (0..=MAX_SH_DEGREE).find(|l| shape == [n, (l + 1) * (l + 1), 3]);
    let Some(degree) = degree else {
        return Err(wrong(format!("sh has the shape {shape:?}, and should have ({n}, 1, 4, 9 or 16, 3)")));
    };
    let all = 3 * (degree + 1) * (degree + 1);
    let band = |l: usize| {
        numbers.chunks_exact(all.max(1)).flat_map(|row| &row[3 * l * l..3 * (l + 1) * (l + 1)]).copied().collect()
    };
    Ok((0..=degree).map(band).collect())
}

#[pymethods]
impl Model {
    /// Reads a model: .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda, .usdz, or a SOG folder.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let loaded = py.detach(|| formats::read(&path)).map_err(|e| raised(engine::pipeline::Error::from(e)))?;
        Ok(Self::new(loaded.gaussians, loaded.mode))
    }

    /// A model from copies of arrays, checked.
    #[staticmethod]
    #[pyo3(signature = (means, log_scales, rotations, opacity_logits, sh, *, antialiased=false))]
    fn from_arrays(
        means: &Bound<'_, PyAny>,
        log_scales: &Bound<'_, PyAny>,
        rotations: &Bound<'_, PyAny>,
        opacity_logits: &Bound<'_, PyAny>,
        sh: &Bound<'_, PyAny>,
        antialiased: bool,
    ) -> PyResult<Self> {
        let means = rows(means, "means")?;
        let (shape, opacity_logits) = floats(opacity_logits, "opacity_logits")?;
        if shape != [means.len()] {
            return Err(wrong(format!("opacity_logits has the shape {shape:?}, and should have ({},)", means.len())));
        }
        let model = Gaussians {
            log_scales: rows(log_scales, "log_scales")?,
            rotations: rows(rotations, "rotations")?,
            opacity_logits,
            sh: bands(sh, means.len())?,
            means,
        };
        let model = model.checked().map_err(|e| raised(engine::pipeline::Error::from(e)))?;
        Ok(Self::new(model, RenderMode::of(antialiased)))
    }

    /// Writes the model, whole or not at all; the name decides on the format.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| formats::write(&path, &self.inner, self.mode))
            .map_err(|e| raised(engine::pipeline::Error::writing(e)))
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

    /// Quaternions (w, x, y, z) of any length, (n, 4).
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

    /// Spherical harmonics by degree: (n, 2 l + 1, 3) for l = 0 to L.
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

    /// True if it was trained with, and has to be drawn with, anti-aliasing.
    #[getter]
    fn antialiased(&self) -> bool {
        self.mode.antialiased()
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __repr__(&self) -> String {
        format!("Model({} Gaussians, SH degree {}, {})", self.inner.len(), self.inner.degree(), self.mode)
    }
}
