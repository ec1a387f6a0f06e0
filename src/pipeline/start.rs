//! The initial Gaussians of training.

use super::checkpoint::Checkpoint;
use super::place::{doubt, place_in};
use super::prepare::Prepared;
use crate::effects::Effect;
use crate::gaussians::{Gaussians, formats};
use crate::job::{Error, Init, RunConfig, Watcher};
use crate::sample::spread;
use crate::scene::{Scene, SceneKind};
use crate::train::initialise::{self, Seed};
use crate::wording::counted;

/// Number of random points per pixel of a picture, and its bounds.
const POINTS_PER_PIXEL: f64 = 0.3;
const POINTS: (usize, usize) = (5_000, 100_000);

/// Initial state of training, before any photo is read.
pub enum Start {
    /// The given model.
    Model(Gaussians),
    /// The given number of the scene's points.
    Points(usize),
    /// The given number of random points.
    Random(usize),
    /// An interrupted run.
    Resumed(Box<Checkpoint>),
}

impl Start {
    /// The initial state that the configuration selects for a scene and training pictures of at most `pixels` pixels. A model is moved to
    /// the scene's coordinates, and loses its SH bands above the degree that was asked for, with a note; points that are too few, or show too little,
    /// are replaced by random ones. Where there are more than the configuration allows, a note says what becomes of them.
    ///
    /// # Errors
    /// A model that cannot be read; [`Error::Usage`] for a number of random points in a run that begins with others.
    pub fn of(config: &RunConfig, scene: &Scene, pixels: u64, watcher: &dyn Watcher) -> Result<Self, Error> {
        let points = scene.points.len();
        Ok(match &config.init {
            Init::Model(path) => {
                refuse_count(config, || format!("the model {}", path.display()))?;
                let mut loaded = formats::read(path)?;
                if let Some(doubt) = doubt(&loaded, scene) {
                    watcher.lost(&format!("warning: {} {doubt}", path.display()));
                }
                place_in(&mut loaded.gaussians, &mut loaded.origin, scene);
                if let Some(note) = cut(&mut loaded.gaussians, config) {
                    watcher.note(&format!("{}: {note}", path.display()));
                }
                let (most, there) = (config.max_gaussians, loaded.gaussians.len());
                if there > most {
                    watcher.note(&format!(
                        "{}: the run begins with all its {}; --max-gaussians {most} limits growth only",
                        path.display(),
                        counted(there, "Gaussian")
                    ));
                }
                Self::Model(loaded.gaussians)
            }
            Init::Points if scene.lacks_points().is_none() => {
                refuse_count(config, || format!("the {} of {}", counted(points, "point"), config.scene.display()))?;
                let most = config.max_gaussians;
                if points > most {
                    watcher.note(&format!("{points} points are thinned out to {most}, as many as are allowed"));
                }
                Self::Points(points)
            }
            Init::Points | Init::Random => {
                let count = (pixels as f64 * POINTS_PER_PIXEL) as usize;
                let count = config.init_count.unwrap_or(count.clamp(POINTS.0, POINTS.1));
                // More would only be thinned out again.
                Self::Random(count.min(config.max_gaussians))
            }
        })
    }

    /// The number of Gaussians.
    pub fn len(&self) -> usize {
        match self {
            Self::Model(model) => model.len(),
            Self::Points(n) | Self::Random(n) => *n,
            Self::Resumed(checkpoint) => checkpoint.snapshot.model.len(),
        }
    }

    /// Returns true if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Highest SH degree among them.
    pub fn degree(&self) -> usize {
        match self {
            Self::Model(model) => model.degree(),
            Self::Resumed(checkpoint) => checkpoint.snapshot.model.degree(),
            Self::Points(_) | Self::Random(_) => 0,
        }
    }
}

/// Removes the SH bands above the degree that was asked for, and tells of it; a degree that is only measured later removes none.
fn cut(model: &mut Gaussians, config: &RunConfig) -> Option<String> {
    let off = config.effects.forced(Effect::ViewDependence) == Some(false);
    let (most, before) = (if off { 0 } else { config.sh_degree }, model.degree());
    model.sh.truncate(most + 1);
    let what = format!("its SH bands above degree {most} are left out, as sh_degree says (it has degree {before})");
    (before > most).then_some(what)
}

/// Refuses a number of random points in a run that begins with something else.
fn refuse_count(config: &RunConfig, first: impl FnOnce() -> String) -> Result<(), Error> {
    if config.init_count.is_none() {
        return Ok(());
    }
    Err(Error::Usage(format!(
        "--init-count (init_count in a configuration) is a number of random points, but this run begins with {}: add --init random, or \
         leave the number out",
        first()
    )))
}

/// The initial Gaussians of training.
///
/// # Errors
/// Cameras that leave no room for random points; photos that cannot be read.
pub fn initialise(config: &RunConfig, prepared: &Prepared, start: &Start) -> Result<Gaussians, Error> {
    let blender = prepared.scene.kind == SceneKind::Blender;
    let seeds: Vec<Seed> = match start {
        Start::Model(model) => return Ok(model.scaled(1.0 / prepared.scene.unit).into_owned()),
        Start::Resumed(checkpoint) => return Ok(checkpoint.snapshot.model.clone()),
        Start::Points(_) => initialise::of_scene(&prepared.scene, &prepared.train)?,
        Start::Random(count) => {
            initialise::random_in(&prepared.train, *count, (blender, prepared.scene.near), u64::from(config.seed))?
        }
    };
    let model = initialise::from_points_in(&seeds, prepared.unit());
    let all: Vec<usize> = (0..model.len()).collect();
    Ok(if all.len() > config.max_gaussians { model.select(&spread(&all, config.max_gaussians)) } else { model })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Choice;
    use crate::job::Preset;

    #[test]
    fn a_degree_that_was_asked_for_cuts_the_bands_above() {
        let asked = [(Choice::Auto, 3, 2), (Choice::Auto, 1, 1), (Choice::On, 3, 2), (Choice::Off, 3, 0)];
        for (choice, sh_degree, left) in asked {
            let mut config = RunConfig { sh_degree, ..RunConfig::sample(Preset::Quick) };
            config.effects.set(Effect::ViewDependence, choice);
            let mut model = Gaussians::zeroed(3, 2);
            let note = cut(&mut model, &config);
            assert_eq!((model.degree(), note.is_some()), (left, left < 2), "{choice:?} {sh_degree}");
        }
    }
}
