//! Writing a USD text layer: one prim, Y up.

use std::fmt::Write as _;
use std::io::{self, Write};

use rayon::prelude::*;

use super::super::axes::{RIGHT_DOWN_FRONT, RIGHT_UP_BACK, convert, convert_place};
use super::super::{Gaussians, RenderMode, linear};
use super::{PRIM, TAG};

/// Standard deviations of a Gaussian within its prim's extent.
const REACH: f32 = 3.0;
/// Elements of a list that become text together, and the number of such blocks between two writes.
const BLOCK: usize = 4096;
const BLOCKS: usize = 64;

/// Writes a whole layer; floats keep their bits. The local origin of the means is the translation of the prim.
pub(in super::super) fn write(
    out: &mut dyn Write,
    model: &Gaussians,
    mode: RenderMode,
    origin: [f64; 3],
) -> io::Result<()> {
    let mut model = model.clone();
    convert(&mut model, RIGHT_DOWN_FRONT, RIGHT_UP_BACK);
    writeln!(out, "#usda 1.0\n(\n    defaultPrim = \"Splat\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n")?;
    writeln!(out, "def {PRIM} \"Splat\"")?;
    if mode.antialiased() {
        writeln!(out, "(\n    customData = {{\n        string {TAG} = \"mip\"\n    }}\n)")?;
    }
    writeln!(
        out,
        "{{\n    uniform token projectionModeHint = \"perspective\"\n    uniform token sortingModeHint = \"zDepth\""
    )?;
    if origin != [0.0; 3] {
        let [x, y, z] = convert_place(origin.into(), RIGHT_DOWN_FRONT, RIGHT_UP_BACK).to_array();
        writeln!(out, "    double3 xformOp:translate = ({x}, {y}, {z})")?;
        writeln!(out, "    uniform token[] xformOpOrder = [\"xformOp:translate\"]")?;
    }
    let n = model.len();
    let degree = model.degree();
    let extent = extent(&model);
    list(out, "float3[] extent", 2, |i| Some(extent[i]))?;
    list(out, "point3f[] positions", n, |i| Some(model.means[i]))?;
    list(out, "quatf[] orientations", n, |i| Some(linear::unit(model.rotations[i])))?;
    list(out, "float3[] scales", n, |i| Some(model.log_scales[i].map(linear::scale)))?;
    list(out, "float[] opacities", n, |i| Some([linear::opacity(model.opacity_logits[i])]))?;
    writeln!(out, "    uniform int radiance:sphericalHarmonicsDegree = {degree}")?;
    let per_gaussian = (degree + 1).pow(2);
    list(out, "float3[] radiance:sphericalHarmonicsCoefficients", n * per_gaussian, |at| {
        let (i, k) = (at / per_gaussian, at % per_gaussian);
        let l = k.isqrt();
        model.sh[l][i * Gaussians::band_width(l) + 3 * (k - l * l)..].first_chunk::<3>().copied()
    })?;
    writeln!(out, "}}")
}

/// Writes an array of numbers or tuples; blocks become text on all cores, a few at a time.
fn list<const N: usize>(
    out: &mut dyn Write,
    name: &str,
    n: usize,
    element: impl Fn(usize) -> Option<[f32; N]> + Sync,
) -> io::Result<()> {
    let block = |block: usize| {
        let mut text = String::new();
        for i in block * BLOCK..n.min((block + 1) * BLOCK) {
            text.push_str(if i == 0 { "" } else { ", " });
            text.push_str(if N == 1 { "" } else { "(" });
            for (k, value) in element(i).unwrap_or([0.0; N]).into_iter().enumerate() {
                text.push_str(if k == 0 { "" } else { ", " });
                number(&mut text, value);
            }
            text.push_str(if N == 1 { "" } else { ")" });
        }
        text
    };
    write!(out, "    {name} = [")?;
    for first in (0..n.div_ceil(BLOCK)).step_by(BLOCKS) {
        let last = (first + BLOCKS).min(n.div_ceil(BLOCK));
        let texts: Vec<String> = (first..last).into_par_iter().map(block).collect();
        texts.iter().try_for_each(|text| out.write_all(text.as_bytes()))?;
    }
    writeln!(out, "]")
}

/// Appends the shortest text that is read back to the same bits.
fn number(text: &mut String, value: f32) {
    let magnitude = value.abs();
    if value.is_nan() {
        text.push_str("nan");
    } else if value.is_infinite() {
        text.push_str(if value > 0.0 { "inf" } else { "-inf" });
    } else {
        let plain = magnitude == 0.0 || (1e-4..1e7).contains(&magnitude);
        let written = if plain { write!(text, "{value}") } else { write!(text, "{value:e}") };
        written.expect("memory takes any text");
    }
}

/// Least and greatest corner of a box round all Gaussians.
fn extent(model: &Gaussians) -> [[f32; 3]; 2] {
    let mut corners = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for (mean, scales) in model.means.iter().zip(&model.log_scales) {
        let reach = REACH * scales.iter().fold(0.0, |most: f32, s| most.max(linear::scale(*s)));
        for k in 0..3 {
            corners[0][k] = corners[0][k].min(mean[k] - reach);
            corners[1][k] = corners[1][k].max(mean[k] + reach);
        }
    }
    if model.is_empty() { [[0.0; 3]; 2] } else { corners }
}
