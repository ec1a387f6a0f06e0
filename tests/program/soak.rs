//! A long-lived process: runs that prune, stop, resume and compress, over and over. Memory stays flat, every round ends
//! with the same bytes, and the validation layers say nothing. `make soak`; `QIRF_SOAK_ITERATIONS` shortens it.

use crate::support::{new_device, runs};
use qirf_vk::gaussians::formats;
use qirf_vk::gpu::Device;
use qirf_vk::job::config::{PruneRule, Pruning};
use qirf_vk::job::{Error, Output, Preset, RunConfig, Session, Watcher};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::compress::fit::Target;
use qirf_vk::pipeline::compress::{CompressConfig, Input, ViewSource, compress_to};
use qirf_vk::pipeline::run;
use qirf_vk::pipeline::virtual_views::VirtualCameras;
use qirf_vk::qirf::select::budget::Keep;
use qirf_vk::random;
use qirf_vk::render::Style;
use qirf_vk::synth::{SynthOptions, write};
use qirf_vk::train::Progress;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

/// Iterations of a round.
const ROUND: u32 = 400;
/// Rounds after which memory must not grow: pools and caches have reached their sizes.
const WARM: usize = 3;

/// Number of rounds at either end whose smallest size counts: a heap varies by a MiB or two between rounds.
const BREATH: usize = 5;

/// Stops each run at a given iteration; it notes the last one.
pub struct Stopper(pub AtomicU32, pub AtomicU32);

impl Watcher for Stopper {
    fn training(&self, progress: &Progress, _: u32) {
        self.1.store(progress.iteration, Ordering::Relaxed);
    }
    fn stop(&self) -> bool {
        self.1.load(Ordering::Relaxed) >= self.0.load(Ordering::Relaxed)
    }
}

/// Bytes of this process in memory; 0 if the system does not report it.
fn resident() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    line.and_then(|l| l.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()).unwrap_or(0) << 10
}

fn config(scene: &Path) -> RunConfig {
    let mut schedule = Preset::Quick.schedule(Some(ROUND));
    schedule.densify_every = 20;
    let config = RunConfig {
        seed: 3,
        eval_every: 4,
        sh_degree: 2,
        max_gaussians: 2000,
        checkpoint_every: 90,
        schedule,
        effects: Preset::Quick.effects(),
        ..runs::config(scene, ROUND)
    };
    config.pruned(Pruning::gradual())
}

#[test]
#[ignore = "minutes: make soak"]
fn twenty_thousand_iterations_leave_memory_flat() {
    let total: u32 = std::env::var("QIRF_SOAK_ITERATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(20_000);
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    let options = SynthOptions { views: 8, width: 48, height: 36, points: 300, ..SynthOptions::default() };
    write(&scene, &options, &|_| ()).unwrap();
    let device = new_device();
    assert!(device.validates(), "the validation layers are installed (tools/setup)");
    let (config, networks) = (config(&scene), Networks::default());
    let begun = Instant::now();
    let mut first: Option<[Vec<u8>; 2]> = None;
    let mut memory: Vec<[u64; 3]> = Vec::new();
    for round in 0..total.div_ceil(ROUND).max(1) {
        let output = Output::new(&folder.path().join("out")).unwrap();
        // Two stops at iterations drawn for the round, then to the end.
        let draw = |k: u64| 1 + (random::bits(&[17, u64::from(round), k]) % u64::from(ROUND - 1)) as u32;
        let mut stops = [draw(0), draw(1), u32::MAX];
        stops.sort_unstable();
        for (k, stop) in stops.into_iter().enumerate() {
            let watcher = Stopper(AtomicU32::new(stop), AtomicU32::new(0));
            let session = Session { host_bytes: u64::MAX, watcher: &watcher, ..Session::new(&device, &networks) };
            let ended = run::run(&session, &config, &output, k > 0);
            match ended {
                Ok(results) => assert!(results.prunes.len() == 4 && output.model().exists()),
                Err(e) => assert!(matches!(e, Error::Interrupted) && output.checkpoint().exists(), "{e}"),
            }
            if output.model().exists() {
                break;
            }
        }
        let small = folder.path().join("small.ply");
        let gaussians = formats::read(&output.model()).unwrap().gaussians;
        let path = output.model();
        let input = Input { path: &path, model: gaussians, read_s: 0.0 };
        let cameras = VirtualCameras { views: 6, size: (40, 30), up: qirf_vk::scene::orbit::UP };
        let compressing = CompressConfig {
            compression: PruneRule { keep: Keep::Share(0.5), ..PruneRule::default() },
            views: ViewSource::OwnPictures { cameras, background: [0.0; 3] },
            style: Style::default(),
            exposure: false,
            fine_tune: 20,
            seed: 5,
        };
        let never = Stopper(AtomicU32::new(u32::MAX), AtomicU32::new(0));
        let session = Session { host_bytes: u64::MAX, watcher: &never, ..Session::new(&device, &networks) };
        compress_to(&session, input, &compressing, None, &Target::new(&small)).unwrap();
        let files = [&path, &small].map(|p| std::fs::read(p).unwrap());
        match &first {
            None => first = Some(files),
            Some(right) => assert!(*right == files, "round {round} ends with other bytes"),
        }
        std::fs::remove_dir_all(output.folder()).unwrap();
        let (used, peak) = device.memory_used();
        memory.push([resident(), used, peak]);
        if round % 5 == 0 {
            let seconds = begun.elapsed().as_secs_f64();
            println!("round {round}, {seconds:.0} s: RSS {} KiB, device {used} bytes, peak {peak}", resident() >> 10);
        }
        assert_eq!(Device::validation_messages(), 0, "round {round}: messages are printed above");
    }
    let [_, used, peak] = memory[memory.len() - 1];
    let warm = &memory[WARM.min(memory.len() - 1)..];
    let least = |rounds: &[[u64; 3]]| rounds.iter().map(|m| m[0]).min().unwrap_or(0);
    let early = least(&warm[..BREATH.min(warm.len())]);
    let late = least(&warm[warm.len().saturating_sub(BREATH)..]);
    let warm_peak = warm[0][2];
    println!(
        "{} rounds of {ROUND} iterations in {:.0} s: RSS {} KiB at least in the {BREATH} rounds after round {WARM}, {} KiB in \
         the last {BREATH}; device {used} bytes in use, peak {warm_peak} then, {peak} at the end",
        memory.len(),
        begun.elapsed().as_secs_f64(),
        early >> 10,
        late >> 10,
    );
    assert_eq!(used, 0, "every buffer came back");
    // Each round's stops change the peak by some KiB.
    assert!(peak <= warm_peak + warm_peak / 50, "the device's peak grew from {warm_peak} to {peak}");
    // 1.5 MiB, all of it free pieces: allocated memory stays the same to 1 KiB per round. Leaks of 100 KiB per round
    // are found.
    assert!(late <= early + (4 << 20), "{early} grew to {late}");
}
