//! Decisions by a short training ahead of a run, on effects of which the capture itself tells nothing.

use super::decision::Decision;
use super::effect::Effect;

/// Gain in dB of photos that a short training withheld above which exposures are learnt: their pictures as rendered lose, since no model
/// knows the exposure of a photo that it has not seen.
pub const GAIN: f64 = 0.5;
/// Least movement of withheld photos' cameras in pixels, to fit a model trained without them, and least gain by it in
/// dB, at which poses count as wrong.
pub const MOVED: f64 = 0.3;
/// Smallest number of photos to train on: of fewer, the others show too little of what a withheld one shows.
const FEWEST_PHOTOS: usize = 32;
/// Iterations on each photo, and least number of all.
const LOOKS: usize = 6;
const LEAST: u32 = 500;
/// Largest share of the run's iterations, of each of two trainings. Runs that are too short for [`LEAST`] have no trial.
const SHARE: u32 = 14;

/// Length of the trial of a run of this many iterations and photos; none if it has no trial.
pub fn trial_length(iterations: u32, photos: usize) -> Option<u32> {
    let wanted = ((LOOKS * photos) as u32).max(LEAST).min(iterations / SHARE);
    (photos >= FEWEST_PHOTOS && wanted >= LEAST).then_some(wanted)
}

/// Returns true if the scene is to decide on an effect, and nothing measured it.
pub fn untold(decisions: &[Decision], effect: Effect) -> bool {
    decisions.iter().any(|d| d.name == effect && d.is_untold())
}

/// Exposure, by photos that two short trainings withheld: their PSNR in dB without and with an exposure of each photo trained on, with
/// colours fitted to one half of each withheld photo and scored on the other.
pub fn exposure_by_trial([without, with]: [f64; 2]) -> Decision {
    let gain = with - without;
    let evidence = format!("exposures change the PSNR of withheld photos by {gain:+.2} dB (from {without:.2})");
    Decision::by(Effect::Exposure, gain, GAIN, evidence)
}

/// Poses, by photos that a short training withheld: how far their cameras move to fit its model, in pixels, and their PSNR in dB
/// before and after. Both have to tell, since a model that shows little of a photo fits it from elsewhere as well.
pub fn poses_by_trial(pixels: f64, [given, fitted]: [f64; 2]) -> Decision {
    let gain = fitted - given;
    let evidence = format!(
        "cameras of photos that a short training withheld move by {pixels:.2} pixels to fit its model (median); \
         their PSNR changes by {gain:+.2} dB"
    );
    let measured = if gain.is_nan() { 0.0 } else { pixels.min(gain) };
    Decision::by(Effect::Poses, measured, MOVED, evidence)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_takes_a_seventh_of_a_run_at_most() {
        assert_eq!(trial_length(30_000, 84), Some(504));
        assert_eq!((trial_length(14_000, 300), trial_length(30_000, 300)), (Some(1000), Some(1800)));
        assert_eq!(
            (trial_length(7_000, 40), trial_length(6_999, 40), trial_length(30_000, 31)),
            (Some(500), None, None)
        );
    }

    #[test]
    fn photos_that_equal_their_pictures_tell_nothing_of_poses() {
        assert!(poses_by_trial(2.0, [20.0, 22.0]).on);
        assert!(!poses_by_trial(2.0, [f64::INFINITY; 2]).on);
    }
}
