//! Kinds of files by their extension: photos, photos in formats that are not read, videos, archives.

use crate::extension::{extension, has_extension};
use std::path::Path;

/// Extensions of photos, in the order in which they are tried for names without one.
pub(super) const EXTENSIONS: [&str; 16] = [
    "png", "jpg", "jpeg", "JPG", "PNG", "JPEG", "webp", "WEBP", "tif", "tiff", "TIF", "TIFF", "exr", "EXR", "jpe",
    "jfif",
];
/// Extensions, in lower case, of photos that are not read. In capitals, each is the name of its format.
const UNREAD: [&str; 28] = [
    "heic", "avif", "bmp", "gif", "tga", "pnm", "mpo", "hdr", "psd", "insp", "dng", "cr2", "cr3", "crw", "nef", "nrw",
    "arw", "sr2", "srw", "raf", "orf", "rw2", "pef", "rwl", "3fr", "iiq", "x3f", "gpr",
];
/// Other extensions of photos that are not read, and their formats.
const UNREAD_AS: [(&str, &str); 9] = [
    ("heif", "HEIC"),
    ("hif", "HEIC"),
    ("jxl", "JPEG XL"),
    ("jp2", "JPEG 2000"),
    ("j2k", "JPEG 2000"),
    ("jpx", "JPEG 2000"),
    ("dib", "BMP"),
    ("ppm", "PNM"),
    ("pgm", "PNM"),
];
/// Extensions of videos.
pub(super) const VIDEOS: [&str; 13] =
    ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts", "3gp", "wmv", "ts"];
/// Extensions of 360° videos as their cameras write them, of which no panoramas are made here.
pub(super) const UNSTITCHED: [&str; 2] = ["insv", "360"];
/// Extensions of archives; the last is Record3D's.
pub(super) const ARCHIVES: [&str; 12] =
    ["zip", "tar", "gz", "tgz", "bz2", "xz", "txz", "zst", "7z", "rar", "lz4", "r3d"];

/// Extensions of archives that hold one file, which may be another archive.
pub(super) const COMPRESSED: [&str; 5] = ["gz", "bz2", "xz", "zst", "lz4"];

/// True if the path has a photo's extension.
pub(super) fn is_photo_name(path: &Path) -> bool {
    has_extension(path, &EXTENSIONS)
}

/// The usual extension of a path's format, which may be spelt otherwise: jpg for photo.JPEG.
pub(super) fn spelt_usually(path: &Path) -> String {
    match extension(path).as_str() {
        "jpeg" | "jpe" | "jfif" => "jpg".to_owned(),
        "tiff" => "tif".to_owned(),
        other => other.to_owned(),
    }
}

/// The format of a path with the extension of photos that are not read.
pub(super) fn unread_format(path: &Path) -> Option<String> {
    let extension = extension(path);
    if UNREAD.contains(&extension.as_str()) {
        return Some(extension.to_uppercase());
    }
    UNREAD_AS.iter().find(|(known, _)| extension == *known).map(|(_, format)| (*format).to_owned())
}

/// True if the path has a video's extension.
pub fn is_video_name(path: &Path) -> bool {
    has_extension(path, &VIDEOS)
}
