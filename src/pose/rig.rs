//! Rigs: cameras that stand still to each other and take their photos at once, each into a folder of its own. COLMAP 3.12 and
//! later keep them together.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::Deserialize;
use serde_json::json;

use crate::job::Error;
use crate::scene;

/// COLMAP's file of rigs, beside the photos or beside their folder.
pub(super) const FILE: &str = "rig_config.json";

/// A rig as the file has it; the rest of it is COLMAP's.
#[derive(Deserialize)]
struct Listed {
    cameras: Vec<Camera>,
}

#[derive(Deserialize)]
struct Camera {
    image_prefix: String,
    #[serde(default)]
    ref_sensor: bool,
    cam_from_rig_rotation: Option<[f64; 4]>,
    cam_from_rig_translation: Option<[f64; 3]>,
}

/// The rigs that took some photos.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// The file.
    pub text: String,
    /// The beginnings of the names of each camera's photos.
    pub cameras: Vec<String>,
    /// True if the file says how the cameras stand to each other.
    pub known: bool,
    /// Focal lengths and principal point in pixels of all cameras, if they are known pinholes.
    pub lens: Option<[f64; 4]>,
}

impl Rig {
    /// The rigs of a folder of photos: those of its file, or, if they are asked for, folders side by side with photos of the same
    /// names.
    ///
    /// # Errors
    /// A file that is no configuration of rigs, or names no photos; [`Error::Usage`] if rigs are asked for, and there are none.
    pub fn of(folder: &Path, names: &[String], asked: bool) -> Result<Option<Self>, Error> {
        let places = [Some(folder), folder.parent()].into_iter().flatten().map(|at| at.join(FILE));
        if let Some(path) = places.into_iter().find(|path| path.is_file()) {
            let text = scene::read_text(&path)?;
            let wrong = |(record, what): (String, String)| scene::Error::malformed(&path, record, what).into();
            return Self::read(text, names).map(Some).map_err(wrong);
        }
        if !asked {
            return Ok(None);
        }
        let rigs = side_by_side(names);
        if rigs.is_empty() {
            return Err(Error::Usage(format!(
                "--rig: no folders side by side in {} hold photos with the same names; give each camera a folder, and photos taken \
                 at the same time the same name, or write {FILE}",
                folder.display()
            )));
        }
        let camera = |(i, prefix): (usize, &String)| match i {
            0 => json!({ "image_prefix": prefix, "ref_sensor": true }),
            _ => json!({ "image_prefix": prefix }),
        };
        let rig =
            |prefixes: &Vec<String>| json!({ "cameras": prefixes.iter().enumerate().map(camera).collect::<Vec<_>>() });
        let text = format!("{:#}\n", json!(rigs.iter().map(rig).collect::<Vec<_>>()));
        Ok(Some(Self { text, cameras: rigs.concat(), known: false, lens: None }))
    }

    /// Reads the file; a fault is its record and what is wrong.
    fn read(text: String, names: &[String]) -> Result<Self, (String, String)> {
        let rigs: Vec<Listed> =
            serde_json::from_str(&text).map_err(|e| ("the file".to_owned(), format!("is not a list of rigs: {e}")))?;
        for (n, rig) in (1..).zip(&rigs) {
            if rig.cameras.iter().filter(|camera| camera.ref_sensor).count() != 1 {
                return Err((format!("rig {n}"), "needs one camera with \"ref_sensor\": true".to_owned()));
            }
        }
        let cameras = || rigs.iter().flat_map(|rig| &rig.cameras);
        if let Some(lost) = cameras().find(|c| !names.iter().any(|name| name.starts_with(&c.image_prefix))) {
            return Err((format!("camera {:?}", lost.image_prefix), "has no photo whose name begins so".to_owned()));
        }
        let placed = |c: &Camera| c.cam_from_rig_rotation.is_some() && c.cam_from_rig_translation.is_some();
        let known = cameras().all(|camera| camera.ref_sensor || placed(camera));
        let cameras = cameras().map(|camera| camera.image_prefix.clone()).collect();
        Ok(Self { text, cameras, known, lens: None })
    }

    /// The number of a photo's camera in the rigs.
    pub fn camera_of(&self, name: &str) -> Option<usize> {
        self.cameras.iter().position(|prefix| name.starts_with(prefix))
    }

