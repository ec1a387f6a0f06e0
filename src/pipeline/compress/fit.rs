//! Search for a model's file of a given size or PSNR: the model is scored and merged once, and written as often as the search
//! needs.

use super::config::CompressConfig;
use super::views::Views;
use crate::aim::{Found, Search, Trials};
use crate::gaussians::formats::{self, Ladder, Precision, RenderMode, SpzVersion};
use crate::gaussians::{self, Gaussians};
use crate::job::records::{Aim, AimRecord, Truth};
use crate::job::{Error, Session, Stage, Watcher};
use crate::pipeline::draw_source::DrawSource;
use crate::pipeline::evaluate::{Evaluator, counts, mean};
use crate::pipeline::prune::{self, PrunePlan};
use crate::pipeline::virtual_views::photo;
use crate::qirf::pairs::Sequence;
use crate::render::{Painter, Source};
use crate::response::Responses;
use crate::sample::evenly;
use crate::scene::{Photo, camera};
use crate::wording::counted;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::path::Path;
use std::time::Instant;

/// Maximum number of views by which files are compared.
const JUDGES: usize = 8;
/// Loss in dB that a format's settings may add to that of a prune.
const MOST_LOSS: f64 = 0.5;
/// Approximate number of files that a search tries, for its progress bar.
const TRIES: usize = 9;
/// Maximum number of packed models in memory during a search: one may be as large as the original.
const KEPT: usize = 3;

/// Comparison of a file's pictures with those of the original.
pub struct Judge<'a> {
    session: &'a Session<'a>,
    views: &'a Views,
    photos: Vec<Photo>,
}

impl<'a> Judge<'a> {
    /// Takes a few training views, or, with `held_out`, the held-out views if there are any, of those that masks do not hide; draws
    /// them if they are the model's own pictures.
    pub fn new(
        session: &'a Session<'a>,
        views: &'a Views,
        original: Source<'_>,
        held_out: bool,
    ) -> Result<Self, Error> {
        let shown = |photos: Vec<Photo>| -> Result<Vec<Photo>, Error> {
            let counting = |photo: Photo| counts(&photo, |_, _| true).map(|counts| counts.then_some(photo)).transpose();
            photos.into_iter().filter_map(counting).collect()
        };
        let mut photos = shown(views.test.iter().filter(|_| held_out).map(|(_, view)| view.clone()).collect())?;
        let are_held_out = !photos.is_empty();
        if !are_held_out {
            photos = shown(evenly(&views.train, JUDGES).cloned().collect())?;
        }
        if photos.is_empty() {
            photos = evenly(&shown(views.train.clone())?, JUDGES).cloned().collect();
        }
        if views.truth == Truth::Photos {
            leave_out_equal(session, views, original, &mut photos)?;
        } else if !are_held_out {
            let size = camera::largest(photos.iter().map(|view| &view.camera));
            let mut painter = Painter::of(session.device, views.settings, original, size)?;
            for view in &mut photos {
                view.pixels = photo(&painter.render(original, &view.camera)?);
                session.watcher.unless_stopped()?;
            }
        }
        Ok(Self { session, views, photos })
    }

    /// PSNR of a file's pictures in dB, the mean over the views; infinite if they are equal.
    pub fn psnr(&self, packed: &[u8], name: &Path) -> Result<f64, Error> {
        let model = formats::read_bytes(packed, name).map_err(Error::writing)?.gaussians;
        let settings = self.views.settings;
        let size = camera::largest(self.photos.iter().map(|view| &view.camera));
        let shown = DrawSource::for_pictures(self.session, &model, size, settings.style)?;
        let mut evaluator = Evaluator::of(self.session.device, settings, shown.source(), self.photos.iter())?;
        evaluator.compare_as(self.views.fits_exposure);
        let each = evaluator.psnr(shown.source(), self.photos.iter())?;
        Ok(mean(&each).unwrap_or(f64::INFINITY))
    }
}

/// Leaves out photos that the original's pictures equal, unless all do: they would count in the mean of worse files alone.
fn leave_out_equal(
    session: &Session<'_>,
    views: &Views,
    original: Source<'_>,
    photos: &mut Vec<Photo>,
) -> Result<(), Error> {
    let mut evaluator = Evaluator::of(session.device, views.settings, original, photos.iter())?;
    evaluator.compare_as(views.fits_exposure);
    let each = evaluator.psnr(original, photos.iter())?;
    if each.len() == photos.len() && each.iter().any(|psnr| psnr.is_finite()) {
        let mut finite = each.iter().map(|psnr| psnr.is_finite());
        photos.retain(|_| finite.next().unwrap_or(true));
    }
    Ok(())
}

