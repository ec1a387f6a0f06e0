//! USDZ: a zip archive without compression, whose first file is the layer, each file at a multiple of 64 bytes.

use std::io::Cursor;
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, System, ZipArchive, ZipWriter};

use super::super::{Gaussians, RenderMode, crc32, stays_within};
use super::{AGAIN, Fault, Parsed, binary, malformed, read, write};
use crate::wording::shown;

/// Multiple at which the bytes of each file begin.
const ALIGNMENT: u16 = 64;

/// A package of one text layer.
pub(in super::super) fn package(model: &Gaussians, mode: RenderMode, origin: [f64; 3]) -> Result<Vec<u8>, Fault> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let options = stored.with_alignment(ALIGNMENT).system(System::Unix); // on Windows, too: the same bytes
    let failed = |error: &dyn std::fmt::Display| Fault::Unsupported(format!("cannot be packed ({error}); write .usda"));
    archive.start_file("splat.usda", options).map_err(|error| failed(&error))?;
    write(&mut archive, model, mode, origin).map_err(|error| failed(&error))?;
    Ok(archive.finish().map_err(|error| failed(&error))?.into_inner())
}

/// Reads a package's first layer.
pub(in super::super) fn read_package(bytes: &[u8]) -> Result<Parsed, Fault> {
    let damaged = |what: String| malformed("zip archive", format!("{what}; {AGAIN}"));
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged(error.to_string()))?;
    let entry = archive.by_index(0).map_err(|error| damaged(error.to_string()))?;
    if entry.compression() != CompressionMethod::Stored {
        return Err(damaged("its first file is compressed, which USDZ forbids".into()));
    }
    // Nothing is unpacked, but other programs would write such a file outside of their folder.
    let name = String::from_utf8_lossy(entry.name_raw());
    let has_drive = name.as_bytes().get(1) == Some(&b':');
    if !stays_within(Path::new(&name.replace('\\', "/"))) || has_drive {
        let name = shown(&name, 80);
        return Err(damaged(format!("its first file has the name `{name}`, which leads out of the archive")));
    }
    // A stored file is a part of the archive, which is read where it lies.
    let part = || {
        let start = usize::try_from(entry.data_start()?).ok()?;
        bytes.get(start..)?.get(..usize::try_from(entry.size()).ok()?)
    };
    let layer = part().ok_or_else(|| damaged("its first file is cut short".into()))?;
    if crc32([layer]) != entry.crc32() {
        return Err(damaged("its first file does not have the checksum that the archive states".into()));
    }
    if layer.starts_with(b"PXR-USDC") {
        return Err(binary());
    }
    if !layer.starts_with(b"#usda") {
        return Err(damaged("its first file is not a USD layer".into()));
    }
    read(layer)
}
