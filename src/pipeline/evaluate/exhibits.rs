//! Pictures kept for the report: photo and dense model of a few held-out views.

use super::evaluator::{Evaluator, truth};
use super::pictures::{self, Format};
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::pipeline::prepare::Prepared;
use crate::render::Image;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Largest number of views shown.
const SHOWN: usize = 4;

/// A held-out view to show, and the paths of its pictures below `renders/`; some may be absent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exhibit {
    /// Position in the list of held-out views.
    pub view: usize,
    /// The view's name.
    pub name: String,
    /// The photo at the size of the run, over the background.
    pub photo: PathBuf,
    /// The model before its first prune.
    pub dense: PathBuf,
    /// The model at the end: the picture that is written for every held-out view.
    pub last: PathBuf,
}

/// Chooses the views to show from the names of the held-out views: up to four, spread evenly over the list.
pub fn exhibits(names: &[&str]) -> Vec<Exhibit> {
    let n = names.len();
    let shown = n.min(SHOWN);
    // Midpoints of equal parts of the list.
    let views: Vec<usize> = (0..shown).map(|k| (2 * k + 1) * n / (2 * shown)).collect();
    let below = |folder: &str| views.iter().map(|v| format!("{folder}/{}", names[*v])).collect::<Vec<_>>();
    let (photos, dense) = (below("photos"), below("dense"));
    // One list of all names, so that no picture overwrites another of the same name.
    let all = names.iter().copied().chain(photos.iter().chain(&dense).map(String::as_str));
    let files = pictures::names(all, Format::Png.extension());
    let exhibit = |(k, &view): (usize, &usize)| Exhibit {
        view,
        name: names[view].to_owned(),
        photo: files[n + k].clone(),
        dense: files[n + shown + k].clone(),
        last: files[view].clone(),
    };
    views.iter().enumerate().map(exhibit).collect()
}

fn of(prepared: &Prepared) -> Vec<Exhibit> {
    exhibits(&prepared.test.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>())
}

/// Writes the photos of the views shown below the folder `renders`.
pub fn photos(prepared: &Prepared, renders: &Path) -> Result<(), Error> {
    of(prepared).into_par_iter().try_for_each(|exhibit| {
        let view = &prepared.test[exhibit.view].1;
        let colours = truth(view, prepared.background)?;
        let pixels = colours.as_chunks::<3>().0.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
        let image = Image { width: view.camera.width, height: view.camera.height, pixels };
        pictures::write(&renders.join(exhibit.photo), &image, Format::Png, false)
    })
}

/// Renders the views shown with the dense model, below the folder `renders`, where the report of a resumed run finds
/// them.
pub fn dense(evaluator: &mut Evaluator, model: &Resident, prepared: &Prepared, renders: &Path) -> Result<(), Error> {
    for exhibit in of(prepared) {
        let image = evaluator.render(model, &prepared.test[exhibit.view].1)?;
        pictures::write(&renders.join(exhibit.dense), &image, Format::Png, false)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_spread_and_their_files_never_meet() {
        assert!(exhibits(&[]).is_empty());
        assert_eq!(exhibits(&["one"])[0].photo, Path::new("photos/one.png"));
        let names: Vec<String> = (0..20).map(|i| format!("{i}.jpg")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        assert_eq!(exhibits(&names).iter().map(|e| e.view).collect::<Vec<_>>(), [2, 7, 12, 17]);

        let awkward = ["a.jpg", "dense/a.jpg", "photos/a.png"];
        let shown = exhibits(&awkward);
        let mut files: Vec<_> = shown.iter().flat_map(|e| [&e.photo, &e.dense, &e.last]).collect();
        assert_eq!((shown.len(), files.len()), (3, 9));
        files.sort();
        files.dedup();
        assert_eq!(files.len(), 9);
        assert_eq!(shown[1].last, Path::new("dense/a.png"), "as every held-out view is written");
    }
}
