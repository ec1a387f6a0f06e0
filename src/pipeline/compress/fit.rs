//! A model's file of a wanted size or PSNR: scored once, merged once, and written as often as the search needs.

use super::aim::{Aim, Found, Point, Search, Trials};
use super::config::CompressConfig;
use super::views::Views;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, Precision};
use crate::pipeline::Error;
use crate::pipeline::budget;
use crate::pipeline::draw_source::DrawSource;
use crate::pipeline::evaluate::Evaluator;
use crate::pipeline::prune::{self, PrunePlan};
use crate::pipeline::records::{AimRecord, Truth};
use crate::pipeline::session::Session;
use crate::pipeline::virtual_views::photo;
use crate::qirf::pairs::Sequence;
use crate::render::{Painter, Source};
use crate::response::Responses;
use crate::scene::{Photo, camera};
use crate::wording::counted;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// Views by which files are compared, at most.
const JUDGES: usize = 8;
/// Loss in dB that a format's settings may add to that of a prune.
const MOST_LOSS: f64 = 0.5;
/// Files that a search tries, about: for its progress bar.
const TRIES: usize = 9;

/// Pictures of the original, and how a file's pictures are compared with them.
pub struct Judge<'a> {
    session: &'a Session<'a>,
    views: &'a Views,
    photos: Vec<Photo>,
}

impl<'a> Judge<'a> {
    /// Draws, or takes, a few of the views trained on; with `held_out`, takes those held out, if there are some.
    ///
    /// # Errors
    /// Device memory; device errors; [`Error::Interrupted`].
    pub fn new(
        session: &'a Session<'a>,
        views: &'a Views,
        original: Source<'_>,
        held_out: bool,
    ) -> Result<Self, Error> {
        if held_out && !views.test.is_empty() {
            let photos = views.test.iter().map(|(_, view)| view.clone()).collect();
            return Ok(Self { session, views, photos });
        }
        let mut photos: Vec<Photo> =
            views.train.iter().step_by(views.train.len().div_ceil(JUDGES).max(1)).cloned().collect();
        if views.truth == Truth::OwnPictures {
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
    ///
    /// # Errors
    /// Device memory; device errors; a file that cannot be read.
    pub fn psnr(&self, bytes: &[u8], name: &Path) -> Result<f64, Error> {
        let model = formats::read_bytes(bytes, name).map_err(Error::writing)?.gaussians;
        let settings = self.views.settings;
        let size = camera::largest(self.photos.iter().map(|view| &view.camera));
        let place = budget::for_pictures(self.session.device, &model, size, settings.style)?;
        let shown = DrawSource::new(self.session, &model, place.whole)?;
        let mut evaluator = Evaluator::of(self.session.device, settings, shown.source(), self.photos.iter())?;
        let each = evaluator.psnr(shown.source(), self.photos.iter())?;
        Ok(each.iter().sum::<f64>() / each.len().max(1) as f64)
    }
}

/// Files of a model at any number of Gaussians, made from one sequence of merges.
struct Files<'a> {
    judge: &'a Judge<'a>,
    model: &'a Gaussians,
    responses: &'a Responses,
    sequence: Sequence,
    config: &'a CompressConfig,
    output: &'a Path,
    ladder: &'static [Precision],
    made: BTreeMap<(usize, usize), Vec<u8>>,
}

impl Trials for Files<'_> {
    type Error = Error;

    fn bytes(&mut self, rung: usize, gaussians: usize) -> Result<u64, Error> {
        let watcher = self.judge.session.watcher;
        watcher.unless_stopped()?;
        let pairs = self.sequence.pairs(self.model, &self.responses.scores, gaussians);
        let kept: Vec<usize> = (0..pairs.keep.len()).filter(|i| pairs.keep[*i]).collect();
        let model = pairs.model.select(&kept);
        let bytes = formats::encode(self.output, &model, self.config.style.mode(), &self.ladder[rung]);
        let bytes = bytes.map_err(Error::writing)?;
        let length = bytes.len() as u64;
        self.made.insert((rung, gaussians), bytes);
        watcher.trying(self.made.len(), self.made.len().max(TRIES));
        Ok(length)
    }

    fn psnr(&mut self, rung: usize, gaussians: usize) -> Result<f64, Error> {
        self.judge.psnr(&self.made[&(rung, gaussians)], self.output)
    }
}

/// The file that was found.
pub struct Fitted {
    /// The choice of Gaussians.
    pub plan: PrunePlan,
    /// The file.
    pub bytes: Vec<u8>,
    /// How finely it stores values.
    pub precision: Precision,
    /// What was asked, tried and chosen.
    pub record: AimRecord,
}

