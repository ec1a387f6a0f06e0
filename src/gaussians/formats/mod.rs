//! Readers and writers of model files.
//!
//! Read: standard 3DGS PLY, PlayCanvas compressed PLY, SPZ 1 to 4, antimatter15 `.splat`, mkkellogg `.ksplat`, SOG 1
//! and 2 (folder or bundle). Written: PLY, SPZ and SOG. Every reader sees one slice of bytes, checks counts against its
//! length before it allocates, and never panics.

mod bytes;
mod fault;
mod ksplat;
mod output;
mod ply;
mod render_mode;
mod repairs;
mod sog;
mod splat;
mod spz;

use std::fmt;
use std::fs;
use std::path::Path;

use serde::Serialize;

use super::{Error, Gaussians};
use fault::Fault;
pub use output::{crc32, refuse_overwrite, remove_leftovers, write_atomically};
pub use render_mode::RenderMode;
use render_mode::Tag;
pub use repairs::{LOG_SCALE_FLOOR, OPACITY_LOGIT_LIMIT, Repairs};

/// The kinds of model file that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// Standard 3DGS PLY: binary of either byte order, or text.
    Ply,
    /// PlayCanvas compressed PLY: chunks of 256 Gaussians.
    CompressedPly,
    /// Niantic SPZ, versions 1 to 4.
    Spz,
    /// antimatter15 `.splat`: 32 bytes per Gaussian.
    Splat,
    /// mkkellogg `.ksplat`.
    Ksplat,
    /// PlayCanvas SOG, versions 1 and 2: `meta.json` with WebP textures, in a folder or zipped.
    Sog,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Spz => "SPZ",
            Self::Splat => "splat",
            Self::Ksplat => "ksplat",
            Self::Sog => "SOG",
        })
    }
}

/// A model as read, with its original format, its mode and its repairs.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The model: every stored value finite, no zero quaternion.
    pub gaussians: Gaussians,
    /// The format found, by content first and by the name's extension second.
    pub format: Format,
    /// How it has to be drawn, as its tag says; plain if it has none.
    pub mode: RenderMode,
    /// What is wrong with its tag, as a sentence.
    pub doubt: Option<String>,
    /// The repairs made.
    pub repairs: Repairs,
}

/// The output of one reader, before the common repairs.
struct Parsed {
    gaussians: Gaussians,
    format: Format,
    tag: Tag,
    /// Bytes after the last record.
    trailing_bytes: u64,
}

/// Reads the model at `path`: a file of any [`Format`], a `meta.json`, or a folder that holds one.
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`] or [`Error::Unsupported`], naming file, record and remedy.
pub fn read(path: &Path) -> Result<Loaded, Error> {
    let io = |source| Error::Io { path: path.to_owned(), source };
    let is_folder = fs::metadata(path).map_err(io)?.is_dir();
    if is_folder && !path.join("meta.json").is_file() {
        return Err(Error::Unsupported {
            path: path.to_owned(),
            what: "a folder without the meta.json of a SOG model".into(),
        });
    }
    if is_folder || path.file_name().is_some_and(|name| name == "meta.json") {
        let folder = if is_folder { path } else { path.parent().unwrap_or(Path::new("")) };
        return sog::read_folder(folder).map(finish).map_err(|fault| fault.at(path));
    }
    let bytes = fs::read(path).map_err(io)?;
    read_bytes(&bytes, path)
}

/// Reads a model from a whole file's bytes; `name` appears in messages and gives the format if the content does not.
///
/// # Errors
/// Those of [`read`].
pub fn read_bytes(bytes: &[u8], name: &Path) -> Result<Loaded, Error> {
    let extension = name.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let parsed = match bytes {
        [b'p', b'l', b'y', b'\r' | b'\n', ..] => ply::read(bytes),
        [0x1f, 0x8b, ..] | [b'N', b'G', b'S', b'P', ..] => spz::read(bytes),
        [b'P', b'K', 3 | 5, 4 | 6, ..] => sog::read_bundle(bytes),
        [] => Err(fault::malformed("byte 0", "the file is empty; fetch or export it again")),
        _ => match extension.as_str() {
            "ply" => Err(fault::malformed("header", "a PLY file begins with a line `ply`, this one does not; check the file")),
            "spz" => Err(fault::malformed("header", "neither gzip nor NGSP at byte 0 as SPZ needs; check the file")),
            "sog" => Err(fault::malformed("header", "a bundled SOG is a zip archive, this is not; check the file")),
            "splat" => splat::read(bytes),
            "ksplat" => ksplat::read(bytes),
            _ => Err(Fault::Unsupported(
                "not a model file that this program knows; give a .ply, .spz, .splat, .ksplat or .sog file, or a folder \
                 with a SOG meta.json"
                    .into(),
            )),
        },
    };
    parsed.map(finish).map_err(|fault| fault.at(name))
}

/// Applies the repairs that all formats share.
fn finish(parsed: Parsed) -> Loaded {
    let Parsed { mut gaussians, format, tag, trailing_bytes } = parsed;
    let mut repairs = repairs::repair(&mut gaussians);
    repairs.trailing_bytes = trailing_bytes;
    Loaded { gaussians, format, mode: tag.mode, doubt: tag.doubt, repairs }
}

/// Refuses a `path` whose extension no writer knows, before any work is done for it.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn check_output(path: &Path) -> Result<(), Error> {
    match path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase().as_str() {
        "ply" | "spz" | "sog" => Ok(()),
        _ => Err(Error::Unsupported {
            path: path.to_owned(),
            what: "models are written as .ply, .spz or .sog; give the output one of these extensions".into(),
        }),
    }
}

/// Writes `gaussians` to `path` in the format of its extension: `.ply` (bit-exact), `.spz` or `.sog` (both quantised),
/// completely or not at all; with the tag of `mode`. SOG does not keep the order of the Gaussians.
///
/// Call [`refuse_overwrite`] first where the model came from a file.
///
/// # Errors
/// [`Error::Unsupported`] for another extension or for what SPZ or SOG cannot hold, [`Error::Inconsistent`],
/// [`Error::Io`].
pub fn write(path: &Path, gaussians: &Gaussians, mode: RenderMode) -> Result<(), Error> {
    gaussians.validate()?;
    check_output(path)?;
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let pack = match extension.as_str() {
        "spz" => spz::pack,
        "sog" => sog::pack,
        _ => return write_atomically(path, |out| ply::write(out, gaussians, mode)),
    };
    let packed = pack(gaussians, mode).map_err(|fault| fault.at(path))?;
    write_atomically(path, |out| out.write_all(&packed))
}
