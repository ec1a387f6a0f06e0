//! Readers of the common scene formats, and the assembly of a [`Scene`] from what they read.
//!
//! Readers return only what the files say (`Listing`); photo folders, real photo sizes, undistortion and the order of
//! the views are decided here for all formats. Bad input is refused with its file and record, or skipped and counted;
//! counts in a file are checked against its size before anything is allocated for them.

mod clouds;
mod colmap;
mod depths;
mod files;
mod foreign;
mod instead;
mod kinds;
mod lookup;
mod masks;
mod names;
mod notes;
mod place;
mod point_ply;
pub(super) mod pose;
mod repeated;
mod transforms;
mod tree;

#[cfg(feature = "pipeline")]
pub(crate) use depths::unread_depth_map;
pub use files::read_text;
pub(crate) use files::text_of;
pub use instead::{archive_in, instead};
pub use kinds::is_video_name;
pub use masks::masks_of;
pub(super) use tree::only_unread;
pub use tree::{PhotoTree, photo_names};

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;

use self::place::{Place, Poses};
use super::faces::{self, Cut};
use super::lens::{Lens, LensModel, Pinhole, VISIBLE_DISPLACEMENT};
use super::merge::{merge_copies, merge_repeated};
use super::near;
use super::view::{FOLDED, View};
use super::{Error, Names, OpenOptions, Point, Scene, SceneKind, Skipped};
use crate::wording::counted;

/// The contents of a scene's files.
struct Listing {
    kind: SceneKind,
    root: PathBuf,
    source: PathBuf,
    /// Views with their ids.
    views: Vec<(u32, View)>,
    /// Points, whose tracks refer to views by their ids.
    points: Vec<Point>,
    skipped: Skipped,
    /// The folder of the photos, if it is the capture's own.
    photos: Option<PathBuf>,
    /// Photos of views that were left out.
    left_out: Vec<PathBuf>,
}

impl Scene {
    /// Opens the scene at `path`: its folder, a COLMAP model folder, or a transforms file. Photos may be absent.
    ///
    /// # Errors
    /// [`Error`], with the file and record at fault and what to do. Views without a usable pose and points without a
    /// usable position are left out and counted in [`Scene::skipped`].
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, Error> {
        let Place { root, outer, poses, note } = place::find(path, options).map_err(place::told)?;
        let mut listing = match poses {
            Poses::Colmap(model) => colmap::read(&root, &model, options)?,
            Poses::Transforms(file) => transforms::read(&root, &outer, &file, options)?,
        };
        listing.skipped.choices.extend(note);
        assemble(listing, options)
    }

    /// Finds the scene at `path` as [`Scene::open`] does, and reads nothing.
    ///
    /// # Errors
    /// [`Error::NoPoses`] for a folder of photos alone, with the poses beside them but nothing else; [`Error::NoScene`]; [`Error::Io`].
    pub fn find(path: &Path, options: &OpenOptions) -> Result<(), Error> {
        place::find(path, options).map(|_| ())
    }
}

/// The folder of a capture's photos: the one asked for, its images or its input folder, or the capture itself. Polycam's
/// corrected images come before the others.
pub fn photo_folder(capture: &Path, asked: Option<&Path>) -> Option<PathBuf> {
    let asked = asked.and_then(|asked| files::image_folder(capture, asked).ok());
    let usual = ["corrected_images", "images", "input"].map(|sub| files::child(capture, sub));
    let folders = asked.into_iter().chain(usual).chain([capture.to_owned()]);
    folders.into_iter().find(|folder| !PhotoTree::with_twins(folder).names.is_empty())
}

/// Sorts views, reads their photos' headers, chooses ideal cameras and renumbers tracks.
fn assemble(mut listing: Listing, options: &OpenOptions) -> Result<Scene, Error> {
    let source = listing.source.clone();
    listing.views.sort_by(|(_, a), (_, b)| a.name.cmp(&b.name));
    let mut skipped = listing.skipped;
    let kept = repeated::drop_repeated(listing.views, &source, &mut skipped)?;
    let (ids, mut listed): (Vec<u32>, Vec<View>) = kept.into_iter().unzip();
    repeated::unshare(&listing.root, &mut listed);
    if listed.is_empty() {
        let what = skipped.summary().join("; ");
        let what = if what.is_empty() { "it lists none".to_owned() } else { what };
        return Err(Error::NoViews { path: source, what });
    }
    if let Some(folder) = &listing.photos {
        notes::unposed(folder, (&listed, &listing.left_out), &mut skipped);
    }
    if listed.iter().any(|view| view.mask.is_some()) {
        let mut whole = Names::default();
        listed.iter().filter(|view| !view.is_masked()).for_each(|view| whole.add(&view.name));
        let photos = counted(whole.count, "photo");
        skipped.notes.extend((whole.count > 0).then(|| format!("{photos} without a mask, used as a whole ({whole})")));
    }
    if let Some(asked) = &options.depth {
        find_depths(&files::image_folder(&listing.root, asked)?, &mut listed, &mut skipped);
    }
    skipped.notes.extend(notes::off_middle(&listed));
    let mut numbered = finish(ids.into_iter().zip(listed).collect(), &source, options, &mut skipped)?;
    numbered.sort_by(|(_, a), (_, b)| a.name.cmp(&b.name));
    let mut numbers: HashMap<u32, Vec<u32>> = HashMap::new();
    for (i, (id, _)) in numbered.iter().enumerate() {
        numbers.entry(*id).or_default().push(i as u32);
    }
    let views: Vec<View> = numbered.into_iter().map(|(_, view)| view).collect();
    let mut points = listing.points;
    for point in &mut points {
        let of_views = point.track.iter().filter_map(|id| numbers.get(id));
        skipped.track_entries += point.track.len() - of_views.clone().count();
        let mut track: Vec<u32> = of_views.flatten().copied().collect();
        // A point is seen by those of a photo's cut views that show it.
        track.retain(|v| views[*v as usize].face.is_none() || views[*v as usize].camera.shows(point.position));
        track.sort_unstable();
        track.dedup();
        point.track = track;
    }
    let listed = points.len();
    let points = merge_repeated(points);
    skipped.notes.extend(notes::unseen(&views, &points));
    skipped.notes.extend(notes::outlying(&views));
    if options.pole_mask > 0.0 && views.iter().all(|view| view.face.is_none()) {
        skipped.notes.push("there are no panoramas and no wide fisheyes: --pole-mask masks nothing".to_owned());
    }
    let size = near::size(&views, &points);
    // After the size: a capture has the same near plane and origin whether it is trained on or drawn.
    let points = if options.check { merge_copies(points) } else { points };
    skipped.repeated_points = listed - points.len();
    let plain = notes::plain(&points);
    skipped.choices.extend(plain.map(|colour| notes::of_one_colour(points.len(), colour)));
    let (near, origin) = (near::near(size), DVec3::ZERO);
    let Listing { kind, root, .. } = listing;
    Ok(Scene { kind, root, source, views, points, plain, skipped, near, unit: 1.0, origin }.move_near(size))
}

