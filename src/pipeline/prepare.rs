//! Reads a scene from disk into views in memory.

use super::backdrop::backdrop;
use crate::depth_maps::{self, DepthMaps};
use crate::effects::DepthEvidence;
use crate::extension::folder_of;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, RenderMode, crc32};
use crate::job::{Error, Selection, Stage, Watcher};
use crate::render::{Settings, Style};
use crate::scene::camera::Camera;
use crate::scene::{AlphaRole, LoadOptions, OpenOptions, Photo, PhotoMemory, Resize, Scene, View};
use crate::train;
use flate2::CrcWriter;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// A scene ready to train on.
pub struct Prepared {
    /// The scene, with only the views whose photos were loaded.
    pub scene: Scene,
    /// Views trained on.
    pub train: Vec<Photo>,
    /// Views held out, with their names.
    pub test: Vec<(String, Photo)>,
    /// 1.1 times the largest distance of a training camera from the mean of these cameras.
    pub extent: f64,
    /// Background colour.
    pub background: [f32; 3],
    /// Evidence on the depth maps of the photos trained on.
    pub depths: DepthEvidence,
}

impl Prepared {
    /// Writes a trained model, in the scene's unit and with its local origin.
    pub fn write(&self, path: &Path, model: &Gaussians, mode: RenderMode) -> Result<(), Error> {
        let (model, origin) = (model.scaled(self.scene.unit), self.scene.origin.to_array());
        formats::write_at(path, &model, mode, origin).map_err(Error::writing)
    }

    /// Tells of faults of the photos, cameras and poses, now and among what was skipped.
    pub fn note(&mut self, advice: Vec<String>, watcher: &dyn Watcher) {
        for line in advice {
            watcher.lost(&line);
            self.scene.skipped.notes.push(line);
        }
    }

    /// Names of the photos trained on.
    pub fn names_to_train(&self) -> Vec<String> {
        let held_out: HashSet<&str> = self.test.iter().map(|(name, _)| name.as_str()).collect();
        let names = self.scene.views.iter().map(|view| &view.name);
        names.filter(|name| !held_out.contains(name.as_str())).cloned().collect()
    }

    /// CRC-32 of each view by name: of the pixels with their alpha or mask, the depth map, and the camera in float32.
    ///
    /// # Errors
    /// Photos that cannot be read.
    pub fn contents(&self) -> Result<BTreeMap<String, u32>, Error> {
        let named = self.names_to_train().into_iter().zip(&self.train);
        let all: Vec<_> = named.chain(self.test.iter().map(|(name, photo)| (name.clone(), photo))).collect();
        let sum = |(name, photo): (String, &Photo)| {
            let pixels = photo.pixels.read().map_err(train::Error::Photos)?;
            let depths = photo.depth.as_ref().map(|map| bytemuck::cast_slice(&map.depths)).unwrap_or_default();
            Ok((name, crc32([&*pixels, depths, bytemuck::cast_slice(&numbers(&photo.camera))])))
        };
        all.into_par_iter().map(sum).collect()
    }

    /// The views of [`Opened::only`], those of these names held out.
    #[must_use]
    pub fn holding_out(self, names: &[String]) -> Self {
        let names: HashSet<&str> = names.iter().map(String::as_str).collect();
        let named = self.scene.views.iter().map(|view| view.name.clone()).zip(self.train);
        let (test, train): (Vec<_>, Vec<_>) = named.partition(|(name, _)| names.contains(name.as_str()));
        Self { train: train.into_iter().map(|(_, photo)| photo).collect(), test, ..self }
    }

    /// The settings of image formation in a style.
    pub fn settings(&self, style: Style) -> Settings {
        Settings { near: self.scene.near, ..style.over(self.background) }
    }

    /// The size of the scene in usual ones, of which 3DGS's lengths are meant: 1 for most captures.
    pub fn unit(&self) -> f64 {
        f64::from(self.scene.near) / f64::from(Settings::default().near)
    }

