// SPIR-V of `glsl/**/*.comp`. The modules lie in `glsl/spirv`, so that whoever builds the crate needs no shader
// compiler; `record.txt` there tells which sources each was made from. A shader that was edited since then is compiled
// with glslc. Part of build.rs and of tools/spirv.rs, which writes that folder.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{fs, io};

/// Folder of the shipped modules and their record.
pub const SHIPPED: &str = "glsl/spirv";
const INCLUDES: &str = "glsl";
/// Vulkan 1.2 is the floor of gpu/choose/properties.rs. Unoptimised modules keep every name and constant that the reflection
/// reads.
const FLAGS: [&str; 5] = ["-fshader-stage=compute", "--target-env=vulkan1.2", "--target-spv=spv1.5", "-O0", "-Werror"];

/// One shader as SPIR-V.
pub struct Module {
    /// Its source: `glsl/ROOM/STAGE.comp`.
    pub path: PathBuf,
    pub words: Vec<u32>,
}

impl Module {
    pub fn stem(&self) -> &str {
        stem(&self.path)
    }

    pub fn room(&self) -> &str {
        room(&self.path)
    }

    /// Name of its file in OUT_DIR and in `glsl/spirv`.
    pub fn file(&self) -> String {
        file(&self.path)
    }
}

fn stem(path: &Path) -> &str {
    path.file_stem().and_then(|s| s.to_str()).expect("a shader's name is UTF-8")
}

fn room(path: &Path) -> &str {
    path.parent().and_then(|p| p.file_name()).and_then(|s| s.to_str()).expect("a shader's folder")
}

/// Name of a shader's module.
pub fn file(path: &Path) -> String {
    format!("{}-{}.spv", room(path), stem(path))
}

/// Every compute shader below `root`, in the order of paths: shipped, or compiled where it was edited.
pub fn all(root: &Path) -> Vec<Module> {
    let record = Record::read();
    let mut edited = Vec::new();
    let module = |path: PathBuf| {
        let bytes = record.shipped(&path).unwrap_or_else(|| {
            edited.push(path.display().to_string());
            compile(&path).unwrap_or_else(|e| fail(&e))
        });
        Module { words: words(&bytes), path }
    };
    let modules = shaders(root).into_iter().map(module).collect();
    if !edited.is_empty() {
        let edited = edited.join(", ");
        println!("cargo::warning={edited}: edited since {SHIPPED} was made; run `make spirv` before you commit");
    }
    modules
}

/// Ends the build with an error that cargo shows.
fn fail(text: &str) -> ! {
    text.lines().for_each(|line| println!("cargo::error={line}"));
    std::process::exit(1)
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// Paths of the compute shaders below a folder, sorted.
pub fn shaders(folder: &Path) -> Vec<PathBuf> {
    files(folder, &["comp"])
}

/// Paths of the compute shaders and their includes below a folder, sorted.
pub fn sources(folder: &Path) -> Vec<PathBuf> {
    files(folder, &["comp", "glsl"])
}

fn files(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder of shaders is readable").flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(files(&path, extensions));
        } else if path.extension().is_some_and(|e| extensions.iter().any(|known| e == *known)) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The bytes of a shader's module, by glslc.
pub fn compile(path: &Path) -> Result<Vec<u8>, String> {
    let shown = path.display();
    let output = Command::new("glslc").args(FLAGS).args(["-I", INCLUDES, "-o", "-"]).arg(path).output();
    let output = output.map_err(|e| {
        format!("{shown} was edited since {SHIPPED} was made, and glslc, which compiles it, does not start ({e}); install glslc, or run tools/setup")
    })?;
    if output.status.success() { Ok(output.stdout) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

/// Version of this machine's glslc.
pub fn compiler() -> io::Result<String> {
    let output = Command::new("glslc").arg("--version").output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let parts = text.lines().filter(|l| l.starts_with("shaderc ") || l.starts_with("glslang "));
    Ok(parts.collect::<Vec<_>>().join(", "))
}

/// The record of one shipped module.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Fingerprint of its source and of everything that this includes.
    pub source: u64,
    pub module: u64,
    pub compiler: String,
}

/// The shipped modules by file name.
#[derive(Default)]
pub struct Record(pub BTreeMap<String, Entry>);

impl Record {
    fn path() -> PathBuf {
        Path::new(SHIPPED).join("record.txt")
    }

    /// Reads the record; malformed lines, such as a merge leaves, are ignored.
    pub fn read() -> Self {
        let text = fs::read_to_string(Self::path()).unwrap_or_default();
        let entry = |line: &str| {
            let mut parts = line.splitn(4, ' ');
            let (file, source, module) = (parts.next()?, parts.next()?, parts.next()?);
            let number = |text| u64::from_str_radix(text, 16).ok();
            let compiler = parts.next()?.to_owned();
            Some((file.to_owned(), Entry { source: number(source)?, module: number(module)?, compiler }))
        };
        Self(text.lines().filter_map(entry).collect())
    }

    pub fn write(&self) -> io::Result<()> {
        let mut text = String::new();
        for (file, Entry { source, module, compiler }) in &self.0 {
            let _ = writeln!(text, "{file} {source:016x} {module:016x} {compiler}");
        }
        fs::write(Self::path(), text)
    }

    /// The shipped module of a shader; none if either has changed since they were recorded.
    pub fn shipped(&self, path: &Path) -> Option<Vec<u8>> {
        let entry = self.0.get(&file(path))?;
        let bytes = fs::read(Path::new(SHIPPED).join(file(path))).ok()?;
        (entry.source == source_fingerprint(path) && entry.module == fingerprint(&bytes)).then_some(bytes)
    }
}

/// FNV-1a.
pub fn fingerprint(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

/// Fingerprint of a shader's text and of everything that it includes.
pub fn source_fingerprint(path: &Path) -> u64 {
    let mut seen = vec![path.to_owned()];
    let mut text = String::new();
    let mut at = 0;
    while let Some(file) = seen.get(at) {
        let own = fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        for line in own.lines() {
            text.push_str(line);
            text.push('\n');
            if let Some(name) = line.trim().strip_prefix("#include \"").and_then(|l| l.split('"').next()) {
                let included = Path::new(INCLUDES).join(name);
                if !seen.contains(&included) {
                    seen.push(included);
                }
            }
        }
        at += 1;
    }
    fingerprint(text.as_bytes())
}
