//! The folder of a synthetic scene; folders with other data are refused.

use std::{fs, io, path::Path};

use serde_json::{Value, json};

use super::{Error, Kind, SynthOptions, path::View};

/// Name of the file that marks a synth scene and records its options.
pub(super) const MARK: &str = "synth.json";
const MADE_BY: &str = "qirf-vk synth";
/// Greatest size of the mark in bytes: the mark of 9,999 photos has 2 MB.
const MARK_LIMIT: u64 = 16 << 20;

/// Makes the folder, or empties an earlier synth scene of its photos, masks and depth maps; other files in it are left alone.
pub(super) fn prepare(dir: &Path) -> Result<(), Error> {
    match fs::metadata(dir) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {}
        Err(e) => return Err(Error::io(dir)(e)),
        Ok(data) if !data.is_dir() => return Err(Error::NotFolder(dir.to_path_buf())),
        Ok(_) => {
            if fs::read_dir(dir).map_err(Error::io(dir))?.next().is_some() {
                let views = earlier_views(dir).ok_or_else(|| Error::Foreign(dir.to_path_buf()))?;
                for (folder, ending) in [("images", ".png"), ("masks", ".png"), ("depth", ".npy")] {
                    clear(&dir.join(folder), ending, views)?;
                }
                // Fails if the folder holds the user's files.
                let _ = fs::remove_dir(dir.join("masks"));
                let _ = fs::remove_dir(dir.join("depth"));
            }
        }
    }
    for sub in ["images", "sparse/0"] {
        let path = dir.join(sub);
        fs::create_dir_all(&path).map_err(Error::io(&path))?;
    }
    Ok(())
}

/// Number of photos of the synth scene in the folder; none if it holds no synth scene.
fn earlier_views(dir: &Path) -> Option<u64> {
    let path = dir.join(MARK);
    if fs::metadata(&path).ok()?.len() > MARK_LIMIT {
        return None;
    }
    let mark: Value = serde_json::from_slice(&fs::read(&path).ok()?).ok()?;
    (mark["made_by"] == MADE_BY).then(|| mark["options"]["views"].as_u64())?
}

/// Removes the pictures that an earlier run with this many views wrote.
fn clear(folder: &Path, ending: &str, views: u64) -> Result<(), Error> {
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        other => other.map_err(Error::io(folder))?,
    };
    for entry in entries {
        let entry = entry.map_err(Error::io(folder))?;
        let name = entry.file_name();
        let number = |n: &str| n.strip_prefix("view_")?.strip_suffix(ending)?.parse::<u64>().ok();
        let own = |i: u64| super::path::file_name(i as usize).replace(".png", ending);
        if name.to_str().and_then(number).is_some_and(|i| i < views && own(i).as_str() == name) {
            fs::remove_file(entry.path()).map_err(Error::io(&entry.path()))?;
        }
    }
    Ok(())
}

/// Writes the mark: before the photos, so that a broken run can be repeated, and again after them.
pub(super) fn mark(dir: &Path, options: &SynthOptions, views: &[View], complete: bool) -> Result<(), Error> {
    let effects: Vec<_> = options.sorted_effects().iter().map(|e| e.name()).collect();
    let photos: Vec<_> = views
        .iter()
        .enumerate()
        .map(|(i, v)| json!({"name": v.name, "test": View::is_test(i), "camera": v.device + 1, "gain": v.gain}))
        .collect();
    let mut text = json!({
        "made_by": MADE_BY,
        "version": 1,
        "complete": complete,
        "options": {
            "views": options.views, "width": options.width, "height": options.height,
            "seed": options.seed, "points": options.points, "effects": effects,
        },
        "gain": "factors on the finished red, green and blue (after the tone curve), clipped at white",
        "masks": "black (0) = ignore",
        "photos": photos,
    });
    if options.kind != Kind::default() {
        text["options"]["kind"] = options.kind.name().into();
    }
    if let Some(lens) = &options.lens {
        text["options"]["lens"] = lens.to_string().into();
    }
    let path = dir.join(MARK);
    fs::write(&path, format!("{text:#}\n")).map_err(Error::io(&path))
}
