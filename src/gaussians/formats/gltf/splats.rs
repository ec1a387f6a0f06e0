//! A primitive as Gaussians, in the axes of the file.

use super::super::axes::{LEFT_UP_FRONT, RIGHT_DOWN_FRONT, convert};
use super::super::fault::{Fault, malformed};
use super::super::limit::fits;
use super::super::linear::{log_scale, logit};
use super::super::{Gaussians, Tag, spz};
use super::container::Store;
use super::document::Primitive;
use super::{AGAIN, EXTENSION, TAG};
use crate::gaussians::MAX_SH_DEGREE;
use crate::wording::shown;
use serde_json::value::RawValue;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// The value of the tag in a primitive's `extras`, as a text.
fn tag_in(extras: &RawValue) -> Option<String> {
    let extras: BTreeMap<Cow<'_, str>, &RawValue> = serde_json::from_str(extras.get()).ok()?;
    let value = extras.get(TAG)?.get();
    Some(serde_json::from_str(value).unwrap_or_else(|_| value.to_owned()))
}

/// True if a primitive has splats.
pub(super) fn holds(primitive: &Primitive) -> bool {
    primitive.extensions.splats.is_some() || primitive.extensions.spz.is_some()
}

/// The Gaussians of a primitive and their tag; none if it has no splats.
pub(super) fn read(store: &Store, primitive: &Primitive, record: &str) -> Result<Option<(Gaussians, Tag)>, Fault> {
    let extensions = &primitive.extensions;
    let packed = extensions.splats.as_ref().map_or(&extensions.spz, |splats| &splats.extensions.spz);
    if let Some(packed) = packed {
        let (_, bytes) = store.view(packed.buffer_view)?;
        let count = primitive.attributes.get("POSITION").map(|index| store.claimed(*index)).transpose()?;
        let parsed = spz::read_in(bytes, spz::Around { axes: LEFT_UP_FRONT, count })?;
        let mut model = parsed.gaussians;
        convert(&mut model, RIGHT_DOWN_FRONT, LEFT_UP_FRONT);
        return Ok(Some((model, parsed.tag)));
    }
    let Some(splats) = &extensions.splats else { return Ok(None) };
    let mut tag = Tag::default();
    if let Some(mode) = primitive.extras.and_then(tag_in) {
        tag.comment(&[&format!("{TAG}:"), &mode]);
    }
    match splats.color_space.as_deref() {
        None | Some("srgb_rec709_display") => {}
        Some(other) => tag.add_doubt(format!("its colours are {}; they are drawn as sRGB", shown(other, 40))),
    }
    if let Some(other) = splats.kernel.as_deref().filter(|kernel| *kernel != "ellipse") {
        tag.add_doubt(format!("its kernel is {}; it is drawn as Gaussians", shown(other, 40)));
    }
    Ok(Some((attributes(store, primitive, record)?, tag)))
}

fn attributes(store: &Store, primitive: &Primitive, record: &str) -> Result<Gaussians, Fault> {
    let find = |name: &str| primitive.attributes.get(name).copied();
    let need = |name: &str| {
        find(name).ok_or_else(|| malformed(record, format!("no attribute `{name}`, which {EXTENSION} needs; {AGAIN}")))
    };
    let own = |name: &str| need(&format!("{EXTENSION}:{name}"));
    let position = need("POSITION")?;
    let n = store.count(position)?;
    let means = store.floats(position, 3, n)?.as_chunks().0.to_vec();
    let rotations = store.floats(own("ROTATION")?, 4, n)?;
    let scales: Vec<f32> = store.floats(own("SCALE")?, 3, n)?.into_iter().map(log_scale).collect();
    let opacities = store.floats(own("OPACITY")?, 1, n)?;

    let mut sh = Vec::new();
    for l in 0..=MAX_SH_DEGREE {
        let coefficient = |k: usize| find(&format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{k}"));
        let there = (0..=2 * l).filter(|&k| coefficient(k).is_some()).count();
        if there == 0 && l > 0 {
            break;
        }
        let mut band = vec![0.0; n * Gaussians::band_width(l)];
        for k in 0..=2 * l {
            let accessor = coefficient(k).ok_or_else(|| {
                let what =
                    format!("SH degree {l} has {there} of {} coefficients, k = {k} does not exist; {AGAIN}", 2 * l + 1);
                malformed(record, what)
            })?;
            let values = store.floats(accessor, 3, n)?;
            for (row, value) in band.chunks_exact_mut(Gaussians::band_width(l)).zip(values.chunks_exact(3)) {
                row[3 * k..3 * k + 3].copy_from_slice(value);
            }
        }
        sh.push(band);
    }
    let further = format!("{EXTENSION}:SH_DEGREE_{}_COEF_0", sh.len());
    let skipped = (sh.len()..=MAX_SH_DEGREE).any(|l| find(&format!("{EXTENSION}:SH_DEGREE_{l}_COEF_0")).is_some());
    if skipped {
        return Err(malformed(record, format!("SH of a higher degree without `{further}`; {AGAIN}")));
    }
    let model = Gaussians {
        means,
        log_scales: scales.as_chunks().0.to_vec(),
        rotations: rotations.chunks_exact(4).map(|q| [q[3], q[0], q[1], q[2]]).collect(),
        opacity_logits: opacities.iter().map(|&p| logit(p)).collect(),
        sh,
    };
    let Some(indices) = primitive.indices else { return Ok(model) };
    let rows = store.indices(indices, n)?;
    if !fits(rows.len(), model.degree(), store.bytes) {
        let what = format!("{} indices in a file of {} bytes; {AGAIN}", rows.len(), store.bytes);
        return Err(malformed(record, what));
    }
    Ok(model.select(&rows))
}
