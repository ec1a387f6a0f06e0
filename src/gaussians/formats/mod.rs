//! Readers and writers of model files.
//!
//! Read: standard 3DGS PLY, PlayCanvas compressed PLY, SPZ 1 to 4, antimatter15 `.splat`, mkkellogg `.ksplat`, SOG 1
//! and 2 (folder or bundle), glTF, USD. Written: PLY, compressed PLY, SPZ, SOG, glTF and USD. Every reader sees one slice of bytes, checks counts against its
//! length before it allocates, and never panics.

mod axes;
mod bytes;
mod clipped;
mod fault;
mod georeference;
mod gltf;
mod gzip;
mod ksplat;
mod limit;
mod linear;
mod output;
mod parts;
mod ply;
mod precision;
mod render_mode;
mod repairs;
mod sog;
mod splat;
mod spz;
mod turn;
mod usd;
mod weight;
mod write;

use crate::extension::{extension, has_extension};
use std::borrow::Cow;
use std::fs;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use serde::Serialize;

use super::{Error, Gaussians};
pub use crate::checksum::crc32;
use crate::wording::{counted, named};
pub use clipped::{clip_warning, clipped, outsized, size_warning};
use fault::Fault;
pub use georeference::georeference;
pub use output::{check_place, refuse_overwrite, remove_leftovers, write_atomically};
pub use parts::parts;
pub use precision::{Ladder, Precision, SogPrecision, SpzPrecision, ladder, unmeasured, usual};
pub use render_mode::RenderMode;
use render_mode::Tag;
pub use repairs::{LOG_SCALE_FLOOR, OPACITY_LOGIT_LIMIT, Repairs};
pub use write::{
    SpzVersion, check_output, encode, is_exact, is_levels, spz, write, write_at, write_levels, written_as,
};

named! {
    /// The kinds of model file that can be read.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Format {
        /// Standard 3DGS PLY: binary of either byte order, or text.
        Ply = "PLY",
        /// PlayCanvas compressed PLY: chunks of 256 Gaussians.
        CompressedPly = "compressed PLY",
        /// Niantic SPZ, versions 1 to 4.
        Spz = "SPZ",
        /// antimatter15 `.splat`: 32 bytes per Gaussian.
        Splat = "splat",
        /// mkkellogg `.ksplat`.
        Ksplat = "ksplat",
        /// PlayCanvas SOG, versions 1 and 2: `meta.json` with WebP textures, in a folder or zipped.
        Sog = "SOG",
        /// glTF 2.0 with `KHR_gaussian_splatting`: `.glb`, or `.gltf` with its files.
        Gltf = "glTF",
        /// OpenUSD's `ParticleField3DGaussianSplat`: text, `.usda`, or zipped, `.usdz`.
        Usd = "USD",
    }
}

/// Name of the file that describes the textures of a SOG model.
const META: &str = "meta.json";
/// The byte order mark of UTF-8, with which some editors begin a text.
const MARK: &[u8] = b"\xef\xbb\xbf";

/// A model as read, with its original format, its mode and its repairs.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The model: every stored value finite, no zero quaternion.
    pub gaussians: Gaussians,
    /// The format found, by content first and by the name's extension second.
    pub format: Format,
    /// Render mode by its tag; plain without a tag.
    pub mode: RenderMode,
    /// Faults of its tags and of its other metadata, as one sentence.
    pub doubt: Option<String>,
    /// The repairs made.
    pub repairs: Repairs,
    /// Numbers of the Gaussians in the file that the repairs removed, ascending.
    pub removed: Vec<usize>,
    /// Local origin of the means in the world: non-zero if the file or a georeference.json beside it says so, or if the file has
    /// doubles or a transform far from zero.
    pub origin: [f64; 3],
}

