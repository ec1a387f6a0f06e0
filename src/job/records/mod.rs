//! Records of jobs, as written to their JSON files (docs/metrics.md): figures only, no work.

mod aim;
mod cameras;
mod compress;
mod curve;
mod floaters;
mod prune;
mod run;
mod trial;

pub use aim::{Aim, Point};
pub use cameras::CameraErrors;
pub use compress::{
    AimRecord, CompressProtocol, CompressRecord, CompressTimes, FineTuning, ModelFile, StageScores, Truth, ViewStages,
};
pub use curve::{AttributeLoss, CurveRecord, FileRecord};
pub use floaters::FloaterCounts;
pub use prune::{AttritionRecord, PruneGuards, PruneRecord, PruneSeconds, RankRecord};
pub use run::{
    Counts, CurvePoint, Guards, Memory, Protocol, RunRecord, Times, TrainScores, ViewScores, infinite_for_nulls,
};
pub use trial::Trial;