    /// Switches to a unit of length in which the scene has a usual size, for training: [`Scene::use_usual_unit`].
    #[must_use]
    pub fn in_usual_unit(mut self) -> Self {
        let unit = self.scene.use_usual_unit();
        if unit != 1.0 {
            self.extent /= unit;
            for photo in self.train.iter_mut().chain(self.test.iter_mut().map(|(_, photo)| photo)) {
                photo.camera.translation /= unit;
                if let Some(map) = &mut photo.depth {
                    map.unit /= unit;
                }
            }
        }
        self
    }

    /// All views, those held out first.
    pub fn views(&self) -> impl Iterator<Item = &Photo> {
        self.test.iter().map(|(_, view)| view).chain(&self.train)
    }
}

/// Refuses to write any of `files` into a folder of the scene's photos or masks.
///
/// # Errors
/// [`Error::AmongPhotos`] for the first one.
pub fn refuse_photo_folders<'a>(scene: &Scene, files: impl Iterator<Item = &'a PathBuf>) -> Result<(), Error> {
    let folder = |p: &Path| std::fs::canonicalize(folder_of(p)).ok();
    let photos = scene.views.iter().flat_map(|v| [Some(v.image.as_path()), v.mask.as_deref()]).flatten();
    let photos: HashSet<PathBuf> = photos.filter_map(folder).collect();
    let among = |file: &&PathBuf| folder(file).is_some_and(|f| photos.contains(&f));
    files.into_iter().find(among).map_or(Ok(()), |file| Err(Error::AmongPhotos(file.clone())))
}

/// Refuses a scene without a photo that it had when a job was planned.
///
/// # Errors
/// [`Error::LostPhoto`] for the first of `names` that no view has.
pub fn all_there(scene: &Scene, names: &[String]) -> Result<(), Error> {
    let there: HashSet<&str> = scene.views.iter().map(|view| view.name.as_str()).collect();
    match names.iter().find(|name| !there.contains(name.as_str())) {
        Some(photo) => Err(Error::LostPhoto { scene: scene.source.clone(), photo: photo.clone() }),
        None => Ok(()),
    }
}

/// CRC-32 of a file; 0 for a folder.
///
/// # Errors
/// A file that cannot be read.
pub fn crc32_of_file(path: &Path) -> Result<u32, Error> {
    if path.is_dir() {
        return Ok(0);
    }
    let mut crc = CrcWriter::new(io::sink());
    match File::open(path).and_then(|mut file| io::copy(&mut file, &mut crc)) {
        Ok(_) => Ok(crc.crc().sum()),
        Err(source) => Err(Error::Read { path: path.to_owned(), source }),
    }
}

/// CRC-32 of each view by name: of its photo's, mask's and depth map's files, of its camera in float32, and of the circle that its photo
/// shows.
///
/// # Errors
/// Files that cannot be read.
pub fn contents(scene: &Scene) -> Result<BTreeMap<String, u32>, Error> {
    fn files(view: &View) -> impl Iterator<Item = &Path> {
        [Some(&view.image), view.mask.as_ref(), view.depth.as_ref()].into_iter().flatten().map(PathBuf::as_path)
    }
    // Faces of one panorama share its file.
    let all: BTreeSet<&Path> = scene.views.iter().flat_map(files).collect();
    let sums = all.into_par_iter().map(|path| Ok((path, crc32_of_file(path)?)));
    let sums: BTreeMap<&Path, u32> = sums.collect::<Result<_, Error>>()?;
    let sum = |view: &View| {
        let files: Vec<u32> = files(view).map(|path| sums[path]).collect();
        let (camera, circle) = (numbers(&view.camera), view.circle.as_slice());
        let parts = [bytemuck::cast_slice(&files), bytemuck::cast_slice(&camera), bytemuck::cast_slice(circle)];
        (view.name.clone(), crc32(parts))
    };
    Ok(scene.views.par_iter().map(sum).collect())
}

