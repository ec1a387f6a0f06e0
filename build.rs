//! Turns every `glsl/**/*.comp` into one typed Rust kernel: its bindings, push constants and specialization constants are
//! fields, so that a host that disagrees with its shader does not compile.
//!
//! Three stages, each in a file of its own: SPIR-V of every shader, its reflection, Rust from the reflection.

#[path = "tools/compile.rs"]
#[allow(dead_code)] // tools/spirv.rs uses the rest
mod compile;
#[path = "tools/generate.rs"]
mod generate;
#[path = "tools/reflect.rs"]
mod reflect;

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    for watched in ["glsl", "build.rs", "tools/compile.rs", "tools/generate.rs", "tools/reflect.rs"] {
        println!("cargo::rerun-if-changed={watched}");
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let modules = compile::all(Path::new("glsl"));
    for module in &modules {
        let bytes: Vec<u8> = module.words.iter().flat_map(|w| w.to_le_bytes()).collect();
        fs::write(out.join(module.file()), bytes).expect("OUT_DIR is writable");
    }
    fs::write(out.join("kernels.rs"), generate::kernels(&modules)).expect("OUT_DIR is writable");
}
