//! georeference.json: the local origins of the models beside it, for formats without a field for it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Error, Format, MARK, write_atomically, written_as};

/// Its name.
const FILE: &str = "georeference.json";

#[derive(Debug, Default, Deserialize, Serialize)]
struct Georeference {
    schema: u32,
    /// Origin of the model written last.
    origin: [f64; 3],
    /// Local origin of each model, by the name of its file.
    #[serde(default)]
    models: BTreeMap<String, [f64; 3]>,
}

impl Georeference {
    /// The georeference beside a model, if there is one; none if it is another program's.
    ///
    /// # Errors
    /// [`Error::Malformed`] for a damaged one: without it, models would lie elsewhere.
    fn beside(path: &Path) -> Result<Option<Self>, Error> {
        let path = file(path);
        if !path.is_file() {
            return Ok(None);
        }
        let bytes = fs::read(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
        let text = bytes.strip_prefix(MARK).unwrap_or(&bytes);
        let what = "is not JSON; restore it, or delete it if the models beside it have no local origin";
        let value: serde_json::Value = serde_json::from_slice(text).map_err(|e| Error::Malformed {
            path,
            record: format!("line {}", e.line()),
            what: what.to_owned(),
        })?;
        Ok(serde_json::from_value(value).ok())
    }
}

fn file(path: &Path) -> PathBuf {
    path.with_file_name(FILE)
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The local origin of the model at `path` as the file beside it lists it; zero if it does not.
pub(super) fn origin(path: &Path) -> Result<[f64; 3], Error> {
    let found = Georeference::beside(path)?.and_then(|found| found.models.get(&name(path)).copied());
    Ok(found.filter(|origin| origin.iter().all(|v| v.is_finite())).unwrap_or_default())
}

/// Writes the local origin of a model to the file beside it; a model without one is removed from there. A damaged file and another
/// program's stay as they are.
///
/// # Errors
/// Such a file, if the model's format has no field for its origin.
pub fn georeference(path: &Path, origin: [f64; 3]) -> Result<(), Error> {
    let has_field = !matches!(written_as(path), Some(Format::Spz | Format::Sog) | None);
    let there = match Georeference::beside(path) {
        Ok(None) if file(path).exists() => {
            let what = "another program's file has the name that the model's local origin needs; choose another folder";
            Err(Error::Unsupported { path: file(path), what: what.to_owned() })
        }
        there => there.map(Option::unwrap_or_default),
    };
    if there.is_err() && (has_field || origin == [0.0; 3]) {
        return Ok(());
    }
    let mut all = there?;
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
        let origin = |name: &str| origin(&at(name)).unwrap();
        assert_eq!(["a.spz", "b.sog", "near.spz"].map(origin), [utm, utm, [0.0; 3]]);
        // Written anew, without a place.
        say("a.spz", [0.0; 3]);
        assert_eq!(["a.spz", "b.sog"].map(origin), [[0.0; 3], utm]);
        say("c.spz", other);
        assert_eq!(["b.sog", "c.spz"].map(origin), [utm, other]);
        let file = file(&at("c.spz"));
        let marked = [MARK, &fs::read(&file).unwrap()].concat();
        fs::write(&file, &marked).unwrap();
        assert_eq!(origin("c.spz"), other);
        // A damaged one, which would move models by map coordinates, is an error; another program's stays as it is.
        fs::write(&file, &marked[..marked.len() / 2]).unwrap();
        assert!(matches!(super::origin(&at("c.spz")), Err(Error::Malformed { .. })));
        assert!(georeference(&at("d.spz"), utm).is_err() && georeference(&at("d.ply"), utm).is_ok());
        fs::write(&file, "{\"crs\": \"EPSG:25832\"}").unwrap();
        assert_eq!(origin("c.spz"), [0.0; 3]);
        assert!(georeference(&at("c.spz"), [0.0; 3]).is_ok() && georeference(&at("c.spz"), utm).is_err());
    }
}
