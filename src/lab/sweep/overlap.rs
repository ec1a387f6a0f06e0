//! The axis of overlap formulas: on the subject's own neighbouring pairs, on the thin ones among them, and on the same
//! Gaussians flattened.

use super::blocks;
use super::records::{AxisRecord, Table, figure};
use super::rung::{Formula, Rung};
use super::subject::Context;
use super::timing::{Sample, Timed, interleaved};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::qirf::assemble::{Assembly, Options};
use crate::qirf::overlap::{Method, Metric};
use crate::qirf::partition::Blocks;
use crate::qirf::plan::triangle;
use crate::qirf::study::Basis;
use crate::reference::overlap::{Primitive, SCALE_FLOOR, overlap};
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use std::time::Instant;

/// A Gaussian whose ratio of smallest to largest scale is below this is thin.
const THIN: f64 = 1.0 / 30.0;

fn primitives(model: &Gaussians) -> Vec<Primitive> {
    let one = |i: usize| Primitive::of(model.means[i], model.log_scales[i], model.rotations[i]);
    (0..model.len()).map(one).collect()
}

fn thin(p: &Primitive) -> bool {
    let [low, high] = [f64::min, f64::max].map(|f| p.scales.into_iter().reduce(f).unwrap_or(1.0));
    low < THIN * high
}

/// The same model with the Gaussians of each block flattened into one plane, as on a wall; their smallest scales are at
/// the floor of the overlaps.
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

/// Packed lower triangles of all blocks, one after the other, in the device's layout.
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

/// Errors of a formula on pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Fate {
    pairs: usize,
    nan: usize,
    worst: f64,
}

impl Fate {
    /// Errors of the pairs that `counts` selects by their positions in the packed triangles.
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

    /// The largest error; a NaN counts as the largest possible overlap.
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

/// Two masks of the packed entries: pairs, and pairs of two thin Gaussians.
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

/// A model, and the true overlaps within its blocks.
struct Case<'a> {
    blocks: &'a Blocks,
    resident: Resident,
    primitives: Vec<Primitive>,
    truth: Vec<f32>,
}

impl<'a> Case<'a> {
    fn new(context: &Context<'_>, model: &Gaussians, blocks: &'a Blocks) -> Result<Self, Error> {
        let primitives = primitives(model);
        let truth = twin(&primitives, blocks);
        Ok(Self { blocks, resident: Resident::upload(context.session.device, model)?, primitives, truth })
    }

    /// All packed overlaps by one formula.
    fn found(&self, context: &Context<'_>, formula: Formula) -> Result<Vec<f32>, Error> {
        let Formula::Device(method) = formula else { return Ok(self.truth.clone()) };
        let mut out = Vec::new();
        assembly(context, &self.resident, self.blocks, method)?.for_each(|batch| -> Result<(), Error> {
            batch.iter().for_each(|(_, m)| out.extend_from_slice(m.overlap));
            Ok(())
        })?;
        Ok(out)
    }

    /// Times of the formulas, taken in turn.
    fn times(&self, context: &Context<'_>, rungs: &[Rung<Formula>]) -> Result<Vec<Timed>, Error> {
        let ready = |rung: &Rung<Formula>| match rung.value {
            Formula::Twin => Ok(None),
            Formula::Device(method) => assembly(context, &self.resident, self.blocks, method).map(Some),
        };
        let ready: Vec<Option<Assembly<'_>>> = rungs.iter().map(ready).collect::<Result<_, _>>()?;
        interleaved(rungs.len(), context.seconds, 3, context.session.watcher, |k, _| match &ready[k] {
            None => Ok(Sample::host(|| twin(&self.primitives, self.blocks)).1),
            Some(assembly) => {
                let started = Instant::now();
                let timings = assembly.for_each(|_| -> Result<(), Error> { Ok(()) })?;
                Ok(Sample::of(context.session.device, &timings, &["overlap"], started))
            }
        })
    }
}