impl Loaded {
    /// A sentence on what a user should know of the repairs, if anything. In formats of opacities, 0 and 1 are usual,
    /// and their infinite logits are not damage.
    pub fn remark(&self) -> Option<String> {
        let usual = if self.format == Format::Ply { self.repairs.clamped_opacities } else { 0 };
        let told = Repairs { clamped_opacities: usual, ..self.repairs };
        told.any().then(|| told.to_string())
    }
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
    let mut loaded = read_alone(path)?;
    if loaded.origin == [0.0; 3] {
        let levels = sog_meta(path).filter(|meta| is_levels(meta));
        loaded.origin = georeference::origin(levels.as_deref().unwrap_or(path))?;
    }
    if loaded.gaussians.is_empty() && !loaded.removed.is_empty() {
        let what = "none has finite values and a rotation: the file is damaged; fetch or export it again".to_owned();
        let record = counted(loaded.removed.len(), "Gaussian");
        return Err(Error::Malformed { path: path.to_owned(), record, what });
    }
    Ok(loaded)
}

/// Reads a model as [`read`] does, without a georeference.json.
fn read_alone(path: &Path) -> Result<Loaded, Error> {
    let io = |source| Error::Io { path: path.to_owned(), source };
    let data = fs::metadata(path).map_err(io)?;
    if let Some(meta) = sog_meta(path) {
        let folder = meta.parent().unwrap_or(Path::new(""));
        let parsed = if is_levels(&meta) { sog::read_level(folder, 0) } else { sog::read_folder(folder) };
        return parsed.map(finish).map_err(|fault| fault.at(path));
    }
    if data.is_dir() {
        return Err(Error::Unsupported {
            path: path.to_owned(),
            what: "a folder without the meta.json of a SOG model".into(),
        });
    }
    if data.is_file()
        && let Some(parsed) = ply::read_file(path, data.len()).map_err(io)?
    {
        return Ok(finish(parsed));
    }
    let bytes = fs::read(path).map_err(io)?;
    read_with(&bytes, path, Some(path.parent().unwrap_or(Path::new(""))))
}

/// Reads one level of detail of the model that a `lod-meta.json` describes: 0 is the finest, which [`read`] reads.
///
/// # Errors
/// Those of [`read`].
pub fn read_level(path: &Path, level: usize) -> Result<Gaussians, Error> {
    let parsed = sog::read_level(path.parent().unwrap_or(Path::new("")), level);
    parsed.map(|parsed| finish(parsed).gaussians).map_err(|fault| fault.at(path))
}

/// The `lod-meta.json` or `meta.json` that describes the SOG files beside it, if `path` is one, or a folder that holds one or
/// nothing but a folder that does.
pub fn sog_meta(path: &Path) -> Option<PathBuf> {
    let inside = |folder: &Path| [sog::LEVELS, META].map(|name| folder.join(name)).into_iter().find(|m| m.is_file());
    if path.is_dir() {
        return inside(path).or_else(|| {
            let mut entries = fs::read_dir(path).ok()?;
            let only = entries.next()?.ok()?.path();
            inside(&only).filter(|_| entries.next().is_none())
        });
    }
    path.file_name().filter(|name| *name == sog::LEVELS || *name == META).map(|_| path.to_owned())
}

/// Reads a model from a whole file's bytes; `name` appears in messages and gives the format if the content does not.
pub fn read_bytes(bytes: &[u8], name: &Path) -> Result<Loaded, Error> {
    read_with(bytes, name, None)
}

/// Reads a model as [`read_bytes`] does; `folder` holds the files that a `.gltf` may name.
fn read_with(bytes: &[u8], name: &Path, folder: Option<&Path>) -> Result<Loaded, Error> {
    let zipped = bytes.starts_with(&gzip::MAGIC) && !spz::is_inside(bytes);
    let inner = if zipped && has_extension(name, &["gz"]) { name.with_extension("") } else { name.to_owned() };
    let contents: Result<Cow<'_, [u8]>, Fault> =
        if zipped { unzipped(bytes).map(Cow::Owned) } else { Ok(Cow::Borrowed(bytes)) };
    let parsed = contents.and_then(|bytes| parsed(&bytes, &extension(&inner), folder));
    parsed.map(finish).map_err(|fault| fault.at(name))
}

