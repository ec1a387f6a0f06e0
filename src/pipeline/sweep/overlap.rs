//! The axis of overlap formulas: on the subject's own neighbouring pairs, on the thin ones among them, and on the same
//! Gaussians laid flat.

use super::Context;
use super::axis::Axis;
use super::blocks;
use super::measure::{Sample, Timed, interleaved};
use super::results::{AxisRecord, Rung, Table, figure};
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::qirf::assemble::{Assembly, Options};
use crate::qirf::overlap::{Method, Metric};
use crate::qirf::partition::Blocks;
use crate::qirf::plan::triangle;
use crate::qirf::study::Basis;
use crate::reference::overlap::{Primitive, SCALE_FLOOR, overlap};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use std::time::Instant;

/// A Gaussian this much thinner than long is a thin one.
const THIN: f64 = 1.0 / 30.0;
/// The rung that the host computes.
const TWIN: &str = "qr-f64";

fn method(name: &str) -> Option<Method> {
    match name {
        "qr" => Some(Method::Qr),
        "cholesky" => Some(Method::CholeskyOfSum),
        "determinant" => Some(Method::Determinant),
        _ => None,
    }
}

fn primitives(model: &Gaussians) -> Vec<Primitive> {
    let one = |i: usize| Primitive {
        position: model.means[i].map(f64::from),
        scales: model.log_scales[i].map(|s| f64::from(s).exp()),
        quaternion: model.rotations[i].map(f64::from),
    };
    (0..model.len()).map(one).collect()
}

fn thin(p: &Primitive) -> bool {
    let [low, high] = [f64::min, f64::max].map(|f| p.scales.into_iter().reduce(f).unwrap_or(1.0));
    low < THIN * high
}

/// The same model with the Gaussians of each block laid into one plane, as on a wall, and their thinnest axes at the floor
/// that overlaps are taken with.
fn pressed(model: &Gaussians, blocks: &Blocks) -> Gaussians {
    let mut out = model.clone();
    for members in blocks.iter().filter(|m| !m.is_empty()) {
        let rotation = model.rotations[members[0] as usize];
        let [w, x, y, z] = rotation.map(f64::from);
        let turn = DQuat::from_xyzw(x, y, z, w);
        let normal = if turn.length() > 1e-9 { turn.normalize() * DVec3::Z } else { DVec3::Z };
        let at = |i: u32| DVec3::from_array(model.means[i as usize].map(f64::from));
        let centre = members.iter().map(|i| at(*i)).sum::<DVec3>() / members.len() as f64;
        for &i in members {
            let flat = at(i) - normal * normal.dot(at(i) - centre);
            let s = &mut out.log_scales[i as usize];
            s.sort_by(|a, b| b.total_cmp(a));
            s[2] = s[0] + SCALE_FLOOR.ln() as f32;
            out.means[i as usize] = flat.as_vec3().to_array();
            out.rotations[i as usize] = rotation;
        }
    }
    out
}

/// Packed lower triangles of all blocks, one after the other, as the device packs them.
fn twin(primitives: &[Primitive], blocks: &Blocks) -> Vec<f32> {
    let column = |members: &[u32], c: usize| -> Vec<f32> {
        let at = |r: usize| &primitives[members[r] as usize];
        let entry = |r: usize| if r == c { 1.0 } else { overlap(at(r), at(c)) as f32 };
        (c..members.len()).map(entry).collect()
    };
    let columns: Vec<(usize, usize)> =
        (0..blocks.len()).flat_map(|b| (0..blocks.block(b).len()).map(move |c| (b, c))).collect();
    columns.into_par_iter().flat_map_iter(|(b, c)| column(blocks.block(b), c)).collect()
}

/// How a formula fares on pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Fate {
    pairs: usize,
    nan: usize,
    worst: f64,
}

impl Fate {
    /// Over the pairs that `counts` takes: their places are those of the packed triangles.
    fn of(found: &[f32], truth: &[f32], counts: &[bool]) -> Self {
        let mut fate = Self::default();
        for ((n, t), _) in found.iter().zip(truth).zip(counts).filter(|(_, c)| **c) {
            fate.pairs += 1;
            if n.is_nan() {
                fate.nan += 1;
            } else {
                fate.worst = fate.worst.max(f64::from((n - t).abs()));
            }
        }
        fate
    }