/// Wraps a packed model into a file.
pub type Wrap<'a> = dyn Fn(&[u8]) -> Vec<u8> + 'a;

/// A file to write.
#[derive(Clone, Copy)]
pub struct Target<'a> {
    /// Its name.
    pub path: &'a Path,
    /// A name whose extension is the format of the model in it.
    pub format: &'a Path,
    /// Version of an SPZ.
    pub spz: SpzVersion,
    /// Requested precision of the values; by default pictures decide.
    pub precision: Option<Precision>,
    /// The file that contains a packed model; `None` if the packed model is the file.
    pub wrap: Option<&'a Wrap<'a>>,
    /// Local origin of the means in the world.
    pub origin: [f64; 3],
}

impl<'a> Target<'a> {
    /// A file that only contains the model.
    pub fn new(path: &'a Path) -> Self {
        Self { path, format: path, spz: SpzVersion::default(), precision: None, wrap: None, origin: [0.0; 3] }
    }

    /// The model in this format.
    pub fn pack(&self, model: &Gaussians, mode: RenderMode, precision: Precision) -> Result<Vec<u8>, Error> {
        // An error is of the file, whatever it contains.
        let of_file = |error| match error {
            gaussians::Error::Unsupported { what, .. } => {
                gaussians::Error::Unsupported { path: self.path.to_owned(), what }
            }
            other => other,
        };
        let packed = formats::encode(self.format, model, (mode, self.origin), (precision, self.spz));
        packed.map_err(|error| Error::writing(of_file(error)))
    }

    /// The file of a packed model.
    pub fn file(&self, packed: Vec<u8>) -> Vec<u8> {
        match self.wrap {
            Some(wrap) => wrap(&packed),
            None => packed,
        }
    }

    /// Bytes of the file of a packed model.
    pub fn length(&self, packed: &[u8]) -> u64 {
        self.wrap.map_or(packed.len(), |wrap| wrap(packed).len()) as u64
    }

    /// Writes the file of a packed model; without one, of a model in a format that stores floats.
    pub fn write(&self, packed: Option<Vec<u8>>, model: &Gaussians, mode: RenderMode) -> Result<(), Error> {
        match packed.map(|packed| self.file(packed)) {
            Some(file) => formats::write_atomically(self.path, |out| out.write_all(&file))
                .and_then(|()| formats::georeference(self.path, self.origin)),
            None => formats::write_at(self.path, model, mode, self.origin),
        }
        .map_err(Error::writing)
    }

    /// The settings to choose from.
    pub fn ladder(&self, model: &Gaussians) -> Ladder {
        match self.precision {
            Some(precision) => Ladder { rungs: vec![precision], steps: vec![0] },
            None => formats::ladder(self.format, model.degree()),
        }
    }

    /// The settings of a model if no pictures are compared.
    pub fn usual(&self, model: &Gaussians) -> Precision {
        self.precision.unwrap_or_else(|| formats::usual(self.format, model))
    }

    /// The name of its format, for messages.
    fn kind(&self) -> String {
        let path = if self.path.extension().is_some() { self.path } else { self.format };
        let of_name = || path.extension().unwrap_or_default().to_string_lossy().to_uppercase();
        formats::written_as(path).map_or_else(of_name, |format| format.to_string())
    }
}

/// A model that is scored and merged once, and written as often as searches need.
pub struct Fitter<'a> {
    judge: &'a Judge<'a>,
    model: &'a Gaussians,
    responses: &'a Responses,
    config: &'a CompressConfig,
    sequence: Sequence,
}

/// Files of a model at any number of Gaussians.
struct Files<'a> {
    /// The model with this many Gaussians.
    model: &'a dyn Fn(usize) -> Gaussians,
    mode: RenderMode,
    target: &'a Target<'a>,
    rungs: Vec<Precision>,
    /// Compares pictures and reports the search; without it, all files count as equal.
    judge: Option<&'a Judge<'a>>,
    /// The largest file that may be chosen.
    most: u64,
    /// The last packed models that may be chosen, by rung and Gaussians.
    made: VecDeque<((usize, usize), Vec<u8>)>,
    /// Number of files tried.
    tried: usize,
}

impl<'a> Files<'a> {
    /// Starts without any file.
    fn new(
        model: &'a dyn Fn(usize) -> Gaussians,
        mode: RenderMode,
        judge: Option<&'a Judge<'a>>,
        target: &'a Target<'a>,
        rungs: Vec<Precision>,
        most: u64,
    ) -> Self {
        Self { model, mode, target, rungs, judge, most, made: VecDeque::new(), tried: 0 }
    }

