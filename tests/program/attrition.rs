//! Runs that prune by attrition: an exact count, and the same bytes when stopped in its midst.

use crate::support::{new_device, runs};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::Error;
use qirf_vk::pipeline::config::Pruning;
use qirf_vk::pipeline::{Output, RunConfig, Session, Silent, Watcher, run};
use qirf_vk::qirf::select::budget::Keep;
use qirf_vk::synth::{SynthOptions, write};
use qirf_vk::train::Progress;
use std::sync::atomic::{AtomicU32, Ordering};

/// Stops after an iteration.
struct Stops {
    after: u32,
    now: AtomicU32,
}

impl Watcher for Stops {
    fn training(&self, progress: &Progress, _: u32) {
        self.now.store(progress.iteration, Ordering::Relaxed);
    }

    fn stop(&self) -> bool {
        self.now.load(Ordering::Relaxed) >= self.after
    }
}

#[test]
fn stopped_in_the_midst_it_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 400, ..SynthOptions::default() };
    write(&scene, &options, &|_| ()).unwrap();
    let device = new_device();
    let trained = |config: &RunConfig, name: &str, watcher: &(dyn Watcher + Sync)| {
        let networks = Networks::default();
        let session = Session { host_bytes: u64::MAX, watcher, ..Session::new(&device, &networks) };
        run::run(&session, config, &Output::new(&folder.path().join(name)).unwrap(), true)
    };
    let mut pruning = Pruning::default();
    pruning.compression.keep = Keep::Count(150);
    let config = runs::config(&scene, 160).pruned(pruning);

    let whole = trained(&config, "whole", &Silent).unwrap();
    let [pruned] = &whole.prunes[..] else { panic!("{} prunes", whole.prunes.len()) };
    let attrition = pruned.attrition.expect("attrition");
    assert_eq!((whole.gaussians.last, pruned.after, attrition.from), (150, 150, 80));
    assert_eq!(whole.gaussians.dense, Some(attrition.before));
    assert!(attrition.before > pruned.before && (81..=120).contains(&pruned.iteration), "{pruned:?}");

    // Before it, in its midst, and soon after the cut.
    for after in [79, 95, pruned.iteration + 3] {
        let stopped = trained(&config, "parts", &Stops { after, now: AtomicU32::new(0) });
        assert!(matches!(stopped, Err(Error::Interrupted)), "{stopped:?}");
    }
    let resumed = trained(&config, "parts", &Silent).unwrap();
    let model = |name: &str| std::fs::read(folder.path().join(name).join("model.ply")).unwrap();
    assert!(model("whole") == model("parts"));
    assert!(resumed.prunes[0].attrition == Some(attrition) && resumed.prunes[0].iteration == pruned.iteration);
}