/// Searches for the file that `aim` asks for, in the format of the name `output`.
///
/// # Errors
/// [`Error::Usage`] for a size that even one Gaussian exceeds; those of the trials.
pub fn fit(
    judge: &Judge<'_>,
    model: &Gaussians,
    responses: &Responses,
    (config, aim): (&CompressConfig, Aim),
    output: &Path,
) -> Result<Fitted, Error> {
    let begun = Instant::now();
    let sequence = Sequence::new(model, &responses.scores, (&responses.cameras, responses.dilation), 1);
    let ladder = formats::ladder(output, model.degree());
    let mut files = Files { judge, model, responses, sequence, config, output, ladder, made: BTreeMap::new() };
    let mut search = Search::new(&mut files, model.len(), ladder.len());
    let found = search.find(aim)?;
    let tried = search.tried();
    judge.session.watcher.trying(1, 1);
    let chosen = match found {
        Found::Best(point) => point,
        Found::TooSmall(least) => {
            let name = output.extension().unwrap_or_default().to_string_lossy().to_uppercase();
            return Err(Error::Usage(format!(
                "the smallest {name} file of this model has one Gaussian and {least} bytes; give --size {} or more",
                readable(least)
            )));
        }
    };
    let bytes = files.made.remove(&(chosen.rung, chosen.gaussians)).expect("a file that was made");
    let merged = files.sequence.pairs(model, &responses.scores, chosen.gaussians);
    let plan = prune::of_pairs(merged, responses, begun);
    let record = AimRecord { aim, chosen, precision: ladder[chosen.rung], rungs: ladder.len(), tried };
    Ok(Fitted { plan, bytes, precision: ladder[chosen.rung], record })
}

/// A number of bytes for `--size`, rounded up.
fn readable(bytes: u64) -> String {
    format!("{}kB", bytes.div_ceil(1000))
}

/// The file of a model that loses little more than the model itself, whose PSNR in the judge's views is `psnr`: the coarsest settings
/// of its format for which that is so.
///
/// # Errors
/// Those of writing the file and of drawing its pictures.
pub fn written(
    judge: &Judge<'_>,
    model: &Gaussians,
    (config, psnr): (&CompressConfig, Option<f64>),
    output: &Path,
) -> Result<Vec<u8>, Error> {
    let ladder = formats::ladder(output, model.degree());
    let encode = |precision| formats::encode(output, model, config.style.mode(), precision).map_err(Error::writing);
    let last = ladder.len() - 1;
    let psnr = psnr.unwrap_or(f64::INFINITY);
    for precision in &ladder[..last] {
        if psnr.is_infinite() {
            break;
        }
        let bytes = encode(precision)?;
        if judge.psnr(&bytes, output)? >= psnr - MOST_LOSS {
            return Ok(bytes);
        }
    }
    encode(&ladder[last])
}

/// The file of a model at this precision in at most `most` bytes: Gaussians that show least are left out until it is small enough.
///
/// # Errors
/// Those of writing the file.
pub fn within(
    model: &mut Gaussians,
    (config, precision): (&CompressConfig, &Precision),
    most: u64,
    output: &Path,
) -> Result<Vec<u8>, Error> {
    loop {
        let bytes = formats::encode(output, model, config.style.mode(), precision).map_err(Error::writing)?;
        let length = bytes.len() as u64;
        if length <= most || model.len() < 2 {
            return Ok(bytes);
        }
        let excess = model.len() as f64 * (length - most) as f64 / length as f64;
        let left = model.len() - (1.1 * excess).ceil().clamp(1.0, model.len() as f64 - 1.0) as usize;
        let shown = |i: usize| {
            let sizes = model.log_scales[i];
            let area = sizes.iter().sum::<f32>() - sizes.iter().fold(f32::INFINITY, |a, s| a.min(*s));
            f64::from(area).exp() / (1.0 + f64::from(-model.opacity_logits[i]).exp())
        };
        let mut order: Vec<usize> = (0..model.len()).collect();
        order.sort_by(|a, b| shown(*b).total_cmp(&shown(*a)).then(a.cmp(b)));
        order.truncate(left);
        order.sort_unstable();
        *model = model.select(&order);
    }
}

/// What was chosen: `4.93 MB of 5 MB: 412,300 Gaussians, 35.8 dB`.
pub fn line(record: &AimRecord, bytes: u64, gaussians: usize) -> String {
    let Point { psnr, .. } = record.chosen;
    let psnr = psnr.filter(|v| v.is_finite()).map_or_else(|| "equal pictures".to_owned(), |v| format!("{v:.1} dB"));
    let asked = match record.aim {
        Aim::Bytes(size) => megabytes(size as f64, 2),
        Aim::Psnr(psnr) => format!("asked for {psnr} dB"),
    };
    format!("{} of {asked}: {}, {psnr}", megabytes(bytes as f64, 2), counted(gaussians, "Gaussian"))
        .replace("of asked", "asked")
}

fn megabytes(bytes: f64, digits: usize) -> String {
    let (value, unit) = if bytes < 1e6 { (bytes / 1e3, "kB") } else { (bytes / 1e6, "MB") };
    let text = format!("{value:.digits$}");
    format!("{} {unit}", text.trim_end_matches('0').trim_end_matches('.'))
}
