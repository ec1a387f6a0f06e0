//! What a file is by its extension: a photo, a photo in a format that is not read, a video, an archive.

use crate::extension::has_extension;
use std::path::Path;

/// Extensions of photos, in the order in which they are tried for names without one.
pub(super) const EXTENSIONS: [&str; 16] = [
    "png", "jpg", "jpeg", "JPG", "PNG", "JPEG", "webp", "WEBP", "tif", "tiff", "TIF", "TIFF", "exr", "EXR", "jpe",
    "jfif",
];
/// Extensions, in lower case, of photos that are not read, and their formats.
const UNREAD: [(&str, &str); 37] = [
    ("heic", "HEIC"),
    ("heif", "HEIC"),
    ("hif", "HEIC"),
    ("avif", "AVIF"),
    ("jxl", "JPEG XL"),
    ("jp2", "JPEG 2000"),
    ("j2k", "JPEG 2000"),
    ("jpx", "JPEG 2000"),
    ("bmp", "BMP"),
    ("dib", "BMP"),
    ("gif", "GIF"),
    ("tga", "TGA"),
    ("ppm", "PNM"),
    ("pgm", "PNM"),
    ("pnm", "PNM"),
    ("mpo", "MPO"),
    ("hdr", "HDR"),
    ("psd", "PSD"),
    ("insp", "INSP"),
    ("dng", "DNG"),
    ("cr2", "CR2"),
    ("cr3", "CR3"),
    ("crw", "CRW"),
    ("nef", "NEF"),
    ("nrw", "NRW"),
    ("arw", "ARW"),
    ("sr2", "SR2"),
    ("srw", "SRW"),
    ("raf", "RAF"),
    ("orf", "ORF"),
    ("rw2", "RW2"),
    ("pef", "PEF"),
    ("rwl", "RWL"),
    ("3fr", "3FR"),
    ("iiq", "IIQ"),
    ("x3f", "X3F"),
    ("gpr", "GPR"),
];
/// Extensions of videos.
const VIDEOS: [&str; 13] =
    ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts", "3gp", "wmv", "ts"];
/// Extensions of 360° videos as their cameras write them, of which no panoramas are made here.
const UNSTITCHED: [&str; 2] = ["insv", "360"];
/// Extensions of archives.
const ARCHIVES: [&str; 11] = ["zip", "tar", "gz", "tgz", "bz2", "xz", "txz", "zst", "7z", "rar", "lz4"];

/// True if the path has a photo's extension.
pub(super) fn is_photo_name(path: &Path) -> bool {
    has_extension(path, &EXTENSIONS)
}

/// The format of a path with the extension of photos that are not read.
pub(super) fn unread_format(path: &Path) -> Option<&'static str> {
    UNREAD.iter().find(|(known, _)| has_extension(path, &[known])).map(|(_, format)| *format)
}

/// True if the path has a video's extension.
pub fn is_video_name(path: &Path) -> bool {
    has_extension(path, &VIDEOS)
}

/// True if the path has the extension of a 360° camera's own file.
pub(super) fn is_unstitched_name(path: &Path) -> bool {
    has_extension(path, &UNSTITCHED)
}

/// True if the path has an archive's extension.
pub(super) fn is_archive_name(path: &Path) -> bool {
    has_extension(path, &ARCHIVES)
}
