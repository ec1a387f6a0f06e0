//! Shared by the fuzz targets and the tests: a good file of every format, its reader, and the conditions that must
//! hold.

#[path = "../support/files/mod.rs"]
#[allow(dead_code)] // the fuzz targets use its readers
mod files;

pub use files::corpus;

/// A fuzz target that hands its bytes to the reader of one input of the corpus, in that input's folder of good files.
#[macro_export]
macro_rules! reader {
    ($name:literal) => {
        use std::sync::LazyLock;

        static INPUT: LazyLock<($crate::corpus::Input, tempfile::TempDir)> = LazyLock::new(|| {
            let input = $crate::corpus::inputs().into_iter().find(|i| i.name == $name).expect("an input of this name");
            let folder = tempfile::tempdir().expect("a temporary folder");
            input.prepare(folder.path());
            (input, folder)
        });

        libfuzzer_sys::fuzz_target!(|data: &[u8]| {
            let (input, folder) = &*INPUT;
            input.read(data, folder.path());
        });
    };
}
