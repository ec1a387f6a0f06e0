#![no_main]
//! The reader of one input of the corpus, in that input's folder of good files. `QIRF_FUZZ_INPUT` names the input.

use faults::corpus::{Input, inputs};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;
use tempfile::TempDir;

static INPUT: LazyLock<(Input, TempDir)> = LazyLock::new(|| {
    let wanted = std::env::var("QIRF_FUZZ_INPUT").unwrap_or_default();
    let mut all = inputs();
    let Some(at) = all.iter().position(|input| input.name == wanted) else {
        let names: Vec<&str> = all.iter().map(|input| input.name.as_str()).collect();
        panic!("QIRF_FUZZ_INPUT='{wanted}' names no input; the inputs are:\n{}", names.join("\n"));
    };
    let input = all.swap_remove(at);
    let folder = tempfile::tempdir().expect("a temporary folder");
    input.prepare(folder.path());
    (input, folder)
});

fuzz_target!(
    init: {
        LazyLock::force(&INPUT);
    },
    |data: &[u8]| {
        let (input, folder) = &*INPUT;
        input.read(data, folder.path());
    }
);
