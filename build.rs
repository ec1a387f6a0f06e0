//! Turns every `glsl/**/*.comp` into one typed Rust kernel: its bindings, push constants and specialization constants
//! are fields, so that a host that disagrees with its shader does not compile.
//!
//! Three stages, each in a file of its own: SPIR-V of every shader, its reflection, Rust from the reflection. Constants
//! that shaders share with the host are read from their source.

#[path = "tools/compile.rs"]
#[allow(dead_code)] // tools/spirv.rs uses the rest
mod compile;
#[path = "tools/constants.rs"]
mod constants;
#[path = "tools/generate.rs"]
mod generate;
#[path = "tools/reflect.rs"]
mod reflect;

use std::path::{Path, PathBuf};
use std::{env, fs};

fn main() {
    for watched in
        ["glsl", "build.rs", "tools/compile.rs", "tools/constants.rs", "tools/generate.rs", "tools/reflect.rs"]
    {
        println!("cargo::rerun-if-changed={watched}");
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let sources = Path::new("glsl");
    let modules = compile::all(sources);
    for module in &modules {
        let bytes: Vec<u8> = module.words.iter().flat_map(|w| w.to_le_bytes()).collect();
        fs::write(out.join(module.file()), bytes).expect("OUT_DIR is writable");
    }
    let rust = generate::kernels(&modules) + &constants::rust(sources);
    fs::write(out.join("kernels.rs"), rust).expect("OUT_DIR is writable");
}
