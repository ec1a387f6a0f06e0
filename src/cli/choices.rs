//! Options for choosing Gaussians, shared by run, compress and compare. Options that are not given keep the preset's
//! values.

use super::values;
use crate::job::config::{PruneRule, ranges};
use crate::job::{Error, RunConfig};
use crate::qirf::participation::Eigensolver;
use crate::qirf::partition::Partition;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use crate::qirf::study::Overlap;
use clap::Args;

/// Options of compression.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Compression")]
pub(super) struct Choices {
    /// Share of the Gaussians to keep, detail included [default: 0.28; preset paper: at least 0.22 of each block, and detail]
    #[arg(long, value_name = "SHARE", value_parser = values::share, conflicts_with = "target_count")]
    keep: Option<f64>,
    /// Keep this number of Gaussians, or all if there are fewer
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    target_count: Option<u32>,
    /// Rule that selects Gaussians: pairs merges pairs of neighbours; the others rank Gaussians and keep the first [default:
    /// css; compress: pairs; preset paper: gnso]
    #[arg(long, value_name = "NAME", value_parser = values::named("a selector", &Selector::ALL, Selector::name))]
    pub selector: Option<Selector>,
    /// Budget: every block keeps its share (per-block), the best of the whole scene are kept (global), or half of each (hybrid)
    /// [default: hybrid; compress without --fine-tune and preset paper: per-block]
    #[arg(long, value_name = "NAME", value_parser = values::named("a budget", &Budget::ALL, Budget::name))]
    budget: Option<Budget>,
    /// Share of the Gaussians that is reserved for small, visible detail; at most a fifth of those kept [default: 0.05]
    #[arg(long, value_name = "SHARE", value_parser = values::share_or_none)]
    detail: Option<f64>,
    /// Merge the colour and opacity of dropped Gaussians into the kept ones that they overlap; without a value, true [default:
    /// true; preset paper: false]
    #[arg(long, value_name = "true|false", num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    merge: Option<bool>,
    /// Partition into blocks: adaptive (optionally with the most Gaussians of a block), paper, or the edge of a block in world
    /// units [default: adaptive; preset paper: paper]
    #[arg(long, value_name = "adaptive[:MOST]|paper|EDGE", value_parser = values::partition)]
    partition: Option<Partition>,
    /// Overlaps in the metric: of Gaussians of unit norm (normalised), or as in the paper's literal text (raw) [default:
    /// normalised]
    #[arg(long, value_name = "NAME", value_parser = values::named("a kind of overlap", &Overlap::ALL, Overlap::name))]
    overlap: Option<Overlap>,
    /// Number of median scales by which Gaussians are widened before overlaps are computed [default: 0]
    #[arg(long, value_name = "T", value_parser = values::not_negative)]
    dilate: Option<f64>,
    /// Eigensolver of the blocks: for the whole problem (dsygvd), by Cholesky and an 8 x 8 eigenproblem (low-rank; in float32:
    /// low-rank-f32), or by the same in float32 on the device (device) [default: low-rank; preset paper: dsygvd]
    #[arg(long, value_name = "NAME", value_parser = values::named("an eigensolver", &Eigensolver::ALL, Eigensolver::name))]
    solver: Option<Eigensolver>,
    /// Number added to the metric's diagonal [default: 1e-4]
    #[arg(long, value_name = "E", value_parser = values::not_negative)]
    epsilon: Option<f64>,
}

impl Choices {
    /// True if a share or a number of Gaussians is given.
    pub fn counts(&self) -> bool {
        self.keep.is_some() || self.target_count.is_some()
    }

    /// The first of these options that is given.
    pub fn given(&self) -> Option<&'static str> {
        let others = [
            ("--keep", self.keep.is_some()),
            ("--target-count", self.target_count.is_some()),
            ("--selector", self.selector.is_some()),
        ];
        first(others).or_else(|| self.of_rankings())
    }

    /// The preset with the given options in place of its own.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that the selector does not read, and for overlaps that the solver does not.
    pub fn over(&self, mut preset: PruneRule) -> Result<PruneRule, Error> {
        fn set<T: Copy>(to: &mut T, given: Option<T>) {
            *to = given.unwrap_or(*to);
        }
        let count = self.target_count.map(|n| Keep::Count(n as usize));
        set(&mut preset.keep, self.keep.map(Keep::Share).or(count));
        set(&mut preset.selector, self.selector);
        set(&mut preset.budget, self.budget);
        set(&mut preset.detail, self.detail);
        set(&mut preset.merge, self.merge);
        set(&mut preset.basis.partition, self.partition);
        set(&mut preset.basis.overlap, self.overlap);
        set(&mut preset.basis.dilate, self.dilate);
        set(&mut preset.basis.solver, self.solver);
        set(&mut preset.basis.epsilon, self.epsilon);
        if let Some(option) = self.of_rankings().filter(|_| preset.selector == Selector::Pairs) {
            return Err(Error::Usage(format!(
                "the selector pairs merges over the whole model and does not read {option}; choose another selector, such as \
                 --selector css"
            )));
        }
        ranges::overlap(&preset.basis).map_err(refused)?;
        Ok(preset)
    }

    /// An option that was given and that only selectors read which rank.
    fn of_rankings(&self) -> Option<&'static str> {
        first([
            ("--budget", self.budget.is_some()),
            ("--detail", self.detail.is_some()),
            ("--merge", self.merge.is_some()),
            ("--partition", self.partition.is_some()),
            ("--overlap", self.overlap.is_some()),
            ("--dilate", self.dilate.is_some()),
            ("--solver", self.solver.is_some()),
            ("--epsilon", self.epsilon.is_some()),
        ])
    }
}

/// The first option that is marked as given.
pub(super) fn first<const N: usize>(options: [(&'static str, bool); N]) -> Option<&'static str> {
    options.into_iter().find(|(_, given)| *given).map(|(name, _)| name)
}

/// Fields of `config.toml` that the parsers of options do not check, or not entirely, each with its option.
const OPTIONS: [(&str, &str); 8] = [
    ("eval_every", "--eval-every"),
    ("init_count", "--init-count"),
    ("prune.compression.keep.share", "--keep"),
    ("prune.compression.keep.count", "--target-count"),
    ("prune.compression.basis.partition.paper.voxel", "--partition"),
    ("prune.compression.basis.dilate", "--dilate"),
    ("prune.compression.basis.epsilon", "--epsilon"),
    ("prune.compression.basis.overlap = \"raw\"", "--overlap raw with --solver device"),
];

/// The error of a field's check in the words of the command line.
fn refused(fault: String) -> Error {
    let told = OPTIONS.iter().find_map(|(field, option)| Some(format!("{option}{}", fault.strip_prefix(*field)?)));
    Error::Usage(told.unwrap_or(fault))
}

/// The configuration, if it would be accepted in a `config.toml`: what is trained with it can be read again.
///
/// # Errors
/// [`Error::Usage`] with the option, or the field, that is out of its range.
pub(super) fn checked(config: RunConfig) -> Result<RunConfig, Error> {
    ranges::check(&config).map_err(refused)?;
    Ok(config)
}
