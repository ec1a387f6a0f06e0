//! The standard 3DGS layout: one vertex row per Gaussian, stored values as the optimiser sees them.
//!
//! Layout of graphdeco's trainer: x y z, (nx ny nz), f_dc_0..2, f_rest_0..(3K - 1) channel-major (all red, then green,
//! then blue; K coefficients of bands 1..=L each), opacity (logit), scale_0..2 (logarithms), rot_0..3 (w, x, y, z).

use glam::DVec3;
use rayon::prelude::*;

use super::super::Gaussians;
use super::super::bytes::sh0_of_colour;
use super::super::fault::{Fault, malformed};
use super::super::turn::middle;
use crate::gaussians::MAX_SH_DEGREE;
use crate::ply::{Kind, Slot, Table};
use crate::scene::origin::near;

/// The third log-scale of a flat model, which has two: as thin as 2DGS's own export for viewers makes it.
const FLAT: f32 = -13.815_511; // ln 1e-6

/// True for a model of discs: two scales a row, and all else of a Gaussian.
pub(super) fn is_flat(vertex: &Table) -> bool {
    vertex.find("scale_1").is_some() && vertex.find("scale_2").is_none()
}

/// Gathers the vertex table's columns; their order and any further ones do not matter. Colours may stand in red, green and
/// blue, under any of their names, instead of f_dc; a flat model gets a third scale.
pub(super) fn gaussians(vertex: &Table, origin: &mut [f64; 3]) -> Result<Gaussians, Fault> {
    let means = slots(vertex, ["x", "y", "z"])?;
    let [first, second] = slots(vertex, ["scale_0", "scale_1"])?;
    let third = vertex.find("scale_2");
    let rotations = slots(vertex, ["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let opacity = vertex.slot("opacity")?;
    let rest = rest_slots(vertex)?;
    let mut sh = match (vertex.find("f_dc_0"), vertex.colours()) {
        (None, Some(columns)) => {
            let mut shown = gather(vertex, &columns, Slot::float);
            let white = columns[0].white(shown.iter().copied().fold(0.0, f32::max));
            for c in &mut shown {
                *c = sh0_of_colour(*c / white);
            }
            vec![shown]
        }
        _ => vec![gather(vertex, &slots(vertex, ["f_dc_0", "f_dc_1", "f_dc_2"])?, Slot::float)],
    };
    sh.extend(rest_bands(&rest).iter().map(|slots| gather(vertex, slots, Slot::float)));

    let rows = || vertex.rows().par_chunks_exact(vertex.stride);
    let mut model = Gaussians {
        means: places(vertex, means, origin),
        log_scales: rows()
            .map(|row| [first.float(row), second.float(row), third.map_or(FLAT, |slot| slot.float(row))])
            .collect(),
        rotations: rows().map(|row| rotations.map(|slot| slot.float(row))).collect(),
        opacity_logits: rows().map(|row| opacity.float(row)).collect(),
        sh,
    };
    if let Some(filter) = vertex.find(FILTER) {
        let sizes: Vec<f32> = rows().map(|row| filter.float(row)).collect();
        smooth(&mut model, &sizes);
    }
    Ok(model)
}

/// Property of Mip-Splatting's models: the standard deviation by which each Gaussian is smoothed.
pub(super) const FILTER: &str = "filter_3D";

/// Widens Gaussians by their smoothing filters, and thins them out by as much.
fn smooth(model: &mut Gaussians, filters: &[f32]) {
    let gaussians = model.log_scales.par_iter_mut().zip(&mut model.opacity_logits).zip(filters);
    gaussians.for_each(|((scales, logit), filter)| {
        let mut share = 1.0;
        for scale in scales {
            let before = f64::from(*scale).exp().powi(2);
            let after = before + f64::from(*filter).powi(2);
            share *= (before / after).sqrt();
            *scale = (0.5 * after.ln()) as f32;
        }
        let opacity = share / (1.0 + f64::from(-*logit).exp());
        *logit = (opacity / (1.0 - opacity)).ln() as f32;
    });
}

/// The means. Where they are far from the origin and any coordinate is a double, they count from a place of their own, which is
/// added to `origin`: as float32 they would lose their differences.
fn places(vertex: &Table, slots: [Slot; 3], origin: &mut [f64; 3]) -> Vec<[f32; 3]> {
    let rows = || vertex.rows().par_chunks_exact(vertex.stride);
    let plain = || rows().map(|row| slots.map(|slot| slot.float(row))).collect();
    if !slots.iter().any(|slot| slot.kind() == Kind::F64) {
        return plain();
    }
    let whole: Vec<DVec3> = rows().map(|row| DVec3::from_array(slots.map(|slot| slot.value(row)))).collect();
    let (centre, size) = middle(&whole);
    let own = near(centre, size);
    if own == DVec3::ZERO {
        return plain();
    }
    for (origin, own) in origin.iter_mut().zip(own.to_array()) {
        *origin += own;
    }
    whole.into_iter().map(|p| (p - own).as_vec3().to_array()).collect()
}

/// Bands 1..=L of `rest`, which is channel-major.
pub(super) fn rest_bands(rest: &[Slot]) -> Vec<Vec<Slot>> {
    let per_channel = rest.len() / 3;
    (1..=MAX_SH_DEGREE)
        .take_while(|l| (l + 1) * (l + 1) - 1 <= per_channel)
        .map(|l| {
            let coefficients = l * l - 1..(l + 1) * (l + 1) - 1;
            coefficients.flat_map(|k| [0, 1, 2].map(|channel| rest[channel * per_channel + k])).collect()
        })
        .collect()
}

/// One value per row and slot, row-major.
pub(super) fn gather(table: &Table, slots: &[Slot], value: impl Fn(Slot, &[u8]) -> f32 + Sync) -> Vec<f32> {
    let mut out = vec![0.0; table.len() * slots.len()];
    let rows = table.rows().par_chunks_exact(table.stride);
    out.par_chunks_exact_mut(slots.len()).zip(rows).for_each(|(out, row)| {
        for (out, &slot) in out.iter_mut().zip(slots) {
            *out = value(slot, row);
        }
    });
    out
}

/// The places of f_rest_0.., as many as degree 0, 1, 2 or 3 has.
pub(super) fn rest_slots(table: &Table) -> Result<Vec<Slot>, Fault> {
    let count = table.names().filter(|name| name.starts_with("f_rest_")).count();
    match count {
        0 | 9 | 24 | 45 => (0..count).map(|i| Ok(table.slot(&format!("f_rest_{i}"))?)).collect(),
        72 => Err(Fault::Unsupported("SH degree 4 (72 f_rest); export it with degree 3 or less".into())),
        _ => Err(malformed(
            format!("element {}", table.name()),
            format!("{count} f_rest properties; SH of degree 0 to 3 has 0, 9, 24 or 45; export the file again"),
        )),
    }
}

fn slots<const N: usize>(table: &Table, names: [&str; N]) -> Result<[Slot; N], Fault> {
    let found: Vec<Slot> = names.iter().map(|name| table.slot(name)).collect::<Result<_, _>>()?;
    found.try_into().map_err(|_| malformed("header", "properties missing; export the file again"))
}
