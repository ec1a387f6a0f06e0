//! The generated figures of `docs/performance.md`, `docs/sweep.md` and README.md: tables and plots from the output of the
//! benchmarks and a sweep, and renders from a comparison: the work of `make figures`. The tables of `docs/results.md`: that of `make results`.

mod bound;
mod bytes;
mod effects;
mod fit;
mod kernels;
mod markers;
mod measured;
mod pictures;
mod renders;
mod results;
mod sweep;
mod tables;

pub use bytes::{FILE as BYTES, bytes};
pub use markers::fill;
pub use measured::Bench;
pub use renders::{FILE as RENDERS, renders};
pub use results::results;
pub use sweep::Sweep;

/// Origin of the figures, as the page states it.
pub struct Origin {
    /// Commit of the working tree.
    pub commit: String,
    /// Command that measures them again.
    pub command: String,
}

/// Generated parts of a page, by the names of their markers.
pub type Parts = Vec<(&'static str, String)>;

/// Tables and plots: parts of `docs/performance.md`, parts of `docs/sweep.md`, and files of plots by name.
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
    let exactness = vec![("exactness", sweep.exactness(origin))];
    let plots = vec![
        ("exactness.svg", sweep.plot(&["gradients", "overlap", "solver", "culling"], 2)),
        ("sweep.svg", sweep.plot(&["epsilon", "stop"], 2)),
        ("frame.svg", pictures::frame_plot(bench)),
        ("cost.svg", pictures::cost_plot(bench)?),
        ("iteration.svg", pictures::iteration_plot(bench)?),
    ];
    Ok([page, exactness, plots])
}
