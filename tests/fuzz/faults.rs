//! What the fuzz targets share with tests/faults: a good file of every format, its reader, and what must hold.

#[path = "../faults/corpus.rs"]
pub mod corpus;
#[path = "../formats/make.rs"]
#[allow(dead_code)] // this program uses its own part
mod make;
#[path = "../scenes/writers.rs"]
#[allow(dead_code)] // as above
mod writers;

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
