//! georeference.json: the local origins of the models beside it, for formats without a field for it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Error, write_atomically};

/// Its name.
const FILE: &str = "georeference.json";

#[derive(Debug, Default, Deserialize, Serialize)]
struct Georeference {
    schema: u32,
    /// That of the model written last.
    origin: [f64; 3],
    /// By name of file.
    #[serde(default)]
    models: BTreeMap<String, [f64; 3]>,
}

impl Georeference {
    /// That beside a model, if there is one.
    fn beside(path: &Path) -> Option<Self> {
        serde_json::from_slice(&fs::read(file(path)).ok()?).ok()
    }
}

fn file(path: &Path) -> PathBuf {
    path.with_file_name(FILE)
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The local origin of the model at `path` as the file beside it lists it; zero if it does not.
pub(super) fn origin(path: &Path) -> [f64; 3] {
    let found = Georeference::beside(path).and_then(|found| found.models.get(&name(path)).copied());
    found.filter(|origin| origin.iter().all(|v| v.is_finite())).unwrap_or_default()
}

/// Writes the local origin of a model to the file beside it; a model without one is removed from there.
pub fn georeference(path: &Path, origin: [f64; 3]) -> Result<(), Error> {
    let mut all = Georeference::beside(path).unwrap_or_default();
    if origin != [0.0; 3] {
        all = Georeference { schema: 1, origin, ..all };
        all.models.insert(name(path), origin);
    } else if all.models.remove(&name(path)).is_none() {
        return Ok(());
    }
    let text = format!("{:#}\n", serde_json::json!(all));
    write_atomically(&file(path), |out| out.write_all(text.as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_that_are_named_count_from_there() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (utm, other) = ([500_000.0, 4_649_776.25, 0.0], [1e6, 0.0, 0.0]);
        let say = |name: &str, origin: [f64; 3]| georeference(&at(name), origin).unwrap();
        say("near.spz", [0.0; 3]);
        assert!(!file(&at("near.spz")).exists());
        say("a.spz", utm);
        say("b.sog", utm);
        assert_eq!(["a.spz", "b.sog", "near.spz"].map(|name| origin(&at(name))), [utm, utm, [0.0; 3]]);
        // Written anew, without a place.
        say("a.spz", [0.0; 3]);
        assert_eq!(["a.spz", "b.sog"].map(|name| origin(&at(name))), [[0.0; 3], utm]);
        say("c.spz", other);
        assert_eq!(["b.sog", "c.spz"].map(|name| origin(&at(name))), [utm, other]);
        fs::write(file(&at("c.spz")), "{").unwrap();
        assert_eq!(origin(&at("c.spz")), [0.0; 3]);
    }
}
