//! Configurations derived from that of a run in blocks: of the coarse model, and of each block.

use super::layout::Block;
use crate::job::config::ResponseSource;
use crate::job::{Error, RunConfig};
use crate::random;
use crate::train::schedule::Schedule;

/// The run's iterations divided by the coarse model's: if blocks begin with it, and if they begin with points.
const COARSE: [u32; 2] = [4, 8];
/// Share of a block's iterations before the neighbours are replaced by the trained ones, if the run does not prune.
const HALF: f64 = 0.5;

/// Refuses runs that cannot be divided.
pub(super) fn check(config: &RunConfig) -> Result<(), Error> {
    let refused = |what: &str| Err(Error::Usage(format!("a run in blocks cannot {what}")));
    if config.method.is_some() {
        return refused("train by a method of another paper ([method] in config.toml)");
    }
    let Some(pruning) = &config.prune else { return Ok(()) };
    match pruning.iterations(config.schedule.iterations).len() {
        0 | 1 if pruning.responses == ResponseSource::Average => refused("average responses (--preset paper)"),
        0 | 1 => Ok(()),
        _ => refused("prune in several steps (--schedule gradual)"),
    }
}

/// The run of the coarse model, on pictures reduced by `divisor`; `points` is true if blocks begin with points.
pub(super) fn coarse(config: &RunConfig, divisor: u32, points: bool) -> RunConfig {
    let part = COARSE[usize::from(points)];
    let resolution = match config.resolution.as_deref() {
        None => Some(format!("/{divisor}")),
        Some(text) => match text.strip_prefix('/').map(str::parse::<u32>) {
            Some(k) => Some(format!("/{}", k.unwrap_or(1).saturating_mul(divisor))),
            None => Some((text.parse::<u32>().unwrap_or(divisor) / divisor).max(1).to_string()),
        },
    };
    let mut schedule = config.schedule.clone();
    schedule.iterations = (schedule.iterations / part).max(1);
    // The number is proportional to the root of pixels and iterations, as in `Growth::by_photos`.
    let share = 1.0 / (f64::from(divisor) * f64::from(part).sqrt());
    if let Some(plan) = &mut schedule.growth {
        plan.gaussians = plan.gaussians.map(|n| (n as f64 * share) as usize);
    }
    RunConfig { resolution, schedule, prune: None, ..config.clone() }
}

/// The iterations at which the legs of a block's training end. The blocks meet at the first three: before the prune;
/// halfway from there to the end, but not before attrition ends; and halfway from that to the end.
pub(super) fn ends(config: &RunConfig) -> [u32; 4] {
    let (length, schedule) = (config.schedule.iterations, &config.schedule);
    let at = |share: f64| (f64::from(length) * share).round() as u32;
    let pruning = config.prune.as_ref();
    let first = pruning.and_then(|p| p.iterations(length).first().copied());
    let first = first.unwrap_or_else(|| at(HALF.max(schedule.densify_until)));
    // The next iteration begins with the prune that ends attrition.
    let pruned = pruning.and_then(|p| p.attrition).map_or(0, |attrition| at(attrition.until) + 1);
    let second = first.midpoint(length).max(pruned).min(length);
    [first, second, second.midpoint(length), length]
}

