//! Numeric checks of a device against the host. `qirf-vk selftest` runs them on the user's machine, since drivers
//! differ. Each room adds its cases to [`cases`]; a case computes a result on the device and on the host, and reports
//! the error measured and the error allowed.

mod adam;
pub mod backward;
mod fingerprint;
#[doc(hidden)]
pub mod hard;
pub mod loss;
pub mod overlap;
#[doc(hidden)]
pub mod participation;
pub mod primitives;
pub mod project;
mod random;
mod rasterise;
mod run;

pub use fingerprint::fingerprint;
pub use run::{News, run};

use crate::gpu::{self, Device, Groups, Recording};
use crate::kernels::probe::{Loop, LoopPush, LoopSpec};
use crate::qirf::participation::Eigensolver;
use crate::render::{Settings, Style};
use participation::by_solver;
use primitives::{MANY_PAIRS, compactions, large_total, many_blocks, scans, sort_kinds, sorts};
use random::Kind;
use rasterise::{CROSSED, DISCS, DUST, MILD, NEEDLES, SATURATED, against_twin};
use serde::Serialize;

/// A rounding error of up to this many times its bound is a warning, and a larger one a wrong result. Every bound holds
/// on llvmpipe at four subgroup sizes, with both variants of kernels, with sums in reverse order, and with every
/// exponential, logarithm, root and quotient off by two units in the last place: another device's rounding stays below
/// it, or little above. Mistakes in formulas are far above: of eleven, each exceeded a bound 23 times or more
/// (docs/numerics.md).
pub const ROUNDING: f64 = 4.0;

/// Comparison of an error with its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within its bound.
    Pass,
    /// Beyond its bound, but by less than [`ROUNDING`]: explained by a device that rounds differently.
    Rounding,
    /// A wrong result, or no result.
    Wrong,
}

/// One number that was checked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// The part of the engine.
    pub room: &'static str,
    /// The quantity computed, and the measure of its error.
    pub name: String,
    /// The error measured; `None` if the case could not be run or gave NaN.
    pub seen: Option<f64>,
    /// The error allowed.
    pub allowed: f64,
    /// Comparison of the two.
    pub verdict: Verdict,
    /// The reason why the case could not be run.
    pub problem: Option<String>,
}

impl Check {
    /// True if the error measured is within the error allowed.
    pub fn passed(&self) -> bool {
        self.verdict == Verdict::Pass
    }
}

/// A bound.
#[derive(Clone, Copy, Debug)]
enum Allowed {
    /// For rounding errors, which are similar on all devices.
    Rounding(f64),
    /// For everything else: a count, or a value that rounding cannot exceed.
    Exact(f64),
}

impl Allowed {
    fn value(self) -> f64 {
        let (Self::Rounding(most) | Self::Exact(most)) = self;
        most
    }

    fn verdict(self, seen: Option<f64>) -> Verdict {
        match (seen, self) {
            (Some(seen), _) if seen <= self.value() => Verdict::Pass,
            (Some(seen), Self::Rounding(most)) if seen <= ROUNDING * most => Verdict::Rounding,
            _ => Verdict::Wrong,
        }
    }
}

/// (measure, error measured, error allowed).
type Measure = (&'static str, f64, Allowed);
type Body = fn(&Device) -> gpu::Result<Vec<Measure>>;

/// A case: one computation, checked by one or more measures.
pub struct Case {
    room: &'static str,
    name: &'static str,
    quick: bool,
    body: Body,
}

impl Case {
    /// The part of the engine that the case tests.
    pub fn room(&self) -> &'static str {
        self.room
    }

    /// The quantity it computes.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Runs the case; a device error is a failed check with its reason.
    ///
    /// # Errors
    /// A lost device or a lack of memory: neither shows that numbers are wrong.
    pub fn run(&self, device: &Device) -> gpu::Result<Vec<Check>> {
        let check = |name, seen: Option<f64>, allowed: Allowed, problem| {
            let (allowed, verdict) = (allowed.value(), allowed.verdict(seen));
            Check { room: self.room, name, seen, allowed, verdict, problem }
        };
        Ok(match (self.body)(device) {
            Ok(measures) => measures
                .into_iter()
                .map(|(measure, seen, allowed)| {
                    check(format!("{}, {measure}", self.name), Some(seen).filter(|s| !s.is_nan()), allowed, None)
                })
                .collect(),
            Err(e) if e.is_lost() || e.is_resources() => return Err(e),
            Err(e) => vec![check(self.name.to_owned(), None, Allowed::Exact(0.0), Some(e.to_string()))],
        })
    }
}

