//! Quality against bytes: the best files of several formats at several sizes, the loss by each attribute, and another tool's
//! files.

pub mod peer;

use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, Precision};
use crate::job::records::{Aim, AttributeLoss, CurveRecord, FileRecord, ModelFile};
use crate::job::{Error, Session};
use crate::metrics::{self, Scores};
use crate::pipeline::compress::fit::{Fitted, Fitter, Judge, Target};
use crate::pipeline::compress::scoring::Scoring;
use crate::pipeline::compress::views::Views;
use crate::pipeline::compress::{CompressConfig, Input, train};
use peer::Peer;
use std::path::PathBuf;

/// Number of sizes: that of the smallest whole model, then halves.
pub const SIZES: u32 = 6;
/// Index of the size whose settings are measured attribute by attribute.
const MIDDLE: u32 = 2;

/// Settings of a curve.
pub struct CurvePlan<'a> {
    /// Extensions of the formats.
    pub formats: &'a [String],
    /// Another tool whose files are measured, too.
    pub peer: Option<&'a Peer>,
}

/// Measures the best files of a model at several sizes.
pub fn curve(
    session: &Session<'_>,
    input: Input<'_>,
    config: &CompressConfig,
    plan: &CurvePlan<'_>,
) -> Result<CurveRecord, Error> {
    let Input { path, model, .. } = input;
    let (views, shown) = Views::exposed(session, &model, config)?;
    if views.test.is_empty() {
        let what = "a curve is measured on held-out photos, and there are none: give --eval-every 2 or more, and two photos at least";
        return Err(Error::Usage(what.to_owned()));
    }
    let responses = train::respond(session, shown.source(), model.degree(), &views, None, config)?;
    let judge = Judge::new(session, &views, shown.source(), false)?;
    drop(shown);
    let fitter = Fitter::new(&judge, &model, &responses, config);
    let names: Vec<PathBuf> = plan.formats.iter().map(|format| PathBuf::from(format!("model.{format}"))).collect();
    let whole = |name: &PathBuf| {
        let target = Target::new(name);
        target.pack(&model, config.style.mode(), target.usual(&model)).map(|packed| packed.len() as u64)
    };
    let largest = names.iter().map(whole).collect::<Result<Vec<_>, _>>()?.into_iter().min().unwrap_or(1);
    let mut scoring = Scoring::new(session, &views, config);
    let mut mean = |model: &Gaussians| -> Result<Scores, Error> {
        Ok(metrics::mean(&scoring.scores_of(model)?).unwrap_or_default())
    };
    let (mut files, mut attributes) = (Vec::new(), Vec::new());
    for (format, name) in plan.formats.iter().zip(&names) {
        let target = Target::new(name);
        for half in 0..SIZES {
            let wanted = largest >> half;
            let Fitted { packed, record, .. } = match fitter.fit(Aim::Bytes(wanted), &target) {
                // Less than a file of one Gaussian.
                Err(Error::Usage(_)) => break,
                fitted => fitted?,
            };
            let read = formats::read_bytes(&packed, name).map_err(Error::writing)?.gaussians;
            files.push(FileRecord {
                tool: "qirf-vk".to_owned(),
                format: format.clone(),
                wanted: Some(wanted),
                bytes: packed.len() as u64,
                gaussians: read.len(),
                scores: mean(&read)?,
                parts: formats::parts(&packed),
            });
            if half == MIDDLE {
                for (attribute, changed) in alone(&model, config, &target, record.precision)? {
                    let psnr = mean(&changed)?.psnr;
                    attributes.push(AttributeLoss { format: format.clone(), wanted, attribute, psnr });
                }
            }
        }
    }
    if let Some(peer) = plan.peer {
        for file in peer.files(session, &model, config.style.mode())? {
            let scores = mean(&file.model)?;
            let (tool, gaussians) = (peer.name(), file.model.len());
            let (format, parts) = (file.format.to_owned(), Vec::new());
            files.push(FileRecord { tool, format, wanted: None, bytes: file.bytes, gaussians, scores, parts });
        }
    }
    Ok(CurveRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: session.device.tuned(),
        protocol: views.protocol(config),
        input: ModelFile::of(path, &model),
        files,
        attributes,
    })
}

/// The whole model with one attribute stored at these settings, by attribute; none for formats that store floats.
fn alone(
    model: &Gaussians,
    config: &CompressConfig,
    target: &Target<'_>,
    precision: Precision,
) -> Result<Vec<(&'static str, Gaussians)>, Error> {
    let stored = |precision| -> Result<Gaussians, Error> {
        let packed = target.pack(model, config.style.mode(), precision)?;
        Ok(formats::read_bytes(&packed, target.format).map_err(Error::writing)?.gaussians)
    };
    match precision {
        // SOG changes the order: the others are stored as finely as it allows.
        Precision::Sog(steps) => {
            let attributes = steps.alone().into_iter().filter(|(name, _)| *name != "SH" || model.degree() > 0);
            attributes.map(|(name, steps)| Ok((name, stored(Precision::Sog(steps))?))).collect()
        }
        _ if target.format.extension().is_some_and(|e| e == "spz") => {
            let stored = stored(precision)?;
            let with = |change: fn(&mut Gaussians, &Gaussians)| {
                let mut changed = model.clone();
                change(&mut changed, &stored);
                changed
            };
            let mut all = vec![
                ("means", with(|model, stored| model.means.clone_from(&stored.means))),
                ("rotations", with(|model, stored| model.rotations.clone_from(&stored.rotations))),
                ("scales", with(|model, stored| model.log_scales.clone_from(&stored.log_scales))),
                ("colours", with(|model, stored| model.sh[0].clone_from(&stored.sh[0]))),
                ("opacities", with(|model, stored| model.opacity_logits.clone_from(&stored.opacity_logits))),
            ];
            if model.degree() > 0 {
                all.push(("SH", with(|model, stored| model.sh[1..].clone_from_slice(&stored.sh[1..]))));
            }
            Ok(all)
        }
        _ => Ok(Vec::new()),
    }
}