/// Finds the depth maps of views in a folder; one that may be that of several photos is none's.
fn find_depths(folder: &Path, views: &mut [View], skipped: &mut Skipped) {
    // These replace those that the capture names.
    skipped.missing_depths = Names::default();
    let mut maps = depths::DepthMaps::of(folder);
    let mut found: Vec<Option<PathBuf>> = views.iter().map(|view| maps.find(&view.name)).collect();
    if let Some(inner) = maps.only_folder().filter(|_| found.iter().all(Option::is_none)) {
        maps = depths::DepthMaps::of(&inner);
        found = views.iter().map(|view| maps.find(&view.name)).collect();
    }
    let mut used: HashMap<&PathBuf, usize> = HashMap::new();
    found.iter().flatten().for_each(|map| *used.entry(map).or_default() += 1);
    for (view, map) in views.iter_mut().zip(&found) {
        view.depth = map.clone().filter(|map| used[map] == 1);
        if view.depth.is_none() {
            skipped.missing_depths.add(&view.name);
        }
    }
    if used.is_empty() {
        skipped.missing_depths = Names::default();
        skipped.notes.push(maps.doubt(views));
    }
}

/// The views with their ids and ideal cameras, at the real size of their photo if it is present and of the camera's shape.
/// Photos that no pinhole can show are cut.
fn finish(
    listed: Vec<(u32, View)>,
    source: &Path,
    options: &OpenOptions,
    skipped: &mut Skipped,
) -> Result<Vec<(u32, View)>, Error> {
    let sizes: Vec<_> = listed.par_iter().map(|(_, view)| files::photo_size(&view.image)).collect();
    let mut folded = Names::default();
    let mut known: HashMap<Vec<u64>, Option<Ideal>> = HashMap::new(); // most scenes have few lenses, and many views
    let mut views = Vec::with_capacity(listed.len());
    for ((id, mut view), photo_size) in listed.into_iter().zip(sizes) {
        let lens = match photo_size {
            Some((width, height)) if view.lens.fits(width, height) => view.lens.resized(width, height),
            _ => view.lens,
        };
        if lens.model == LensModel::Equirectangular && lens.width.abs_diff(2 * lens.height) > 2 + lens.width / 100 {
            let (width, height) = (lens.width, lens.height);
            let what = format!(
                "is {width} x {height}: a panorama is twice as wide as high; fill up what was cut off, with ImageMagick: `magick mogrify \
                 -gravity center -background black -extent {width}x{} FILE`",
                width / 2
            );
            return Err(Error::malformed(source, format!("camera of image {:?}", view.name), what));
        }
        let ideal = match known.entry(lens.key()) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => new.insert(Ideal::of(&lens, options)),
        };
        let Some(ideal) = ideal else {
            folded.add(&view.name);
            continue;
        };
        view.set_lens(lens, ideal.pinhole);
        view.photo_size = photo_size;
        if ideal.faces.is_empty() {
            views.push((id, view));
        } else {
            views.extend(ideal.faces.iter().map(|face| (id, view.cut(face, options.pole_mask.to_radians()))));
        }
    }
    if folded.count > 0 {
        let photos = counted(folded.count, "photo");
        if views.is_empty() {
            return Err(Error::malformed(source, format!("the cameras of {photos} ({folded})"), FOLDED));
        }
        skipped.notes.push(format!("{photos} left out ({folded}): {FOLDED}"));
    }
    Ok(views)
}

/// The views that replace a lens's photos: a pinhole's view, or faces of a cube.
struct Ideal {
    pinhole: Option<Pinhole>,
    faces: Vec<Cut>,
}

impl Ideal {
    /// The views that replace a lens's photos; none if the lens folds its image.
    fn of(lens: &Lens, options: &OpenOptions) -> Option<Self> {
        let mut faces = faces::of(lens);
        if options.undistort == Some(false) && lens.model != LensModel::Equirectangular {
            faces.clear();
        }
        let bends = || options.undistort.unwrap_or_else(|| lens.max_displacement() > VISIBLE_DISPLACEMENT);
        if !faces.is_empty() || !bends() {
            return Some(Self { pinhole: None, faces });
        }
        lens.ideal().map(|pinhole| Self { pinhole: Some(pinhole), faces })
    }
}
