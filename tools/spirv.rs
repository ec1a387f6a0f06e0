// Writes glsl/spirv: the SPIR-V of every shader, with a record of the sources that it was made from. With `--check` it
// writes nothing, and fails where a module is not what its shader compiles to. `make spirv` and `make check` run it.

#[path = "compile.rs"]
mod compile;

use compile::{Entry, Record, SHIPPED, file, fingerprint, shaders, source_fingerprint};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs};

fn main() -> ExitCode {
    let check = env::args().any(|a| a == "--check");
    let compiler = match compile::compiler() {
        Ok(compiler) => compiler,
        Err(e) => return fail(&format!("glslc does not start ({e}); run tools/setup")),
    };
    let sources: Vec<PathBuf> = ["glsl", "tools/examples"].iter().flat_map(|f| shaders(Path::new(f))).collect();
    let done = if check { checked(&sources, &compiler) } else { written(&sources, &compiler) };
    match done {
        Ok(line) => {
            println!("spirv: {line}");
            ExitCode::SUCCESS
        }
        Err(line) => fail(&line),
    }
}

fn fail(line: &str) -> ExitCode {
    eprintln!("spirv: {line}");
    ExitCode::FAILURE
}

/// Compiles every shader anew, except unchanged ones that another compiler has made.
fn written(sources: &[PathBuf], compiler: &str) -> Result<String, String> {
    let old = Record::read();
    let mut new = Record::default();
    let mut changed = 0;
    for path in sources {
        let name = file(path);
        let kept = old.0.get(&name).filter(|e| e.compiler != compiler && old.shipped(path).is_some());
        if let Some(entry) = kept {
            new.0.insert(name, entry.clone());
            continue;
        }
        let bytes = compile::compile(path)?;
        let at = Path::new(SHIPPED).join(&name);
        changed += usize::from(fs::read(&at).ok().as_deref() != Some(&bytes));
        fs::write(&at, &bytes).map_err(|e| format!("{}: {e}", at.display()))?;
        let (source, module) = (source_fingerprint(path), fingerprint(&bytes));
        new.0.insert(name, Entry { source, module, compiler: compiler.to_owned() });
    }
    for path in strays(&new)? {
        fs::remove_file(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    new.write().map_err(|e| format!("{SHIPPED}: {e}"))?;
    Ok(format!("{} modules, {changed} of them changed", new.0.len()))
}

/// Verifies every module against its shader: by the record, and byte for byte if this machine has the same compiler.
fn checked(sources: &[PathBuf], compiler: &str) -> Result<String, String> {
    let record = Record::read();
    let (mut stale, mut compared) = (Vec::new(), 0);
    for path in sources {
        let shipped = record.shipped(path);
        let same = record.0.get(&file(path)).is_some_and(|e| e.compiler == compiler);
        let fresh = match &shipped {
            Some(bytes) if same => *bytes == compile::compile(path)?,
            other => other.is_some(),
        };
        compared += usize::from(same);
        if !fresh {
            stale.push(path.display().to_string());
        }
    }
    let strays = strays(&record)?;
    if !stale.is_empty() || !strays.is_empty() || record.0.len() != sources.len() {
        let stray = strays.iter().map(|p| p.display().to_string());
        let named: Vec<String> = stale.into_iter().chain(stray).collect();
        return Err(format!("{SHIPPED} is not of these sources; run `make spirv`: {}", named.join(", ")));
    }
    let count = sources.len();
    Ok(match count - compared {
        0 => format!("{count} modules are what their shaders compile to"),
        other => format!("{count} modules are of these sources; {other} by another compiler were not compared"),
    })
}

/// Modules that belong to no shader of the record.
fn strays(record: &Record) -> Result<Vec<PathBuf>, String> {
    let folder = fs::read_dir(SHIPPED).map_err(|e| format!("{SHIPPED}: {e}"))?;
    let name = |path: &PathBuf| path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
    let modules = folder.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "spv"));
    Ok(modules.filter(|p| !record.0.contains_key(&name(p))).collect())
}