    fn pack(&self, rung: usize, gaussians: usize) -> Result<Vec<u8>, Error> {
        let (mut model, precision) = ((self.model)(gaussians), self.rungs[rung]);
        up_to(&mut model, precision);
        self.target.pack(&model, self.mode, precision)
    }

    /// The packed model of a file, again if it was made long ago.
    fn take(&mut self, rung: usize, gaussians: usize) -> Result<Vec<u8>, Error> {
        match self.made.iter().position(|(made, _)| *made == (rung, gaussians)).and_then(|at| self.made.remove(at)) {
            Some((_, packed)) => Ok(packed),
            None => self.pack(rung, gaussians),
        }
    }

    fn keep(&mut self, rung: usize, gaussians: usize, packed: Vec<u8>) {
        self.made.push_back(((rung, gaussians), packed));
        if self.made.len() > KEPT {
            self.made.pop_front();
        }
    }
}

impl Trials for Files<'_> {
    type Error = Error;

    fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, Error> {
        let watcher = self.judge.map(|judge| judge.session.watcher);
        watcher.map_or(Ok(()), Watcher::unless_stopped)?;
        let packed = self.pack(rung, gaussians)?;
        let length = self.target.length(&packed);
        if length <= self.most {
            self.keep(rung, gaussians, packed);
        }
        self.tried += 1;
        if let Some(watcher) = watcher {
            watcher.progress(Stage::Files, self.tried, self.tried.max(TRIES - 1) + 1);
        }
        Ok(length)
    }

    fn psnr(&mut self, rung: usize, gaussians: usize) -> Result<f64, Error> {
        let Some(judge) = self.judge else { return Ok(f64::INFINITY) };
        let packed = self.take(rung, gaussians)?;
        let psnr = judge.psnr(&packed, self.target.format)?;
        self.keep(rung, gaussians, packed);
        Ok(psnr)
    }
}

/// Removes the SH that a precision does not store.
pub fn up_to(model: &mut Gaussians, precision: Precision) {
    if let Precision::Degree(degree) = precision {
        model.sh.truncate(degree + 1);
    }
}

/// The result of a search.
pub struct Fitted {
    /// The choice of Gaussians.
    pub plan: PrunePlan,
    /// The packed model.
    pub packed: Vec<u8>,
    /// The target, the attempts and the choice.
    pub record: AimRecord,
}

impl<'a> Fitter<'a> {
    /// Merges a model down to one Gaussian, by its responses.
    pub fn new(
        judge: &'a Judge<'a>,
        model: &'a Gaussians,
        responses: &'a Responses,
        config: &'a CompressConfig,
    ) -> Self {
        let sequence = Sequence::new(model, &responses.scores, (&responses.cameras, responses.dilation), 1);
        Self { judge, model, responses, config, sequence }
    }

    /// Searches for the file that meets `aim`.
    ///
    /// # Errors
    /// [`Error::Usage`] for a size that even one Gaussian exceeds; those of the trials.
    pub fn fit(&self, aim: Aim, target: &Target<'_>) -> Result<Fitted, Error> {
        let begun = Instant::now();
        let Ladder { rungs, steps } = target.ladder(self.model).to_search(self.model.degree());
        let model = |gaussians| self.sequence.pairs(self.model, &self.responses.scores, gaussians).kept();
        let most = if let Aim::Bytes(size) = aim { size } else { u64::MAX };
        let mut files = Files::new(&model, self.config.style.mode(), Some(self.judge), target, rungs, most);
        let mut search = Search::new(&mut files, self.model.len(), &steps);
        let found = search.find(aim)?;
        let tried = search.tried();
        self.judge.session.watcher.progress(Stage::Files, 1, 1);
        let chosen = match found {
            Found::Best(point) => point,
            Found::TooSmall(least) => {
                let (kind, size) = (target.kind(), readable(least));
                let why = if self.model.is_empty() {
                    format!("this model is empty, and its {kind} file has {least} bytes")
                } else {
                    format!("the smallest {kind} file of this model has one Gaussian and {least} bytes")
                };
                return Err(Error::Usage(format!("{why}; give --size {size} or more")));
            }
        };
        let packed = files.take(chosen.rung, chosen.gaussians)?;
        let merged = self.sequence.pairs(self.model, &self.responses.scores, chosen.gaussians);
        let plan = prune::of_pairs(merged, self.responses, begun);
        let (precision, rungs) = (files.rungs[chosen.rung], files.rungs.len());
        let (written, fine_tuning) = (None, None);
        let record = AimRecord { aim, original: false, chosen, written, fine_tuning, precision, rungs, tried };
        Ok(Fitted { plan, packed, record })
    }
}