fn tables() -> [Table; 3] {
    [
        "The scene's own neighbouring pairs".to_owned(),
        format!("Of these, pairs of two thin Gaussians (thinner than 1:{:.0})", 1.0 / THIN),
        format!(
            "The same pairs, the Gaussians of each block laid into one plane and pressed to 1:{:.0}, as on a wall after long \
             training",
            1.0 / SCALE_FLOOR
        ),
    ]
    .map(|title| Table {
        title,
        columns: vec!["formula", "pairs", "NaN", "largest error of the rest"],
        rows: Vec::new(),
    })
}

pub fn measure(context: &Context<'_>, rungs: &[Rung<Formula>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let model = &context.subject.model;
    let blocks = blocks::sampled(model, Basis::default().partition);
    let own = Case::new(context, model, &blocks)?;
    let flat = Case::new(context, &pressed(model, &blocks), &blocks)?;
    let [pairs, thin_pairs] = kinds(&own.primitives, &blocks);
    let mut tables = tables();
    for Rung { name, value } in rungs {
        let (as_is, as_flat) = (own.found(context, *value)?, flat.found(context, *value)?);
        let fates = [
            Fate::of(&as_is, &own.truth, &pairs),
            Fate::of(&as_is, &own.truth, &thin_pairs),
            Fate::of(&as_flat, &flat.truth, &pairs),
        ];
        let mut rung = axis.rung(name);
        rung.accuracy = Some(fates[0].error());
        rung.exact = *value == Formula::Twin;
        let keys = [
            ("nan_share", "largest_error"),
            ("thin_nan_share", "thin_largest_error"),
            ("flat_nan_share", "flat_largest_error"),
        ];
        for ((table, fate), (nan_share, largest_error)) in tables.iter_mut().zip(fates).zip(keys) {
            rung.figures.insert(nan_share, fate.nan_share());
            rung.figures.insert(largest_error, fate.worst);
            table.rows.push(fate.cells(name));
        }
        axis.rungs.push(rung);
    }
    let timed = own.times(context, rungs)?;
    let [count, thin] = [&pairs, &thin_pairs].map(|kind| kind.iter().filter(|p| **p).count());
    let million = 1e6 / count.max(1) as f64;
    axis.rungs = axis.rungs.into_iter().zip(&timed).map(|(rung, t)| rung.timed(t, 1e3 * million)).collect();
    extra(&mut axis);
    let entries: usize = blocks.iter().map(|b| triangle(b.len())).sum();
    axis.notes.push(format!(
        "{count} pairs within {} blocks ({entries} entries); {:.1} % are pairs of two thin Gaussians. The float64 rung runs on all \
         threads of the host, and recomputes each Gaussian for every pair, because the reference code is kept simple.",
        blocks.len(),
        100.0 * thin as f64 / count.max(1) as f64
    ));
    axis.tables = tables.into();
    Ok(axis)
}

/// The cost of QR relative to the determinant, with its errors.
fn extra(axis: &mut AxisRecord) {
    let time = |name: &str| axis.rungs.iter().find(|r| r.name == name).and_then(|r| r.time).map(|t| t.median);
    let Some(qr) = time("qr") else { return };
    let name = "determinant";
    let (Some(other), Some(rung)) = (time(name), axis.rungs.iter().find(|r| r.name == name)) else { return };
    let of = |key: &str| rung.figures.get(key).copied().unwrap_or(f64::NAN);
    let over = 100.0 * (qr / other - 1.0);
    axis.notes.push(format!(
        "QR takes {:.0} % {} than {name}, which gives NaN for {} % of the pairs (of thin ones {} %, laid flat {} %) and is \
         wrong by up to {} elsewhere (laid flat by up to {}).",
        over.abs(),
        if over >= 0.0 { "longer" } else { "less time" },
        figure(100.0 * of("nan_share")),
        figure(100.0 * of("thin_nan_share")),
        figure(100.0 * of("flat_nan_share")),
        figure(of("largest_error")),
        figure(of("flat_largest_error")),
    ));
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
