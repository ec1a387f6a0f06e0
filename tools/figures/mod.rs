//! `docs/performance.md`'s tables and plots, from what the benchmarks and a sweep left: the work of `make figures`.

mod bound;
mod effects;
mod fit;
mod kernels;
mod markers;
mod measured;
mod pictures;
mod sweep;
mod tables;

pub use markers::fill;
pub use measured::Bench;
pub use sweep::Sweep;

/// What the figures were taken with, as the page says it.
pub struct Origin {
    /// Of the working tree.
    pub commit: String,
    /// That takes them again.
    pub command: String,
}

/// The parts of a page that are generated, by the names of their markers.
pub type Parts = Vec<(&'static str, String)>;

/// Everything that the figures are: parts of `docs/performance.md`, parts of README, and files of plots.
///
/// # Errors
/// What is missing among the measurements.
pub fn made(bench: &Bench, sweep: &Sweep, origin: &Origin) -> Result<[Parts; 3], String> {
    let page = vec![
        ("device", tables::device(bench, origin)?),
        ("sort", tables::sort(bench)?),
        ("frame", pictures::frame(bench)?),
        ("cost", pictures::cost(bench)?),
        ("culling", pictures::culling(bench)?),
        ("iteration", pictures::iteration(bench)?),
        ("effects", effects::effects(bench)?),
        ("kernels", kernels::kernels(bench)?),
        ("sweep", sweep.table()),
    ];
    let readme = vec![("exactness", sweep.lines(origin))];
    let plots = vec![
        ("exactness.svg", sweep.plot(&["gradients", "overlap", "solver", "culling"], 2)),
        ("sweep.svg", sweep.plot(&["epsilon", "stop", "storage"], 3)),
        ("frame.svg", pictures::frame_plot(bench)),
        ("cost.svg", pictures::cost_plot(bench)?),
        ("iteration.svg", pictures::iteration_plot(bench)?),
    ];
    Ok([page, readme, plots])
}