/// The configuration of block number `b` of a run on `all` photos: as many rounds over its photos as the whole run
/// makes, in longer steps, and its share of the Gaussians.
pub(super) fn of_block(config: &RunConfig, block: &Block, b: usize, all: usize) -> RunConfig {
    let views = block.crops.len();
    let mut schedule = config.schedule.clone().for_block(views, all);
    // The coarse model has all bands.
    schedule.degree_every = 0.0;
    let part = |n: usize| (n as f64 * block.painted).ceil() as usize;
    if let Some(plan) = &mut schedule.growth {
        plan.gaussians = plan.gaussians.map(part);
    }
    let mut prune = config.prune.clone();
    if let Some(attrition) = prune.as_mut().and_then(|prune| prune.attrition.as_mut()) {
        attrition.opacity_rate *= Schedule::longer_steps(views, all);
    }
    let seed = random::bits(&[u64::from(config.seed), 1 + b as u64]) as u32;
    RunConfig { seed, schedule, prune, max_gaussians: part(config.max_gaussians).max(1), ..config.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::config::{Preset, Pruning};
    use crate::shard::blocks::Crop;

    fn run(iterations: u32) -> RunConfig {
        let mut config = RunConfig::sample(Preset::Standard);
        config.schedule = Preset::Standard.schedule(Some(iterations));
        if let Some(plan) = &mut config.schedule.growth {
            plan.gaussians = Some(1000);
        }
        config
    }

    #[test]
    fn the_coarse_model_is_a_short_run_on_small_pictures() {
        for (resolution, small) in [
            (None, "/4"),
            (Some("/2"), "/8"),
            (Some("/2147483648"), "/4294967295"),
            (Some("800"), "200"),
            (Some("3"), "1"),
        ] {
            let of = RunConfig { resolution: resolution.map(str::to_owned), ..run(1000) };
            let coarse = coarse(&of, 4, false);
            assert_eq!(coarse.resolution.as_deref(), Some(small));
            assert_eq!((coarse.schedule.iterations, coarse.prune), (250, None));
            // A quarter for the width, and half for the length.
            assert_eq!(coarse.schedule.growth.and_then(|plan| plan.gaussians), Some(125));
            assert_eq!(super::coarse(&of, 4, true).schedule.iterations, 125);
        }
    }

    #[test]
    fn blocks_make_as_many_rounds_and_grow_to_their_share() {
        let crop = |view| Crop { view, corner: [0, 0], size: [8, 8] };
        let block = Block { crops: (0..10).map(crop).collect(), painted: 0.3 };
        let whole = run(1000);
        let first = of_block(&whole, &block, 0, 40);
        assert_eq!((first.schedule.iterations, first.max_gaussians), (250, 1200));
        assert_eq!(first.schedule.growth.and_then(|plan| plan.gaussians), Some(300));
        let rate = |config: &RunConfig| config.prune.as_ref().and_then(|prune| prune.attrition).unwrap().opacity_rate;
        let pruned = whole.clone().pruned(Pruning::default());
        let of_pruned = of_block(&pruned, &block, 0, 40);
        assert!((rate(&of_pruned) / rate(&pruned) - 2.0).abs() < 1e-12 && first.schedule.forgetting == 4.0);
        let seeds = [whole.seed, first.seed, of_block(&whole, &block, 1, 40).seed];
        assert!(seeds[0] != seeds[1] && seeds[1] != seeds[2] && seeds[0] != seeds[2]);
        let empty = Block { crops: Vec::new(), painted: 0.0 };
        let none = of_block(&whole, &empty, 0, 40);
        assert_eq!((none.schedule.iterations, none.max_gaussians), (1, 1));
    }

    #[test]
    fn blocks_meet_at_the_prune_and_twice_more() {
        let mut config = run(1000);
        config.schedule.densify_until = 0.4;
        assert_eq!(ends(&config), [500, 750, 875, 1000]);
        config.schedule.densify_until = 0.7;
        assert_eq!(ends(&config), [700, 850, 925, 1000]);
        let pruning = |at: &[f64]| Pruning { at: at.to_vec(), ..Pruning::at_once() };
        let config = run(1000).pruned(pruning(&[0.6]));
        assert_eq!(ends(&config), [600, 800, 900, 1000]);
        assert!(check(&config).is_ok());
        let attrition = |at: f64| ends(&run(1000).pruned(Pruning { at: vec![at], ..Pruning::default() }));
        assert_eq!(Pruning::default().attrition.unwrap().until, 0.75);
        assert_eq!([attrition(0.5), attrition(0.6)], [[500, 751, 875, 1000], [600, 800, 900, 1000]]);
        let several = run(1000).pruned(pruning(&[0.5, 0.6]));
        assert!(matches!(check(&several), Err(Error::Usage(text)) if text.contains("gradual")));
    }
}
