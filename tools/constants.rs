// Writes the Rust module `kernels::constants` from the constants that shaders share with the host. Part of build.rs.
//
// A constant is shared where a `///` comment, its meaning and reason, stands directly above it:
//
//     /// Decay of the first moment.
//     const float BETA1 = 0.9;
//
// Its value is a plain literal, so that nothing is evaluated here; anything else is an error that names file and line.
// The constants of `glsl/lib/adam.glsl` and of `glsl/train/adam.comp` go to `constants::adam`.

use crate::compile::sources;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// A literal as the shader has it.
enum Value {
    Float(f64),
    Uint(u32),
    Int(i32),
}

struct Shared {
    name: String,
    value: Value,
    doc: Vec<String>,
}

/// The module `constants`, with a module for each file below `root` that shares constants.
pub fn rust(root: &Path) -> String {
    let mut files: BTreeMap<String, (Vec<String>, Vec<Shared>)> = BTreeMap::new();
    for path in sources(root) {
        let shared = parse(&fs::read_to_string(&path).expect("a shader is readable")).unwrap_or_else(|(line, text)| {
            panic!("{}:{line}: below `///` stands `const float|uint|int NAME = literal;`, not `{text}`", path.display())
        });
        if !shared.is_empty() {
            let stem = path.file_stem().and_then(|s| s.to_str()).expect("a shader's name is UTF-8");
            let (paths, all) = files.entry(stem.to_owned()).or_default();
            paths.push(format!("`{}`", path.display()));
            all.extend(shared);
        }
    }
    let mut modules = String::new();
    for (stem, (paths, constants)) in &files {
        let doc = format!("/// Constants of {}.", paths.join(" and "));
        let _ = writeln!(modules, "{doc}\npub mod {stem} {{\n{}}}", module(constants));
    }
    format!(
        "/// Constants that shaders share with the host: as float32 computes with them, and in modules `float64` as written.\npub mod constants {{\n{modules}}}\n"
    )
}

fn module(constants: &[Shared]) -> String {
    let (mut plain, mut double) = (String::new(), String::new());
    for Shared { name, value, doc } in constants {
        let doc = format!("/// {}\n", doc.join("\n/// "));
        let _ = match value {
            // As the shader compiler does: the literal is read as float64, and rounded.
            Value::Float(v) => writeln!(plain, "{doc}pub const {name}: f32 = {v:?}_f64 as f32;")
                .and_then(|()| writeln!(double, "{doc}pub const {name}: f64 = {v:?};")),
            Value::Uint(v) => writeln!(plain, "{doc}pub const {name}: u32 = {v};"),
            Value::Int(v) => writeln!(plain, "{doc}pub const {name}: i32 = {v};"),
        };
    }
    if !double.is_empty() {
        let _ = write!(
            plain,
            "/// The same in float64, for twins and for the host's own arithmetic.\npub mod float64 {{\n{double}}}\n"
        );
    }
    plain
}

/// The shared constants of a file; or the number and text of a line that should have been one.
fn parse(source: &str) -> Result<Vec<Shared>, (usize, String)> {
    let mut constants = Vec::new();
    let mut doc: Vec<String> = Vec::new();
    for (at, line) in source.lines().enumerate() {
        if let Some(text) = line.trim_start().strip_prefix("///") {
            doc.push(text.trim().to_owned());
        } else if !doc.is_empty() {
            let (name, value) = constant(line).ok_or_else(|| (at + 1, line.to_owned()))?;
            constants.push(Shared { name, value, doc: std::mem::take(&mut doc) });
        }
    }
    if doc.is_empty() { Ok(constants) } else { Err((source.lines().count() + 1, "the end of the file".to_owned())) }
}

fn constant(line: &str) -> Option<(String, Value)> {
    let (left, literal) = line.strip_prefix("const ")?.strip_suffix(';')?.split_once(" = ")?;
    let (kind, name) = left.split_once(' ')?;
    if !name.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_') {
        return None;
    }
    let value = match kind {
        "float" if literal.contains(['.', 'e']) => Value::Float(literal.parse().ok()?),
        "uint" => Value::Uint(literal.parse().ok()?),
        "int" => Value::Int(literal.parse().ok()?),
        _ => return None,
    };
    Some((name.to_owned(), value))
}