/// A case of both the quick and the full run.
const fn quick(room: &'static str, name: &'static str, body: Body) -> Case {
    Case { room, name, quick: true, body }
}

/// A case of the full run only.
const fn full(room: &'static str, name: &'static str, body: Body) -> Case {
    Case { room, name, quick: false, body }
}

const CASES: &[Case] = &[
    quick("driver", "loop of 100,000 steps", long_loop),
    quick("scan", "sizes up to 65,537", |d| scans(d, 0)),
    full("scan", "sizes up to 1,000,003, many blocks", |d| scans(d, many_blocks(d))),
    full("scan", "total beyond 32 bits", large_total),
    quick("sort", "sizes up to 65,537", |d| sorts(d, 0)),
    quick("sort", "few bits, ties, orders", |d| sort_kinds(d, 0)),
    full("sort", "sizes up to 1,000,003, many blocks", |d| sorts(d, MANY_PAIRS)),
    full("sort", "few bits, ties, orders, many blocks", |d| sort_kinds(d, MANY_PAIRS)),
    quick("compact", "sizes up to 65,537", |d| compactions(d, 0)),
    full("compact", "sizes up to 1,000,003, many blocks", |d| compactions(d, many_blocks(d))),
    quick("overlap", "known pairs", overlap::known),
    quick("overlap", "500 random pairs", |d| overlap::random(d, 500)),
    full("overlap", "10,000 random pairs", |d| overlap::random(d, 10_000)),
    quick("participation", "dsygvd", |_| by_solver(Eigensolver::Dsygvd)),
    quick("participation", "low-rank", |_| by_solver(Eigensolver::LowRank)),
    quick("participation", "low-rank-f32", |_| by_solver(Eigensolver::LowRankF32)),
    quick("participation", "device", participation::on_device),
    quick("participation", "no Gram matrix", participation::indefinite),
    quick("project", "near plane to 1e6 away", |d| project::all(d, &project::places(), backward::ALLOWED)),
    // For a Gaussian that covers everything, the pixels' shares nearly cancel: the order in which a device adds its lanes
    // changes the sum by a relative 4e-4 (3e-5 one lane after the other, 4e-4 in pairs, llvmpipe).
    full("project", "scales e^-30 to e^20", |d| project::all(d, &project::scales(), 3.0 * backward::ALLOWED)),
    full("project", "quaternions of any length", |d| project::all(d, &project::rotations(), backward::ALLOWED)),
    full("project", "opacity logits to infinity", |d| project::all(d, &project::logits(), backward::ALLOWED)),
    quick("rasterise", "mild, SH 3", |d| against_twin(d, &MILD, before_blue())),
    full("rasterise", "needles", |d| against_twin(d, &Kind { seed: 12, ..NEEDLES }, Settings::default())),
    full("rasterise", "flat discs", |d| against_twin(d, &Kind { seed: 13, ..DISCS }, Settings::default())),
    full("rasterise", "saturated", |d| against_twin(d, &Kind { seed: 14, ..SATURATED }, Settings::default())),
    full("rasterise", "anti-aliased dust", rasterise::antialiased),
    full("rasterise", "depth order by tile", |d| against_twin(d, &Kind { seed: 17, ..CROSSED }, in_depth_order())),
    full("rasterise", "odd sizes", rasterise::odd_sizes),
    full("rasterise", "1,048,592 x 1 pixels", rasterise::widest),
    full("rasterise", "100,000 layers in a tile", rasterise::deep),
    full("rasterise", "10,000 coincident", rasterise::ties),
    quick("rasterise", "same again", rasterise::repeat),
    quick("rasterise", "culling off and on", rasterise::culling),
    quick("backward", "mild, SH 3", |d| backward::random(d, &Kind { count: 200, seed: 21, ..MILD }, before_blue())),
    full("backward", "needles", |d| {
        backward::random(d, &Kind { count: 200, seed: 22, ..NEEDLES }, Settings::default())
    }),
    full("backward", "flat discs", |d| {
        backward::random(d, &Kind { count: 200, seed: 23, ..DISCS }, Settings::default())
    }),
    full("backward", "saturated", |d| {
        backward::random(d, &Kind { count: 200, seed: 24, ..SATURATED }, Settings::default())
    }),
    full("backward", "anti-aliased dust", |d| {
        backward::random(d, &Kind { count: 1000, seed: 25, ..DUST }, antialiased())
    }),
    full("backward", "10,000 coincident", backward::coincident),
    full("backward", "10,000 layers, no stop", backward::chain),
    full("backward", "layers alike", backward::alike),
    quick("adam", "five steps", adam::ordinary),
    full("adam", "gradients", adam::extremes),
    quick("ssim", "noise", loss::noise),
    full("ssim", "constant", loss::constant),
    full("ssim", "saturated", loss::saturated),
];

