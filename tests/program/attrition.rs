//! Runs that prune by attrition: an exact count, and the same bytes when stopped in its midst.

use super::ended::capture;
use super::soak::Stopper;
use crate::support::{new_device, runs};
use qirf_vk::job::config::Pruning;
use qirf_vk::job::{Error, Output, RunConfig, Session, Silent, Watcher};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::run;
use qirf_vk::qirf::select::budget::Keep;
use qirf_vk::train::checkpoint::Snapshot;
use std::sync::atomic::AtomicU32;

#[test]
fn stopped_in_the_midst_it_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let device = new_device();
    let trained = |config: &RunConfig, name: &str, watcher: &(dyn Watcher + Sync)| {
        let networks = Networks::default();
        let session = Session { host_bytes: u64::MAX, watcher, ..Session::new(&device, &networks) };
        run::run(&session, config, &Output::new(&folder.path().join(name)).unwrap(), true)
    };
    let mut pruning = Pruning::default();
    pruning.compression.keep = Keep::Count(150);
    let config = runs::config(&capture(folder.path(), 400), 160).pruned(pruning);
    // Training is watched where it pauses. This checkpoint is such a pause, in the mean of the last iterates.
    let late = 156;
    let config = RunConfig { checkpoint_every: late, ..config };

    let whole = trained(&config, "whole", &Silent).unwrap();
    let [pruned] = &whole.prunes[..] else { panic!("{} prunes", whole.prunes.len()) };
    let attrition = pruned.attrition.expect("attrition");
    assert_eq!((whole.gaussians.last, pruned.after, attrition.from), (150, 150, 80));
    assert_eq!(whole.gaussians.dense, Some(attrition.before));
    assert!(attrition.before > pruned.before && (81..=120).contains(&pruned.iteration), "{pruned:?}");

    // Before it, in its midst, soon after the cut, and among the last iterates.
    for after in [79, 95, pruned.iteration + 3, late] {
        let stopped = trained(&config, "parts", &Stopper(AtomicU32::new(after), AtomicU32::new(0)));
        assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
    }
    let checkpoint = Snapshot::read(&folder.path().join("parts/checkpoint.safetensors")).unwrap();
    assert!(checkpoint.iteration == late && checkpoint.mean.is_some());
    let resumed = trained(&config, "parts", &Silent).unwrap();
    let model = |name: &str| std::fs::read(folder.path().join(name).join("model.ply")).unwrap();
    assert!(model("whole") == model("parts"));
    assert!(resumed.prunes[0].attrition == Some(attrition) && resumed.prunes[0].iteration == pruned.iteration);
}
