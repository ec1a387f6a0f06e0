// Compiles `glsl/**/*.comp` to SPIR-V with shaderc. Part of build.rs.

use crate::generate::Module;
use std::fs;
use std::path::{Path, PathBuf};

/// Every compute shader below `root`, in the order of paths.
pub fn all(root: &Path) -> Vec<Module> {
    let compiler = shaderc::Compiler::new().expect("shaderc starts");
    let module = |path: PathBuf| Module { words: compile(&compiler, root, &path), path };
    shaders(root).into_iter().map(module).collect()
}

fn shaders(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder of shaders is readable").flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(shaders(&path));
        } else if path.extension().is_some_and(|e| e == "comp") {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn compile(compiler: &shaderc::Compiler, root: &Path, path: &Path) -> Vec<u32> {
    let source = fs::read_to_string(path).expect("a shader is readable");
    let mut options = shaderc::CompileOptions::new().expect("shaderc options");
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_2 as u32);
    options.set_target_spirv(shaderc::SpirvVersion::V1_5);
    options.set_optimization_level(shaderc::OptimizationLevel::Zero); // keeps every constant in sight of the reflection
    options.set_warnings_as_errors();
    options.set_include_callback(|name, _, _, _| {
        let file = root.join(name);
        let content = fs::read_to_string(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: file.display().to_string(), content })
    });
    let name = path.display().to_string();
    match compiler.compile_into_spirv(&source, shaderc::ShaderKind::Compute, &name, "main", Some(&options)) {
        Ok(artifact) => artifact.as_binary().to_vec(),
        Err(e) => panic!("{e}"),
    }
}
