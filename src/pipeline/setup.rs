//! The setup that runs share: checkpoint, scene, estimate of memory, photos, effects.

use super::checkpoint::Checkpoint;
use super::evaluate::exhibits::exhibits;
use super::evaluate::pictures::{self, Format};
use super::prepare::{Prepared, open_to_train, refuse_photo_folders};
use super::start::Start;
use super::trial::trial;
use super::{budget, effects};
use crate::effects::{Decision, Told, antialias_would_help};
use crate::gpu::Device;
use crate::job::output::same_place;
use crate::job::records::Trial;
use crate::job::{Error, Init, Output, RunConfig, Session, Watcher, earlier};
use crate::train::Exposures;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A scene ready to train on, with the data that its runs share.
pub struct Setup<'a> {
    /// Device, limits and watcher.
    pub session: Session<'a>,
    /// The configuration, with the decisions on effects.
    pub config: RunConfig,
    /// The scene's views.
    pub prepared: Prepared,
    /// Estimated device memory in bytes.
    pub estimated_bytes: u64,
    /// The decision on each effect.
    pub decisions: Vec<Decision>,
    /// The short training that was evidence for some of them, if there was one.
    pub trial: Option<Trial>,
    /// The training views' exposures, if each has one of its own: learnt from measured gains, or known.
    pub exposures: Exposures,
    /// Mean of the camera centres of a scene of which `prepared` has a part; see [`crate::train::Options::cameras`].
    pub cameras: Option<[f32; 3]>,
    /// Start time of the job.
    pub begun: Instant,
    /// Seconds of the run's earlier parts, if it was interrupted.
    pub earlier_s: f64,
    /// Seconds until the photos were loaded.
    pub load_s: f64,
    /// Seconds from there until everything is decided.
    pub start_s: f64,
}

impl<'a> Setup<'a> {
    /// Seconds of the whole run so far.
    pub fn elapsed(&self) -> f64 {
        self.earlier_s + self.begun.elapsed().as_secs_f64()
    }

    /// Opens the scene of `config`, checks that a run on it fits the device, decodes its photos and decides on its effects.
    /// Also returns the initial state of training: with `resume`, the checkpoint in `output`, if there is one.
    pub fn load(
        session: &Session<'a>,
        config: &RunConfig,
        output: &Output,
        resume: bool,
    ) -> Result<(Self, Start), Error> {
        let begun = Instant::now();
        let Session { device, watcher, .. } = *session;
        let checkpoint = if resume { checkpoint(output, watcher)? } else { None };
        let opened = open_to_train(&config.selection())?.with_depths(watcher);
        refuse_photo_folders(&opened.scene, [output.model(), output.renders().join("picture.png")].iter())?;
        let pixels = opened.train_pixels();
        let fresh = || {
            if let Some(note) = opened.scene.lacks_points().filter(|_| matches!(config.init, Init::Points)) {
                watcher.lost(&note);
            }
            Start::of(config, &opened.scene, pixels.iter().copied().max().unwrap_or(0), watcher)
        };
        let start = checkpoint.map_or_else(fresh, |checkpoint| Ok(Start::Resumed(Box::new(checkpoint))))?;
        let estimated_bytes = budget::for_run(session, config, &opened, &start)?.bytes;
        let schedule = &config.schedule;
        let limit = schedule.growth.and_then(|plan| plan.limit(&pixels, schedule.iterations));
        let mut prepared = opened.load_to_train(session.photo_memory(output.folder()), watcher)?;
        let load_s = begun.elapsed().as_secs_f64();
        let (Told { mut decisions, gains, sky }, advice) = effects::decide(&prepared, config)?;
        prepared.note(advice, watcher);
        let degree = match &start {
            // What the run decided, or an earlier version of the program.
            Start::Resumed(c) => toml::from_str::<RunConfig>(&c.notes.config).map_or(0, |own| own.sh_degree),
            _ => start.degree(),
        };
        effects::keep_bands(&mut decisions, degree);
        effects::add_sky(&mut decisions, sky, (config, &start), &mut prepared.scene);
        let prepared = prepared.in_usual_unit();
        let trial = match &start {
            Start::Resumed(checkpoint) => checkpoint.notes.trial,
            _ => trial(session, &config.decided(&decisions), &prepared, &start, &decisions)?,
        };
        if let Some(trial) = &trial {
            effects::try_out(&mut decisions, trial);
        }
        watcher.note(&effects::summary(&decisions));
        if let Some(note) = antialias_would_help(&decisions) {
            watcher.note(&note);
        }
        if let Some(note) = limit {
            watcher.note(&note);
        }
        let decided = config.decided(&decisions);
        for key in config.overruled(&decided) {
            watcher.note(&format!("{key} = true in the configuration has no effect: [effects] and the scene decide"));
        }
        let config = RunConfig { tuning: Some(device.tuning().clone()), ..decided };
        let earlier_s = if let Start::Resumed(checkpoint) = &start { checkpoint.notes.elapsed } else { 0.0 };
        let exposures = Exposures::Learnt(gains.believed());
        let setup = Self {
            session: *session,
            config,
            prepared,
            estimated_bytes,
            decisions,
            trial,
            exposures,
            cameras: None,
            begun,
            earlier_s,
            load_s,
            start_s: begun.elapsed().as_secs_f64() - load_s,
        };
        Ok((setup, start))
    }