/// Parses a file that is not packed, by its content first and by its name's extension second.
fn parsed(bytes: &[u8], extension: &str, folder: Option<&Path>) -> Result<Parsed, Fault> {
    let bytes = match bytes {
        [0xef, 0xbb, 0xbf, text @ ..] if ["ply", "usda", "usd", "gltf"].contains(&extension) => text,
        _ => bytes,
    };
    match bytes {
        [b'p', b'l', b'y', b'\r' | b'\n', ..] => ply::read(bytes),
        [0x1f, 0x8b, ..] | [b'N', b'G', b'S', b'P', ..] => spz::read(bytes),
        [b'P', b'K', 3 | 5, 4 | 6, ..] if extension == "usdz" => usd::read_package(bytes),
        [b'P', b'K', 3 | 5, 4 | 6, ..] => sog::read_bundle(bytes),
        [b'#', b'u', b's', b'd', b'a', ..] => usd::read(bytes),
        [b'P', b'X', b'R', b'-', b'U', b'S', b'D', b'C', ..] => Err(usd::binary()),
        [b'g', b'l', b'T', b'F', ..] => gltf::read(bytes, folder),
        [] => Err(fault::malformed("byte 0", "the file is empty; fetch or export it again")),
        _ => match extension {
            "ply" => Err(fault::malformed("header", not_a_ply(bytes))),
            "spz" => Err(fault::malformed("header", "neither gzip nor NGSP at byte 0 as SPZ needs; check the file")),
            "sog" => Err(fault::malformed("header", "a bundled SOG is a zip archive; this is not one; check the file")),
            "glb" => Err(fault::malformed("header", "a GLB file begins with `glTF`; this one does not; check the file")),
            "usda" | "usd" => Err(fault::malformed("header", "a USD text begins with `#usda`; this one does not; check the file")),
            "usdz" => Err(fault::malformed("header", "a USDZ file is a zip archive; this is not one; check the file")),
            "gltf" => gltf::read(bytes, folder),
            "splat" => splat::read(bytes),
            "ksplat" => ksplat::read(bytes),
            _ => Err(Fault::Unsupported(
                "not a model file that this program knows; give a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda \
                 or .usdz file, or a folder with a SOG meta.json"
                    .into(),
            )),
        },
    }
}

/// The fault of a file that is called a PLY and does not begin like one.
fn not_a_ply(bytes: &[u8]) -> String {
    let packers: [(&[u8], &str); 3] = [(b"BZh", "bzip2"), (b"\xfd7zXZ\0", "xz"), (b"\x28\xb5\x2f\xfd", "zstd")];
    match packers.iter().find(|(magic, _)| bytes.starts_with(magic)) {
        Some((_, packer)) => format!("it is compressed by {packer}: unpack it first"),
        None => "a PLY file begins with the line `ply`; this one does not; check the file".to_owned(),
    }
}

/// The contents of a gzip file that is no SPZ.
fn unzipped(bytes: &[u8]) -> Result<Vec<u8>, Fault> {
    let most = limit::most(bytes.len());
    let mut contents = Vec::new();
    let ended = gzip::Members::new(bytes).take(most + 1).read_to_end(&mut contents);
    match ended {
        Ok(_) if contents.len() as u64 > most => {
            let what = format!(
                "{} bytes of gzip that unpack to more than {most}; unpack them if you trust the file",
                bytes.len()
            );
            Err(fault::malformed("byte 0", what))
        }
        Ok(_) if !contents.starts_with(&gzip::MAGIC) => Ok(contents),
        Ok(_) => Err(fault::malformed("byte 0", "compressed by gzip twice; unpack it once")),
        Err(e) => Err(fault::malformed("byte 0", format!("compressed by gzip, and damaged: {e}; fetch it again"))),
    }
}

/// Applies the repairs that all formats share.
fn finish(parsed: Parsed) -> Loaded {
    let Parsed { mut gaussians, format, tag, trailing_bytes } = parsed;
    let (mut repairs, removed) = repairs::repair(&mut gaussians);
    repairs.trailing_bytes = trailing_bytes;
    Loaded { gaussians, format, mode: tag.mode, doubt: tag.doubt, repairs, removed, origin: tag.origin }
}

/// True if a path that a file names, or an archive contains, stays within its folder.
fn stays_within(path: &Path) -> bool {
    let within = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
    !path.as_os_str().is_empty() && path.components().all(within)
}

/// True if a name has the extension of a model.
pub fn is_model_name(path: &Path) -> bool {
    has_extension(path, &["ply", "spz", "splat", "ksplat", "sog", "glb", "gltf", "usd", "usda", "usdz"])
}
