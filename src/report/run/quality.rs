//! PSNR and number of Gaussians over the run.

use crate::job::records::{CameraErrors, CurvePoint, PruneRecord, RunRecord};
use crate::report::format::{decimals, percent};
use crate::report::page::{absent, side_by_side};
use crate::report::plot::{Axis, Line, Lines, Mark};
use maud::{Markup, html};

pub fn body(results: &RunRecord) -> Markup {
    let curve = &results.curve;
    if curve.is_empty() {
        return absent("No view was held out, so quality was not measured during training.");
    }
    let label = |p: &PruneRecord| {
        let removed = p.before.saturating_sub(p.after);
        format!("prune: −{}", percent(removed as f64, p.before as f64))
    };
    let marks = |x: &dyn Fn(&PruneRecord) -> f64| -> Vec<Mark> {
        results.prunes.iter().map(|p| Mark { x: x(p), label: label(p) }).collect()
    };
    let trained = curve.iter().filter_map(|p| Some([p.seconds, p.train_psnr?])).collect();
    let lines = vec![
        Line { name: "held out", points: curve.iter().map(|p| [p.seconds, p.psnr]).collect() },
        Line { name: "trained on", points: trained },
    ];
    let psnr = Lines {
        title: "PSNR of held-out and of training views",
        x: Axis::from_zero("seconds of training and pruning"),
        y: Axis::new("PSNR / dB"),
        lines,
        marks: marks(&|p| seconds(curve, p.iteration)),
    };
    let gaussians = Lines {
        title: "Gaussians",
        x: Axis::from_zero("iterations"),
        y: Axis::from_zero("Gaussians"),
        lines: vec![Line { name: "Gaussians", points: gaussians(results) }],
        marks: marks(&|p| f64::from(p.iteration)),
    };
    let past = results
        .told_past_best()
        .map(|told| format!("The run was {told}. From there on it fitted what the photos do not determine."));
    // Pictures that are equal to their photos have an infinite PSNR.
    let finite = results.camera_errors.filter(|errors| errors.fitted_psnr.is_finite());
    let cameras = finite.as_ref().map(moved);
    html! {
        (side_by_side(&[psnr, gaussians].map(|plot| plot.drawing().figure())))
        @if let Some(past) = past { p { (past) } }
        @if let Some(cameras) = cameras { p { (cameras) } }
    }
}

/// How far held-out views' cameras were moved, and how much better or worse they fit then.
fn moved(errors: &CameraErrors) -> String {
    let [before, after] = [errors.psnr, errors.fitted_psnr].map(|psnr| decimals(psnr, 2));
    let effect = if before == after {
        "changed the PSNR of the other squares by less than 0.01 dB".to_owned()
    } else {
        format!("changed the PSNR of the other squares from {before} to {after} dB")
    };
    format!(
        "Camera check: fitting each held-out camera to every other square of 8 × 8 pixels moved it by {} pixels (median of {}) and {effect}.",
        decimals(errors.pixels, 2),
        errors.views
    )
}

/// Time at which an iteration was done, interpolated between the points of the curve.
fn seconds(curve: &[CurvePoint], iteration: u32) -> f64 {
    let (mut before, mut at) = ((0, 0.0), f64::NAN);
    for point in curve {
        if point.iteration >= iteration {
            let share = f64::from(iteration - before.0) / f64::from((point.iteration - before.0).max(1));
            at = before.1 + share * (point.seconds - before.1);
            break;
        }
        before = (point.iteration, point.seconds);
        at = point.seconds;
    }
    at
}

/// Number of Gaussians by iteration: the start, the curve's points, and before and after each prune.
fn gaussians(results: &RunRecord) -> Vec<[f64; 2]> {
    let start = results.gaussians.initial.map(|n| (0, n));
    let mut points: Vec<(u32, usize)> =
        start.into_iter().chain(results.curve.iter().map(|p| (p.iteration, p.gaussians))).collect();
    for prune in &results.prunes {
        // The curve's point at that iteration was measured before the prune.
        let at = points.partition_point(|(iteration, _)| *iteration <= prune.iteration);
        points.splice(at..at, [(prune.iteration, prune.before), (prune.iteration, prune.after)]);
    }
    points.into_iter().map(|(iteration, n)| [f64::from(iteration), n as f64]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_fit_better_or_worse() {
        let told = |fitted_psnr| moved(&CameraErrors { views: 3, pixels: 0.5, psnr: 30.0, fitted_psnr });
        for (fitted, says) in [
            (30.25, "0.50 pixels (median of 3) and changed the PSNR of the other squares from 30.00 to 30.25 dB."),
            (29.96, "from 30.00 to 29.96 dB."),
            (30.001, "by less than 0.01 dB."),
        ] {
            assert!(told(fitted).ends_with(says), "{}", told(fitted));
        }
    }

    #[test]
    fn a_prune_is_found_in_time() {
        let point = |iteration, seconds| CurvePoint { iteration, seconds, psnr: 20.0, train_psnr: None, gaussians: 5 };
        let curve = [point(100, 10.0), point(200, 30.0)];
        assert_eq!([0, 50, 100, 150, 200, 250].map(|i| seconds(&curve, i)), [0.0, 5.0, 10.0, 20.0, 30.0, 30.0]);
        assert!(seconds(&[], 5).is_nan(), "and is not drawn");
    }
}