    /// Writes `config.toml`, after a check that `start` belongs to this configuration.
    pub fn write_config(&self, start: &Start, output: &Output) -> Result<(), Error> {
        let Start::Resumed(checkpoint) = start else {
            // Figures of an earlier run in this folder would mark this one as finished, and what was made from them would lie beside
            // another model.
            let initial = if let Init::Model(path) = &self.config.init { path.as_path() } else { Path::new("") };
            let files = [output.metrics(), output.report(), output.packed()];
            for file in pictures_of_earlier(output).into_iter().chain(files) {
                if !same_place(&file, initial) {
                    let _ = std::fs::remove_file(file);
                }
            }
            return Output::text(&output.config(), &self.config.written_in(output.folder())?);
        };
        let unreadable = |e: toml::de::Error| Error::Checkpoint {
            path: output.checkpoint(),
            what: format!("the note 'config' cannot be read: {e}"),
        };
        let own: RunConfig = toml::from_str(&checkpoint.notes.config).map_err(unreadable)?;
        let changes = self.config.changes(&own.read_in(output.folder()));
        if !changes.is_empty() {
            return Err(Error::OtherRun { folder: output.folder().to_owned(), changes });
        }
        if earlier::is_config_kept(output.folder()) {
            return Ok(());
        }
        Output::text(&output.config(), &checkpoint.notes.config)
    }
}

/// The device with the tuning that a run is to have: with `resume` that of the run in `output`, else the configuration's.
/// A tuning that does not fit is reported and replaced by the device's own.
pub fn tuned(session: &Session<'_>, config: &RunConfig, output: &Output, resume: bool) -> Result<Device, Error> {
    let earlier = if resume { earlier::config(output)? } else { None };
    // A checkpoint has the tuning of the device that wrote it last, config.toml that of the first one.
    let first = || RunConfig::read(&output.config()).ok().and_then(|first| first.tuning);
    let wanted = earlier.map_or_else(|| config.tuning.clone(), |earlier| first().or(earlier.tuning));
    let Some(wanted) = wanted else { return Ok(session.device.clone()) };
    Ok(session.device.with_tuning(wanted).unwrap_or_else(|e| {
        session.watcher.note(&format!("the run began on another device: {e}; results will differ in their last bits"));
        session.device.clone()
    }))
}

/// The pictures of the run whose figures are in this folder.
fn pictures_of_earlier(output: &Output) -> Vec<PathBuf> {
    let views = earlier::views(output.folder()).unwrap_or_default();
    let names: Vec<&str> = views.iter().map(String::as_str).collect();
    let drawn = pictures::names(names.iter().copied(), Format::Png.extension());
    let shown = exhibits(&names).into_iter().flat_map(|exhibit| [exhibit.photo, exhibit.dense]);
    drawn.into_iter().chain(shown).map(|picture| output.renders().join(picture)).collect()
}

fn checkpoint(output: &Output, watcher: &dyn Watcher) -> Result<Option<Checkpoint>, Error> {
    let path = output.checkpoint();
    if !path.exists() {
        watcher.note("no checkpoint yet: starting from the beginning");
        return Ok(None);
    }
    let checkpoint = Checkpoint::read(&path)?;
    watcher.note(&format!("resuming after iteration {}", checkpoint.snapshot.iteration));
    Ok(Some(checkpoint))
}
