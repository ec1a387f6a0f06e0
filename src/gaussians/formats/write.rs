//! Writers of model files, by the extension of their name.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::{Format, Precision, RenderMode, georeference, gltf, ply, sog, unmeasured, usd, usual, write_atomically};
use crate::extension::{extension, has_extension};
use crate::gaussians::{Error, Gaussians};

/// The version of a written SPZ; both store the same values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// gzip round everything: for readers of before 2026.
    Three,
    /// zstd by attribute.
    #[default]
    Four,
}

/// Refuses a `path` whose extension no writer knows, before any work is done for it.
pub fn check_output(path: &Path) -> Result<(), Error> {
    written_as(path).map(drop).ok_or_else(|| unwritten(path))
}

fn unwritten(path: &Path) -> Error {
    let what = "models are written as .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda or .usdz; give the output one \
                of these extensions";
    Error::Unsupported { path: path.to_owned(), what: what.to_owned() }
}

/// The format of a file of this name; none if no writer knows its extension.
pub fn written_as(path: &Path) -> Option<Format> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    Some(match extension(path).as_str() {
        "ply" if name.ends_with(".compressed.ply") => Format::CompressedPly,
        "ply" => Format::Ply,
        "spz" => Format::Spz,
        "sog" => Format::Sog,
        "glb" | "gltf" => Format::Gltf,
        "usda" | "usdz" => Format::Usd,
        _ => return None,
    })
}

/// True for formats that store floats, so that their pictures are those of the model.
pub fn is_exact(path: &Path) -> bool {
    !matches!(written_as(path), Some(Format::CompressedPly | Format::Spz | Format::Sog))
}

/// Writes `gaussians` to `path` in the format of its extension: `.ply` (bit-exact), `.glb`, `.gltf`, `.usda` or
/// `.usdz` (exact but for rounding exponentials and unit quaternions), `.spz` (version 4), `.sog` or `.compressed.ply` (quantised
/// as [`unmeasured`]), completely or not at all; with the tag of `mode`. SOG and compressed PLY do not keep the order of the Gaussians, SOG not that of their axes either.
///
/// Call [`refuse_overwrite`](super::refuse_overwrite) first where the model came from a file.
///
/// # Errors
/// [`Error::Unsupported`] for another extension or for what the format cannot hold, [`Error::Inconsistent`],
/// [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians, mode: RenderMode) -> Result<(), Error> {
    write_at(path, gaussians, mode, [0.0; 3])
}

/// Writes a model as [`write()`] does, with the local origin of the means: PLY stores it in a comment, glTF and USD as
/// a translation, and [`georeference()`] writes it beside every file.
pub fn write_at(path: &Path, gaussians: &Gaussians, mode: RenderMode, origin: [f64; 3]) -> Result<(), Error> {
    write_atomically(path, body(path, gaussians, (mode, origin), None)?)?;
    georeference(path, origin)
}

/// Writes a file's bytes.
type Body<'a> = Box<dyn FnOnce(&mut dyn Write) -> io::Result<()> + 'a>;

/// A file in the format of its extension. Formats of few digits are packed now, as [`unmeasured`] unless `how` is given.
fn body<'a>(
    path: &Path,
    gaussians: &'a Gaussians,
    (mode, origin): (RenderMode, [f64; 3]),
    how: Option<(Precision, SpzVersion)>,
) -> Result<Body<'a>, Error> {
    gaussians.validate()?;
    let how = || how.unwrap_or_else(|| (unmeasured(path, gaussians), SpzVersion::default()));
    let packed = match written_as(path) {
        Some(Format::Ply) => return Ok(Box::new(move |out| ply::write(out, gaussians, mode, origin))),
        Some(Format::CompressedPly) => {
            return Ok(Box::new(move |out| ply::write_compressed(out, gaussians, mode, origin)));
        }
        Some(Format::Usd) if has_extension(path, &["usdz"]) => usd::package(gaussians, mode, origin),
        Some(Format::Usd) => return Ok(Box::new(move |out| usd::write(out, gaussians, mode, origin))),
        Some(Format::Gltf) => match gltf::write(gaussians, (mode, origin), has_extension(path, &["gltf"])) {
            Ok(body) => return Ok(Box::new(body)),
            Err(fault) => Err(fault),
        },
        Some(Format::Spz) => {
            let (precision, version) = how();
            super::spz::pack(gaussians, mode, (version, precision.of_spz()))
        }
        Some(Format::Sog) => sog::pack(gaussians, mode, &how().0.of_sog()),
        Some(Format::Splat | Format::Ksplat) | None => return Err(unwritten(path)),
    };
    let packed = packed.map_err(|fault| fault.at(path))?;
    Ok(Box::new(move |out| out.write_all(&packed)))
}

/// Writes levels of detail, the finest first, as streamed SOG: `path`, which ends in `lod-meta.json`, and folders beside it.
///
/// # Errors
/// [`Error::Unsupported`] for what SOG cannot hold, [`Error::Inconsistent`], [`Error::Io`].
pub fn write_levels(path: &Path, levels: &[Gaussians], (mode, origin): (RenderMode, [f64; 3])) -> Result<(), Error> {
    for level in levels {
        level.validate()?;
    }
    if levels.first().is_none_or(Gaussians::is_empty) {
        let what = "levels of detail need a Gaussian; write .ply for a model without any".to_owned();
        return Err(Error::Unsupported { path: path.to_owned(), what });
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let earlier = sog::folders_of_levels(folder);
    let precision = |level| unmeasured(Path::new("model.sog"), level).of_sog();
    let precisions: Vec<_> = levels.iter().map(precision).collect();
    let files = sog::pack_levels(levels, mode, &precisions).map_err(|fault| fault.at(path))?;
    let stale = earlier.into_iter().filter(|part| !files.iter().any(|(name, _)| Path::new(name).starts_with(part)));
    let stale: Vec<PathBuf> = stale.collect();
    for (name, content) in files {
        let file = folder.join(name);
        let parent = file.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(|source| Error::Io { path: parent.to_owned(), source })?;
        write_atomically(&file, |out| out.write_all(&content))?;
    }
    // Levels of the model that was replaced would be uploaded with these.
    for part in stale {
        let part = folder.join(part);
        fs::remove_dir_all(&part).map_err(|source| Error::Io { path: part.clone(), source })?;
    }
    georeference(path, origin)
}

/// True for the name of streamed SOG.
pub fn is_levels(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == sog::LEVELS)
}

/// The bytes of a file in the format of its extension, which stores values as finely as `precision` says; if that is another format's,
/// as finely as the format allows. SPZ gets this version. The model must have no SH beyond the precision's degree.
///
/// # Errors
/// [`Error::Unsupported`] for another extension or for what the format cannot hold, [`Error::Inconsistent`].
pub fn encode(
    path: &Path,
    gaussians: &Gaussians,
    place: (RenderMode, [f64; 3]),
    how: (Precision, SpzVersion),
) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    body(path, gaussians, place, Some(how))?(&mut bytes)
        .map_err(|source| Error::Io { path: path.to_owned(), source })?;
    Ok(bytes)
}

/// The bytes of an SPZ file; `name` stands in messages.
///
/// # Errors
/// [`Error::Unsupported`] for what SPZ cannot hold, [`Error::Inconsistent`].
pub fn spz(gaussians: &Gaussians, mode: RenderMode, version: SpzVersion, name: &Path) -> Result<Vec<u8>, Error> {
    gaussians.validate()?;
    let usual = usual(Path::new("model.spz"), gaussians).of_spz();
    super::spz::pack(gaussians, mode, (version, usual)).map_err(|fault| fault.at(name))
}