    fn nan_share(&self) -> f64 {
        self.nan as f64 / self.pairs.max(1) as f64
    }

    /// A NaN is an error as large as an overlap can have.
    fn error(&self) -> f64 {
        if self.nan > 0 { self.worst.max(1.0) } else { self.worst }
    }

    fn cells(&self, name: &str) -> Vec<String> {
        vec![
            name.to_owned(),
            self.pairs.to_string(),
            format!("{} %", figure(100.0 * self.nan_share())),
            figure(self.worst),
        ]
    }
}

/// Which packed entries are pairs at all, and which of them of two thin Gaussians.
fn kinds(primitives: &[Primitive], blocks: &Blocks) -> [Vec<bool>; 2] {
    let (mut pairs, mut thin_pairs) = (Vec::new(), Vec::new());
    let is_thin: Vec<bool> = primitives.iter().map(thin).collect();
    for members in blocks.iter() {
        for c in 0..members.len() {
            for r in c..members.len() {
                pairs.push(r != c);
                thin_pairs.push(r != c && is_thin[members[r] as usize] && is_thin[members[c] as usize]);
            }
        }
    }
    [pairs, thin_pairs]
}

fn assembly<'a>(
    context: &Context<'_>,
    resident: &'a Resident,
    blocks: &Blocks,
    method: Method,
) -> Result<Assembly<'a>, Error> {
    let options = Options { metric: Metric { method, ..Metric::default() }, ..Options::default() };
    Ok(Assembly::new(context.session.device, resident, &blocks.members, &blocks.starts, &[], options)?)
}

/// All packed overlaps by one formula of the device.
fn found(context: &Context<'_>, resident: &Resident, blocks: &Blocks, method: Method) -> Result<Vec<f32>, Error> {
    let mut out = Vec::new();
    assembly(context, resident, blocks, method)?.for_each(|batch| -> Result<(), Error> {
        batch.iter().for_each(|(_, m)| out.extend_from_slice(m.overlap));
        Ok(())
    })?;
    Ok(out)
}

