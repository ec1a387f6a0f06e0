//! Short submissions for slow devices: recordings are cut where their kernels would take longer together.
//!
//! Some systems reset a driver whose device is at one submission for too long: Windows after 2 s.

use super::info::DeviceKind;
use crate::lock::lock;
use rustc_hash::FxHashMap;
use std::sync::Mutex;
use std::time::Duration;

/// Decay of a kernel's longest time after each shorter dispatch.
const MEMORY: f64 = 0.9;

/// A dispatch: its kernel, and its workgroups, 0 if only the device knows them.
#[derive(Clone, Copy)]
pub(super) struct Work {
    pub kernel: &'static str,
    pub groups: u64,
}

/// The measured times of a kernel.
#[derive(Default)]
struct Measured {
    /// Seconds of its next dispatch.
    expected: f64,
    /// Seconds of its longest dispatch.
    longest: f64,
    /// Workgroups of its largest dispatch.
    groups: u64,
}

/// The longest time of a submission, and what is known of kernels.
pub(super) struct Pace {
    limit: f64,
    known: Mutex<Known>,
}

/// Seconds, measured.
#[derive(Default)]
struct Known {
    kernels: FxHashMap<&'static str, Measured>,
    longest_submission: f64,
}

/// The limit where none is given: half of what Windows allows its GPUs; it resets no driver that runs kernels on the CPU.
pub(super) fn usual(kind: DeviceKind, windows: bool) -> Option<Duration> {
    (windows && kind != DeviceKind::Cpu).then_some(Duration::from_secs(1))
}

impl Pace {
    /// A pace that no submission should exceed.
    pub fn new(limit: Duration) -> Self {
        Self { limit: limit.as_secs_f64(), known: Mutex::default() }
    }

    /// True if a kernel that follows `under_way` seconds of work of the same submission belongs into the next one;
    /// then its own expected time, and else both together.
    pub fn cuts(&self, under_way: f64, work: Work) -> (bool, f64) {
        let known = lock(&self.known);
        // A kernel that never ran, or never as large, gets a submission of its own.
        let measured = known.kernels.get(work.kernel).filter(|measured| work.groups <= measured.groups);
        let expected = measured.map_or(self.limit, |measured| measured.expected);
        let cut = under_way > 0.0 && under_way + expected > self.limit;
        (cut, if cut { expected } else { under_way + expected })
    }

    /// Learns from the dispatches of a submission and their seconds.
    pub fn learn(&self, dispatches: impl Iterator<Item = (Work, f64)>) {
        let mut known = lock(&self.known);
        let mut total = 0.0;
        for (Work { kernel, groups }, seconds) in dispatches {
            let measured = known.kernels.entry(kernel).or_default();
            if seconds > self.limit && measured.longest <= self.limit {
                tracing::warn!(
                    "the kernel {kernel} alone took {:.0} ms, longer than --max-submission: a dispatch cannot be divided",
                    seconds * 1e3
                );
            }
            // A smaller dispatch says nothing of large ones.
            let memory = if groups < measured.groups { 1.0 } else { MEMORY };
            measured.expected = seconds.max(memory * measured.expected);
            measured.longest = seconds.max(measured.longest);
            measured.groups = groups.max(measured.groups);
            total += seconds;
        }
        known.longest_submission = total.max(known.longest_submission);
    }
}

impl Drop for Pace {
    fn drop(&mut self) {
        let known = lock(&self.known);
        let mut kernels: Vec<_> = known.kernels.iter().map(|(kernel, m)| (m.longest * 1e3, *kernel)).collect();
        kernels.sort_by(|a, b| b.0.total_cmp(&a.0));
        let kernels: Vec<String> = kernels.iter().take(8).map(|(ms, kernel)| format!("{kernel} {ms:.1} ms")).collect();
        let submission = known.longest_submission * 1e3;
        tracing::debug!(
            "the longest submission took {submission:.1} ms, the longest dispatches: {}",
            kernels.join(", ")
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_limits_every_gpu() {
        let second = Some(Duration::from_secs(1));
        let kinds = [DeviceKind::Discrete, DeviceKind::Integrated, DeviceKind::Virtual, DeviceKind::Cpu];
        assert_eq!(kinds.map(|kind| usual(kind, true)), [second, second, second, None]);
        assert_eq!(kinds.map(|kind| usual(kind, false)), [None; 4]);
    }

    #[test]
    fn kernels_share_a_submission_while_they_fit() {
        let pace = Pace::new(Duration::from_millis(100));
        let work = |groups| Work { kernel: "new", groups };
        let learn = |groups, seconds| pace.learn([(work(groups), seconds)].into_iter());
        assert_eq!(pace.cuts(0.0, work(8)), (false, 0.1), "nothing to cut before the first");
        assert_eq!(pace.cuts(0.01, work(8)), (true, 0.1), "unknown ones run alone");
        learn(8, 0.04);
        assert_eq!(pace.cuts(0.04, work(8)), (false, 0.08));
        assert_eq!(pace.cuts(0.04, work(0)), (false, 0.08), "the device knows how large it is");
        assert_eq!(pace.cuts(0.04, work(9)), (true, 0.1), "larger ones are unknown");
        assert_eq!(pace.cuts(0.08, work(8)), (true, 0.04));
        learn(4, 0.0);
        assert_eq!(pace.cuts(0.0, work(8)), (false, 0.04), "a smaller one says nothing");
        learn(8, 0.0);
        assert_eq!(pace.cuts(0.0, work(8)), (false, 0.9 * 0.04), "a short one is believed slowly");
        learn(32, 0.3);
        assert_eq!(pace.cuts(1e-6, work(32)), (true, 0.3), "a long one at once");
    }
}
