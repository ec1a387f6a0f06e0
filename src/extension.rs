//! Extensions of file names, in any case.

use std::path::Path;

/// The extension of a name, in small letters; empty without one.
pub fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

/// True if a name has one of these extensions, given in small letters.
pub fn has_extension(path: &Path, known: &[&str]) -> bool {
    known.contains(&extension(path).as_str())
}