/// Climbs the axis.
///
/// # Errors
/// Device memory; device errors; [`Error::Interrupted`].
pub fn climb(context: &Context<'_>, rungs: &[String]) -> Result<AxisRecord, Error> {
    let model = &context.subject.model;
    let resident = Resident::upload(context.session.device, model)?;
    let blocks = blocks::sampled(model, Basis::default().partition);
    let own = primitives(model);
    let truth = twin(&own, &blocks);
    let [pairs, thin_pairs] = kinds(&own, &blocks);
    let mut axis = AxisRecord::new(
        Axis::Overlap,
        "Overlap of two Gaussians",
        ["largest error of an overlap, a NaN counting as 1", "QR in float64, pair by pair", "ms a million pairs"],
    );
    let mut tables = [
        "The scene's own neighbouring pairs",
        "Of these, pairs of two thin Gaussians",
        "The same pairs, the Gaussians of each block laid into one plane",
    ]
    .map(|title| Table {
        title: title.to_owned(),
        columns: vec!["formula", "pairs", "NaN", "largest error of the rest"],
        rows: Vec::new(),
    });
    tables[1].title += &format!(" (thinner than 1:{:.0})", 1.0 / THIN);
    tables[2].title += &format!(" and pressed to 1:{:.0}, as on a wall after long training", 1.0 / SCALE_FLOOR);

    let flat_model = pressed(model, &blocks);
    let flat = Resident::upload(context.session.device, &flat_model)?;
    let flat_truth = twin(&primitives(&flat_model), &blocks);
    for name in rungs {
        let (as_is, as_flat) = match method(name) {
            None => (truth.clone(), flat_truth.clone()),
            Some(m) => (found(context, &resident, &blocks, m)?, found(context, &flat, &blocks, m)?),
        };
        let fates = [
            Fate::of(&as_is, &truth, &pairs),
            Fate::of(&as_is, &truth, &thin_pairs),
            Fate::of(&as_flat, &flat_truth, &pairs),
        ];
        let mut rung = Rung::new(Axis::Overlap, name);
        rung.accuracy = Some(fates[0].error());
        rung.exact = name == TWIN;
        rung.figures.insert("nan_share", fates[0].nan_share());
        rung.figures.insert("largest_error", fates[0].worst);
        rung.figures.insert("thin_nan_share", fates[1].nan_share());
        rung.figures.insert("thin_largest_error", fates[1].worst);
        rung.figures.insert("flat_nan_share", fates[2].nan_share());
        rung.figures.insert("flat_largest_error", fates[2].worst);
        for (table, fate) in tables.iter_mut().zip(fates) {
            table.rows.push(fate.cells(name));
        }
        axis.rungs.push(rung);
    }

    let million: f64 = 1e6 / pairs.iter().filter(|p| **p).count().max(1) as f64;
    let ready: Vec<Option<Assembly<'_>>> = rungs
        .iter()
        .map(|r| method(r).map(|m| assembly(context, &resident, &blocks, m)).transpose())
        .collect::<Result<_, _>>()?;
    let timed: Vec<Timed> =
        interleaved(rungs.len(), (context.seconds, 3), context.session.watcher, |k, _| match &ready[k] {
            None => Ok(Sample::host(|| twin(&own, &blocks)).1),
            Some(assembly) => {
                let started = Instant::now();
                let timings = assembly.for_each(|_| -> Result<(), Error> { Ok(()) })?;
                Ok(Sample::of(context.session.device, &timings, &["overlap"], started))
            }
        })?;
    axis.rungs = axis.rungs.into_iter().zip(&timed).map(|(rung, t)| rung.timed(t, 1e3 * million)).collect();
    extra(&mut axis);
    let entries: usize = blocks.iter().map(|b| triangle(b.len())).sum();
    axis.notes.push(format!(
        "{} pairs within {} blocks ({entries} entries); {:.1} % are pairs of two thin Gaussians. The float64 rung runs on all of the \
         host's threads and, as a twin that is to be obvious, prepares each Gaussian anew for every pair.",
        pairs.iter().filter(|p| **p).count(),
        blocks.len(),
        100.0 * thin_pairs.iter().filter(|p| **p).count() as f64 / pairs.iter().filter(|p| **p).count().max(1) as f64
    ));
    axis.tables = tables.into();
    Ok(axis
        .judged(["the device spends its time on reading pairs.", "no pair is thin enough to tell the formulas apart."]))
}

/// What QR costs over each of the others, beside what they lose.
fn extra(axis: &mut AxisRecord) {
    let time = |name: &str| axis.rungs.iter().find(|r| r.name == name).and_then(|r| r.time).map(|t| t.median);
    let Some(qr) = time("qr") else { return };
    let mut said = Vec::new();
    for name in ["cholesky", "determinant"] {
        let (Some(other), Some(rung)) = (time(name), axis.rungs.iter().find(|r| r.name == name)) else { continue };
        let of = |key: &str| rung.figures.get(key).copied().unwrap_or(f64::NAN);
        let over = 100.0 * (qr / other - 1.0);
        said.push(format!(
            "QR takes {:.0} % {} than {name}, which gives NaN for {} % of the pairs (of thin ones {} %, laid flat {} %) and is \
             wrong by up to {} elsewhere (laid flat by up to {})",
            over.abs(),
            if over >= 0.0 { "longer" } else { "less time" },
            figure(100.0 * of("nan_share")),
            figure(100.0 * of("thin_nan_share")),
            figure(100.0 * of("flat_nan_share")),
            figure(of("largest_error")),
            figure(of("flat_largest_error")),
        ));
    }
    if !said.is_empty() {
        axis.notes.push(format!("{}.", said.join("; ")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nan_is_the_worst_error() {
        let fate = Fate::of(&[f32::NAN, 0.5, 0.25, 9.0], &[0.0, 0.5, 0.0, 0.0], &[true, true, true, false]);
        assert_eq!(fate, Fate { pairs: 3, nan: 1, worst: 0.25 });
        assert_eq!((fate.error(), Fate { nan: 0, ..fate }.error()), (1.0, 0.25));
    }
}