/// Refuses a scene whose views are not those that a job was planned on; without a plan, accepts any.
///
/// # Errors
/// [`Error::ChangedPhoto`] for the first view that differs; files that cannot be read.
pub fn unchanged(scene: &Scene, planned: &BTreeMap<String, u32>) -> Result<(), Error> {
    if planned.is_empty() {
        return Ok(());
    }
    let other = contents(scene)?.into_iter().find(|(name, sum)| planned.get(name) != Some(sum));
    match other {
        Some((photo, _)) => Err(Error::ChangedPhoto { scene: scene.source.clone(), photo }),
        None => Ok(()),
    }
}

/// True if masks leave nothing of any of these photos.
fn all_hidden(photos: &[Photo]) -> io::Result<bool> {
    for photo in photos {
        let hidden = photo.alpha_role == AlphaRole::Mask
            && photo.pixels.read()?.as_chunks::<4>().0.iter().all(|[.., counts]| *counts == 0);
        if !hidden {
            return Ok(false);
        }
    }
    Ok(true)
}

fn numbers(camera: &Camera) -> Vec<f32> {
    let Camera { rotation, translation, focal, principal, .. } = camera;
    let pose = rotation.to_cols_array().into_iter().chain(translation.to_array());
    pose.chain([focal.x, focal.y, principal.x, principal.y]).map(|value| value as f32).collect()
}

/// A scene whose photos exist but are not decoded yet.
pub struct Opened {
    /// The scene.
    pub scene: Scene,
    resize: Resize,
    selection: Selection,
    /// Names of photos that must be there.
    required: Vec<String>,
    /// Depth maps, and the number of points without those in them.
    depths: (DepthMaps, usize),
}

/// Opens a scene.
pub fn open(selection: &Selection) -> Result<Opened, Error> {
    opened(selection, &selection.open_options())
}

/// Opens a scene to train on: how well poses fit its points is measured, too, and near copies of points are merged.
pub fn open_to_train(selection: &Selection) -> Result<Opened, Error> {
    opened(selection, &OpenOptions { check: true, ..selection.open_options() })
}

fn opened(selection: &Selection, options: &OpenOptions) -> Result<Opened, Error> {
    let resize = selection.resize().map_err(Error::Usage)?;
    selection.effects.check().map_err(Error::Usage)?;
    let mut scene = Scene::open(&selection.scene, options)?;
    scene.require_photos()?;
    Ok(Opened::of(selection, resize, scene))
}

impl Opened {
    /// A scene that is open already, of which [`Scene::require_photos`] has left the views.
    pub fn of(selection: &Selection, resize: Resize, scene: Scene) -> Self {
        let depths = (DepthMaps::default(), scene.points.len());
        Self { scene, resize, selection: selection.clone(), required: Vec::new(), depths }
    }

    /// Width and height that every picture fits in.
    pub fn size(&self) -> [u32; 2] {
        let larger = |[w, h]: [u32; 2], c: Camera| [w.max(c.width), h.max(c.height)];
        self.scene.views.iter().map(|v| v.camera_at(self.resize)).fold([1, 1], larger)
    }

    /// The same scene with the depth maps of photos to train on, and points from them.
    #[must_use]
    pub fn with_depths(mut self, watcher: &dyn Watcher) -> Self {
        let train = self.scene.split(self.selection.eval_every).train;
        let mut maps = depth_maps::of_views(&self.scene, &train, self.resize);
        self.scene.points.append(&mut maps.points);
        for note in &maps.notes {
            watcher.lost(note);
        }
        for choice in &maps.choices {
            watcher.note(choice);
        }
        self.depths.0 = maps;
        self
    }

    /// Bytes of the depth maps.
    pub fn depth_bytes(&self) -> u64 {
        self.depths.0.bytes()
    }

    /// The same scene with the views of these names alone, all of them to train on. None of them may be lost, also on loading.
    ///
    /// # Errors
    /// [`Error::LostPhoto`] for a name that the scene does not have.
    pub fn only(mut self, names: &[String]) -> Result<Self, Error> {
        let wanted: HashSet<&str> = names.iter().map(String::as_str).collect();
        let keep: Vec<bool> = self.scene.views.iter().map(|view| wanted.contains(view.name.as_str())).collect();
        self.scene.retain_views(&keep);
        self.selection.eval_every = 0;
        all_there(&self.scene, names)?;
        Ok(Self { required: names.to_vec(), ..self })
    }