    /// The cameras, for the user.
    pub fn told(&self) -> String {
        let stands = if self.known { "as the file places them" } else { "as the photos show them to stand" };
        format!("a rig of {} cameras ({}), {stands}", self.cameras.len(), self.cameras.join(", "))
    }
}

/// The hint for photos that a rig may have taken, as far as names tell.
pub(super) fn hint(names: &[String]) -> Option<String> {
    let rigs = side_by_side(names);
    // The folders of a camera's card count on.
    let card = |prefix: &String| {
        let folder = prefix.trim_end_matches('/').rsplit('/').next().unwrap_or_default();
        folder.len() == 8 && folder.bytes().take(3).all(|b| b.is_ascii_digit())
    };
    let rig = rigs.into_iter().find(|rig| !rig.iter().any(card))?;
    Some(format!(
        "photos in {} have the same names: if a rig took them at the same time, --rig keeps its cameras together",
        rig.join(" and ")
    ))
}

/// Groups of folders of one parent, with `/` at their ends, that share at least half of their names with the first of them.
fn side_by_side(names: &[String]) -> Vec<Vec<String>> {
    let mut parents: BTreeMap<&str, BTreeMap<&str, BTreeSet<&str>>> = BTreeMap::new();
    for name in names {
        let Some((folder, file)) = name.rsplit_once('/') else { continue };
        let parent = folder.rsplit_once('/').map_or("", |(parent, _)| parent);
        parents.entry(parent).or_default().entry(folder).or_default().insert(file);
    }
    let rig = |folders: BTreeMap<&str, BTreeSet<&str>>| {
        let first = folders.values().next()?.clone();
        let shares = |files: &BTreeSet<&str>| 2 * files.intersection(&first).count() >= files.len().max(first.len());
        let rig: Vec<String> =
            folders.into_iter().filter(|(_, files)| shares(files)).map(|(folder, _)| format!("{folder}/")).collect();
        (rig.len() > 1).then_some(rig)
    };
    parents.into_values().filter_map(rig).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folders: &[&str], photos: usize) -> Vec<String> {
        folders.iter().flat_map(|f| (0..photos).map(move |i| format!("{f}/{i:04}.jpg"))).collect()
    }

    #[test]
    fn folders_of_the_same_names_are_cameras_of_a_rig() {
        let rigs = side_by_side(&[names(&["a/left", "a/right"], 4), names(&["b/left"], 4), names(&["c"], 2)].concat());
        assert_eq!(rigs, [["a/left/", "a/right/"]]);
        let rig = Rig::of(Path::new("nowhere"), &names(&["left", "right"], 3), true).unwrap().unwrap();
        assert!(!rig.known && rig.camera_of("right/0001.jpg") == Some(1) && rig.camera_of("up/1.jpg").is_none());
        let again = Rig::read(rig.text.clone(), &names(&["left", "right"], 1)).unwrap();
        assert_eq!(again, rig);
        assert!(hint(&names(&["cam0", "cam1"], 3)).is_some_and(|h| h.contains("cam0/ and cam1/")));
        assert_eq!(hint(&names(&["DCIM/100CANON", "DCIM/101CANON"], 3)), None);
        assert_eq!(hint(&names(&["cam0", "cam1"], 0)), None);
        // Unlike numbers of photos, and names that differ.
        assert!(side_by_side(&[names(&["a"], 9), names(&["b"], 3)].concat()).is_empty());
        let asked = Rig::of(Path::new("nowhere"), &names(&["a"], 9), true);
        assert!(matches!(asked, Err(Error::Usage(_))));
        assert_eq!(Rig::of(Path::new("nowhere"), &names(&["a", "b"], 9), false).unwrap(), None);
    }

    #[test]
    fn the_file_is_read_or_refused_with_its_record() {
        let photos = names(&["l", "r"], 2);
        let placed = r#"[{"cameras": [{"image_prefix": "l/", "ref_sensor": true}, {"image_prefix": "r/",
            "cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0.1, 0, 0]}]}]"#;
        assert!(Rig::read(placed.to_owned(), &photos).unwrap().known);
        let fault = |text: &str| Rig::read(text.to_owned(), &photos).unwrap_err();
        assert_eq!(fault("{}").0, "the file");
        assert_eq!(fault(&placed.replace("true", "false")).0, "rig 1");
        assert_eq!(fault(&placed.replace("r/", "up/")).0, "camera \"up/\"");
    }
}
