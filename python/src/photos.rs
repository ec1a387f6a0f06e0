//! Photos of scenes, as arguments choose them.

use crate::arrays::Resolution;
use crate::errors::wrong;
use engine::job::Selection;
use pyo3::prelude::*;
use std::path::PathBuf;

/// A scene and which of its photos count, at what size.
#[derive(Default)]
pub struct Photos {
    pub scene: Option<PathBuf>,
    pub images: Option<PathBuf>,
    pub resolution: Option<Resolution>,
    /// Every n-th photo is held out.
    pub eval_every: Option<usize>,
    pub background: Option<[f32; 3]>,
}

impl Photos {
    /// The photos of the scene; none without one.
    ///
    /// # Errors
    /// ValueError for arguments of photos without a scene.
    pub fn selection(self) -> PyResult<Option<Selection>> {
        let Self { scene, images, resolution, eval_every, background } = self;
        let Some(scene) = scene else {
            let given = [
                ("images", images.is_some()),
                ("resolution", resolution.is_some()),
                ("eval_every", eval_every.is_some()),
            ];
            return match given.into_iter().find(|(_, given)| *given) {
                Some((name, _)) => Err(wrong(format!("{name} is of a scene's photos: give a scene, or leave it out"))),
                None => Ok(None),
            };
        };
        let usual = Selection::of(scene);
        let (resolution, eval_every) = (resolution.map(|r| r.0), eval_every.unwrap_or(usual.eval_every));
        Ok(Some(Selection { images, resolution, eval_every, background, ..usual }))
    }
}
