//! Parts of paths: extensions of file names, in any case, and folders.

use std::path::Path;

/// The extension of a name, in small letters; empty without one.
pub fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

/// True if a name has one of these extensions, given in small letters.
pub fn has_extension(path: &Path, known: &[&str]) -> bool {
    known.contains(&extension(path).as_str())
}

/// The folder in which a file lies: `.` for a bare name, whose parent is the empty path, which cannot be listed or opened.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bare_names_lie_in_the_current_folder() {
        let folders = ["a.ply", "./a.ply", "b/a.ply", "/a.ply"].map(|path| folder_of(Path::new(path)));
        assert_eq!(folders, [".", ".", "b", "/"].map(Path::new));
    }
}
