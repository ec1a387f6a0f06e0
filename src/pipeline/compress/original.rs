//! The input's own file, where that meets a size already.

use super::fit::Target;
use super::{CompressConfig, Input, Recorded};
use crate::extension::extension;
use crate::gaussians::formats::{self, Format};
use crate::job::output::bytes_on_disk;
use crate::job::records::{Aim, AimRecord, Point};
use std::fs;

/// The bytes of the input's file, and the record of their choice, if it is a single file of the target's format and of at
/// most the size wanted, holds the model as it is, and nothing but the size was asked for.
pub fn fitting(input: &Input<'_>, config: &CompressConfig, aim: Option<Aim>, target: &Target<'_>) -> Option<Recorded> {
    let Some(Aim::Bytes(size)) = aim else { return None };
    let format = formats::written_as(target.path)?;
    let is_alike = formats::written_as(input.path) == Some(format) && extension(input.path) == extension(target.path);
    let is_changed = config.fine_tune > 0 || target.precision.is_some() || target.wrap.is_some();
    if !is_alike || is_changed || !(1..=size).contains(&bytes_on_disk(input.path)) {
        return None;
    }
    // Files with parts elsewhere are not read from their bytes alone.
    let bytes = fs::read(input.path).ok()?;
    let loaded = formats::read_bytes(&bytes, input.path).ok()?;
    // Other programs may not unpack gzip, which is a part of SPZ alone.
    let is_zipped = format != Format::Spz && bytes.starts_with(&[0x1f, 0x8b]);
    let is_sound = loaded.format == format && loaded.remark().is_none() && loaded.doubt.is_none() && !is_zipped;
    // Formats that hold an origin must hold this one; the others have it in georeference.json.
    let holds_none = loaded.origin == [0.0; 3] && matches!(format, Format::Spz | Format::Sog);
    let is_placed = loaded.origin == target.origin || holds_none;
    let is_same = loaded.mode == config.style.mode() && loaded.gaussians == input.model && is_placed;
    let length = bytes.len() as u64;
    if !is_sound || !is_same || length > size {
        return None;
    }
    let rungs = target.ladder(&input.model).to_search(input.model.degree()).rungs.len();
    let chosen = Point { rung: rungs.saturating_sub(1), gaussians: input.model.len(), bytes: length, psnr: None };
    let record = AimRecord {
        aim: Aim::Bytes(size),
        original: true,
        chosen,
        written: None,
        fine_tuning: None,
        precision: formats::Precision::Fixed,
        rungs,
        tried: Vec::new(),
    };
    Some((bytes, record))
}