/// The cases, all or only the quick ones, in their order.
pub fn cases(only_quick: bool) -> impl Iterator<Item = &'static Case> {
    CASES.iter().filter(move |c| c.quick || !only_quick)
}

fn before_blue() -> Settings {
    Settings { background: [0.2, 0.4, 0.6], ..Settings::default() }
}

fn in_depth_order() -> Settings {
    Style { depth_order: true, ..Style::default() }.over([0.0; 3])
}

fn antialiased() -> Settings {
    Style { antialias: true, ..Style::default() }.over([0.0; 3])
}

/// Checks that a loop of 100,000 iterations runs to its end: some drivers silently end long loops early.
fn long_loop(device: &Device) -> gpu::Result<Vec<Measure>> {
    let iterations = 100_000_u32;
    let result = device.upload("loop", &[0_u32])?;
    let mut recording = Recording::new();
    let kernel = Loop { result: &result, push: LoopPush { iterations }, spec: LoopSpec::default() };
    recording.dispatch(&kernel, Groups::Count(1));
    device.run(recording)?;
    let expected = (1..=iterations).fold(0_u32, u32::wrapping_add);
    let wrong = result.read(device)?.first() != Some(&expected);
    Ok(vec![("wrong sums", f64::from(u8::from(wrong)), Allowed::Exact(0.0))])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_quick_case_is_a_case_and_no_number_is_no_pass() {
        assert!(cases(true).count() < cases(false).count());
        assert_eq!(Allowed::Rounding(1.0).verdict(None), Verdict::Wrong);
    }

    #[test]
    fn little_too_much_is_rounding_and_much_is_wrong() {
        let verdicts = |allowed: Allowed| [1.0, 1.1, ROUNDING, 1.01 * ROUNDING].map(|seen| allowed.verdict(Some(seen)));
        let [pass, rounding, wrong] = [Verdict::Pass, Verdict::Rounding, Verdict::Wrong];
        assert_eq!(verdicts(Allowed::Rounding(1.0)), [pass, rounding, rounding, wrong]);
        assert_eq!(verdicts(Allowed::Exact(1.0)), [pass, wrong, wrong, wrong]);
        assert_eq!(Allowed::Rounding(0.0).verdict(Some(f64::MIN_POSITIVE)), wrong);
        assert_eq!(Allowed::Rounding(1.0).verdict(Some(f64::INFINITY)), wrong);
    }
}