    /// The settings of image formation in a style, over a background that is known.
    pub fn settings(&self, style: Style, background: Option<[f32; 3]>) -> Settings {
        Settings { near: self.scene.near, ..style.over(background.unwrap_or_default()) }
    }

    /// The pictures' cameras.
    pub fn cameras(&self) -> Vec<Camera> {
        self.scene.views.iter().map(|view| view.camera_at(self.resize)).collect()
    }

    /// Pixels of each training picture; includes photos that turn out damaged.
    pub fn train_pixels(&self) -> Vec<u64> {
        let pixels = |i: &usize| self.scene.views[*i].camera_at(self.resize).pixels();
        self.scene.split(self.selection.eval_every).train.iter().map(pixels).collect()
    }

    /// Loads photos as [`Opened::load`] does, for jobs that need photos to train on.
    ///
    /// # Errors
    /// The errors of [`Opened::load`]; no photo to train on, or none of which masks leave anything.
    pub fn load_to_train(self, memory: PhotoMemory<'_>, watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let prepared = self.load(memory, watcher)?;
        if prepared.train.is_empty() {
            return Err(Error::NothingToTrainOn(prepared.scene.source));
        }
        if all_hidden(&prepared.train).map_err(train::Error::Photos)? {
            return Err(Error::AllHidden(prepared.scene.source));
        }
        Ok(prepared)
    }

    /// Decodes the photos and splits them. Skipped ones are reported to `watcher`.
    ///
    /// # Errors
    /// No photo can be decoded; [`Error::LostPhoto`] for one of [`Opened::only`]; a temporary file that cannot be written.
    pub fn load(self, memory: PhotoMemory<'_>, watcher: &(dyn Watcher + Sync)) -> Result<Prepared, Error> {
        let Self { mut scene, resize, selection, required, depths: (maps, points) } = self;
        let options = LoadOptions { memory, ..selection.load_options(resize) };
        let total = scene.views.len();
        let mut photos = scene.load_photos(&options, &|done| watcher.progress(Stage::Photos, done, total))?;
        watcher.unless_stopped()?;
        depth_maps::colour(&mut scene, points, &photos);
        for (photo, view) in photos.iter_mut().zip(&scene.views) {
            photo.depth = maps.shown(&view.name, photo);
        }
        for line in scene.skipped.losses() {
            watcher.lost(&line);
        }
        for line in scene.skipped.chosen() {
            watcher.note(&line);
        }
        all_there(&scene, &required)?;
        unchanged(&scene, &selection.contents)?;
        let split = scene.split(selection.eval_every);
        if let ([_], [], 2..) = (scene.views.as_slice(), split.test.as_slice(), selection.eval_every) {
            watcher.note("there is one photo: it is trained on, and none is held out (as by --eval-every 0)");
        }
        let train = split.train.iter().map(|i| photos[*i].clone()).collect();
        let test = split.test.iter().map(|i| (scene.views[*i].name.clone(), photos[*i].clone())).collect();
        let extent = scene.extent(&split.train);
        let background = match selection.background {
            Some(given) => given,
            None => usual_background(&photos, watcher)?,
        };
        Ok(Prepared { scene, train, test, extent, background, depths: maps.evidence })
    }
}

/// The background that photos are trained and scored on unless one is given: white with alpha, a colour that their edges share, or black.
pub(super) fn usual_background(photos: &[Photo], watcher: &dyn Watcher) -> Result<[f32; 3], Error> {
    let Some((colour, share)) = backdrop(photos).map_err(train::Error::Photos)? else {
        return Ok(AlphaRole::of(photos).usual_background());
    };
    let [red, green, blue] = colour;
    watcher.note(&format!(
        "{:.0} % of the pixels at the photos' edges have one colour, which is the background: --background {red:.3},{green:.3},{blue:.3}",
        100.0 * share
    ));
    Ok(colour)
}