/// A number of bytes for `--size`, rounded up.
fn readable(bytes: u64) -> String {
    if bytes < 10_000 { format!("{bytes}B") } else { format!("{}kB", bytes.div_ceil(1000)) }
}

/// The model packed at the coarsest settings with little loss beyond that of the model itself, whose PSNR in the judge's views
/// is `psnr`; at the usual settings without a judge. None if the format stores floats.
pub fn packed(
    judge: Option<&Judge<'_>>,
    model: &Gaussians,
    config: &CompressConfig,
    psnr: Option<f64>,
    target: &Target<'_>,
) -> Result<Option<Vec<u8>>, Error> {
    if formats::is_exact(target.format) {
        return Ok(None);
    }
    let pack = |precision| target.pack(model, config.style.mode(), precision);
    let Some(judge) = judge else { return pack(target.usual(model)).map(Some) };
    let ladder = target.ladder(model);
    let wanted = psnr.map(|psnr| psnr - MOST_LOSS);
    for precision in ladder.coarse().take(ladder.steps.len() - 1) {
        let Some(wanted) = wanted else { break };
        let packed = pack(precision)?;
        if judge.psnr(&packed, target.format)? >= wanted {
            return Ok(Some(packed));
        }
    }
    pack(ladder.finest()).map(Some)
}

/// Packs a model into at most `most` bytes of file, at the finest possible settings. If even the coarsest settings need more,
/// Gaussians with the smallest contributions are removed. `near` is a rung whose file has about this size. Also returns the rung and its
/// settings.
pub fn within(
    model: &mut Gaussians,
    mode: RenderMode,
    most: u64,
    near: usize,
    target: &Target<'_>,
) -> Result<(Vec<u8>, usize, Precision), Error> {
    let Ladder { rungs, steps } = target.ladder(model).to_search(model.degree());
    let order = by_what_shows(model);
    // Those with the largest contributions, in the model's order.
    let most_of = |gaussians: usize| {
        let mut numbers = order[..gaussians.min(order.len())].to_vec();
        numbers.sort_unstable();
        model.select(&numbers)
    };
    let mut files = Files::new(&most_of, mode, None, target, rungs, most);
    let (rung, gaussians) = Search::new(&mut files, model.len(), &steps).refine(most, near)?;
    let (packed, precision) = (files.take(rung, gaussians)?, files.rungs[rung]);
    if gaussians < model.len() {
        let most = most_of(gaussians);
        *model = most;
    }
    up_to(model, precision);
    Ok((packed, rung, precision))
}

/// The indices of the Gaussians in descending order of opacity times area.
fn by_what_shows(model: &Gaussians) -> Vec<usize> {
    let shown = |i: usize| {
        let sizes = model.log_scales[i];
        let area = sizes.iter().sum::<f32>() - sizes.iter().fold(f32::INFINITY, |a, s| a.min(*s));
        f64::from(area).exp() / (1.0 + f64::from(-model.opacity_logits[i]).exp())
    };
    let mut order: Vec<(f64, usize)> = (0..model.len()).map(|i| (shown(i), i)).collect();
    order.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    order.into_iter().map(|(_, i)| i).collect()
}

/// The choice as text: `4.93 MB of 5 MB, 412,300 Gaussians, 35.8 dB`, with the PSNR of the file's pictures, infinite if they
/// are equal.
pub fn line(record: &AimRecord, bytes: u64, gaussians: usize, psnr: Option<f64>) -> String {
    let psnr = psnr.filter(|v| v.is_finite()).map_or_else(|| "equal pictures".to_owned(), |v| format!("{v:.1} dB"));
    let made = megabytes(bytes as f64, 2);
    let asked = match record.aim {
        Aim::Bytes(size) => format!("of {}", megabytes(size as f64, 2)),
        Aim::Psnr(psnr) => format!("for {psnr} dB"),
    };
    format!("{made} {asked}, {}, {psnr}", counted(gaussians, "Gaussian"))
}

/// Bytes as text, in kB, MB or GB.
pub fn megabytes(bytes: f64, digits: usize) -> String {
    let (value, unit) = match bytes {
        ..1e6 => (bytes / 1e3, "kB"),
        1e6..1e9 => (bytes / 1e6, "MB"),
        _ => (bytes / 1e9, "GB"),
    };
    let text = format!("{value:.digits$}");
    format!("{} {unit}", text.trim_end_matches('0').trim_end_matches('.'))
}
