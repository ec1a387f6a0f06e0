//! Writers of model files, by the extension of their name.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::{Format, Precision, RenderMode, georeference, gltf, ply, sog, usd, usual, write_atomically};
use crate::extension::extension;
use crate::gaussians::{Error, Gaussians};

/// The format of a written file, by its name.
#[derive(Clone, Copy)]
pub(super) enum Written {
    Ply,
    CompressedPly,
    Spz,
    Sog,
    Glb,
    Usda,
    Usdz,
}

impl Written {
    pub(super) fn of(path: &Path) -> Result<Self, Error> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        Ok(match extension(path).as_str() {
            "ply" if name.ends_with(".compressed.ply") => Self::CompressedPly,
            "ply" => Self::Ply,
            "spz" => Self::Spz,
            "sog" => Self::Sog,
            "glb" => Self::Glb,
            "usda" => Self::Usda,
            "usdz" => Self::Usdz,
            _ => {
                return Err(Error::Unsupported {
                    path: path.to_owned(),
                    what:
                        "models are written as .ply, .compressed.ply, .spz, .sog, .glb, .usda or .usdz; give the output one of \
                         these extensions"
                            .into(),
                });
            }
        })
    }
}

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
    Written::of(path).map(drop)
}

/// The format of a file of this name; none if no writer knows its extension.
pub fn written_as(path: &Path) -> Option<Format> {
    Written::of(path).ok().map(|written| match written {
        Written::Ply => Format::Ply,
        Written::CompressedPly => Format::CompressedPly,
        Written::Spz => Format::Spz,
        Written::Sog => Format::Sog,
        Written::Glb => Format::Gltf,
        Written::Usda | Written::Usdz => Format::Usd,
    })
}

/// True for formats that store floats, so that their pictures are those of the model.
pub fn is_exact(path: &Path) -> bool {
    !matches!(Written::of(path), Ok(Written::CompressedPly | Written::Spz | Written::Sog))
}

/// Writes `gaussians` to `path` in the format of its extension: `.ply` (bit-exact), `.glb`, `.usda` or
/// `.usdz` (exact but for rounding exponentials and unit quaternions), `.spz` (version 4), `.sog` or `.compressed.ply` (quantised as [`usual`]), completely or not
/// at all; with the tag of `mode`. SOG and compressed PLY do not keep the order of the Gaussians, SOG not that of their axes either.
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

/// A file in the format of its extension. Formats of few digits are packed now, as [`usual`] unless `how` is given.
fn body<'a>(
    path: &Path,
    gaussians: &'a Gaussians,
    (mode, origin): (RenderMode, [f64; 3]),
    how: Option<(Precision, SpzVersion)>,
) -> Result<Body<'a>, Error> {
    gaussians.validate()?;
    let how = || how.unwrap_or_else(|| (usual(path, gaussians), SpzVersion::default()));
    let packed = match Written::of(path)? {
        Written::Ply => return Ok(Box::new(move |out| ply::write(out, gaussians, mode, origin))),
        Written::CompressedPly => return Ok(Box::new(move |out| ply::write_compressed(out, gaussians, mode, origin))),
        Written::Usda => return Ok(Box::new(move |out| usd::write(out, gaussians, mode, origin))),
        Written::Glb => match gltf::write(gaussians, mode, origin) {
            Ok(body) => return Ok(Box::new(body)),
            Err(fault) => Err(fault),
        },
        Written::Usdz => usd::package(gaussians, mode, origin),
        Written::Spz => {
            let (precision, version) = how();
            super::spz::pack(gaussians, mode, (version, precision.of_spz()))
        }
        Written::Sog => sog::pack(gaussians, mode, &how().0.of_sog()),
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
    let files = sog::pack_levels(levels, mode, &Precision::Fixed.of_sog()).map_err(|fault| fault.at(path))?;
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
