//! The attributes of a prim with Gaussians, and the Gaussians that they are.

use super::super::linear::{log_scale, logit};
use super::{AGAIN, Fault, Gaussians, Tag, malformed};
use crate::gaussians::MAX_SH_DEGREE;
use crate::wording::shown;

/// An attribute with values for each Gaussian.
#[derive(Default)]
pub(super) struct Array {
    pub values: Option<Vec<f32>>,
    /// True if it has time samples, which are not read.
    pub sampled: bool,
}

/// Attributes of a prim with Gaussians.
#[derive(Default)]
pub(super) struct Arrays {
    positions: Array,
    orientations: Array,
    scales: Array,
    opacities: Array,
    pub degree: Option<f32>,
    coefficients: Array,
}

impl Arrays {
    /// The array of an attribute, in floats or halves; none if it is no attribute of Gaussians.
    pub(super) fn named(&mut self, name: &[u8]) -> Option<&mut Array> {
        Some(match name.strip_suffix(b"h").unwrap_or(name) {
            b"positions" => &mut self.positions,
            b"orientations" => &mut self.orientations,
            b"scales" => &mut self.scales,
            b"opacities" => &mut self.opacities,
            b"radiance:sphericalHarmonicsCoefficients" => &mut self.coefficients,
            _ => return None,
        })
    }
}

/// The Gaussians of a prim, in the layer's axes. As in the schema, an array that is longer than the positions is cut, and an
/// absent one has a default value.
pub(super) fn gaussians(arrays: Arrays, name: &str) -> Result<(Gaussians, Tag), Fault> {
    let Arrays { positions, orientations, scales, opacities, degree, coefficients } = arrays;
    let record = format!("prim {}", shown(name, 40));
    let only_sampled = |what: &str| {
        malformed(&record, format!("has {what} only in time samples, which are not read; export one frame"))
    };
    let Array { values: positions, sampled } = positions;
    let positions = positions.ok_or_else(|| {
        if sampled { only_sampled("positions") } else { malformed(&record, format!("has no positions; {AGAIN}")) }
    })?;
    let n = positions.len() / 3;
    let mut defaults = Vec::new();
    let mut of = |array: Array, what: &'static str, default: &[f32]| {
        let length = n * default.len();
        match array.values.filter(|values| !values.is_empty()) {
            Some(values) if values.len() < length || positions.len() > 3 * n => {
                Err(malformed(&record, format!("{} numbers of {what} for {n} positions; {AGAIN}", values.len())))
            }
            Some(mut values) => {
                values.truncate(length);
                Ok(values)
            }
            None if array.sampled => Err(only_sampled(what)),
            None => {
                if n > 0 {
                    defaults.push(what);
                }
                Ok(default.repeat(n))
            }
        }
    };
    let rotations = of(orientations, "orientations", &[1.0, 0.0, 0.0, 0.0])?.as_chunks().0.to_vec();
    let scales: Vec<f32> = of(scales, "scales", &[1.0; 3])?.into_iter().map(log_scale).collect();
    let opacities = of(opacities, "opacities", &[1.0])?;
    let degree = if coefficients.values.is_some() { degree.unwrap_or(3.0) } else { 0.0 };
    let degree = (0..=MAX_SH_DEGREE).find(|l| *l as f32 == degree).ok_or_else(|| {
        Fault::Unsupported(format!("SH degree {degree}; 0 to {MAX_SH_DEGREE} are read; export it with one of these"))
    })?;
    let width = 3 * (degree + 1).pow(2);
    // Cut, rows of more bands would be those of other Gaussians.
    let given = coefficients.values.as_ref().map_or(0, Vec::len);
    if n > 0 && (degree + 1..=MAX_SH_DEGREE).any(|l| given == n * 3 * (l + 1).pow(2)) {
        let what = format!("{given} numbers of spherical harmonics for {n} positions and degree {degree}; {AGAIN}");
        return Err(malformed(&record, what));
    }
    let coefficients = of(coefficients, "spherical harmonics", &[0.0; 48][..width])?;
    let doubt = (!defaults.is_empty())
        .then(|| format!("{record} has no {}; the schema's default values are used", defaults.join(", ")));
    let band = |l: usize| -> Vec<f32> {
        coefficients.chunks_exact(width).flat_map(|row| &row[3 * l * l..3 * (l + 1) * (l + 1)]).copied().collect()
    };
    let gaussians = Gaussians {
        means: positions.as_chunks().0.to_vec(),
        log_scales: scales.as_chunks().0.to_vec(),
        rotations,
        opacity_logits: opacities.into_iter().map(logit).collect(),
        sh: (0..=degree).map(band).collect(),
    };
    let mut tag = Tag::default();
    tag.add_first(doubt);
    Ok((gaussians, tag))
}
