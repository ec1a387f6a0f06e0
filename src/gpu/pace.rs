//! Short submissions for slow devices: recordings are cut where their kernels would take longer together.
//!
//! Some systems reset a driver whose device is at one submission for too long: Windows after 2 s.

use super::info::DeviceKind;
use super::lock::lock;
use rustc_hash::FxHashMap;
use std::sync::Mutex;
use std::time::Duration;

/// Decay of a kernel's longest time after each shorter dispatch.
const MEMORY: f64 = 0.9;

/// The longest time of a submission, and what is known of kernels.
pub(super) struct Pace {
    limit: f64,
    known: Mutex<Known>,
}

/// Seconds, measured.
#[derive(Default)]
struct Known {
    /// By kernel: expected seconds of its next dispatch, and seconds of its longest one.
    kernels: FxHashMap<&'static str, (f64, f64)>,
    longest_submission: f64,
}

/// The limit where none is given: half of what Windows allows, for GPUs that share the host's memory there.
pub(super) fn usual(kind: DeviceKind) -> Option<Duration> {
    (cfg!(windows) && kind == DeviceKind::Integrated).then_some(Duration::from_secs(1))
}

impl Pace {
    /// A pace that no submission should exceed.
    pub fn new(limit: Duration) -> Self {
        Self { limit: limit.as_secs_f64(), known: Mutex::default() }
    }

    /// True if a kernel that follows `under_way` seconds of work of the same submission belongs into the next one;
    /// then its own expected time, and else both together.
    pub fn cuts(&self, under_way: f64, kernel: &'static str) -> (bool, f64) {
        // A kernel that never ran gets a submission of its own.
        let expected = lock(&self.known).kernels.get(kernel).map_or(self.limit, |(expected, _)| *expected);
        let cut = under_way > 0.0 && under_way + expected > self.limit;
        (cut, if cut { expected } else { under_way + expected })
    }

    /// Learns from the dispatches of a submission: kernels and their seconds.
    pub fn learn(&self, dispatches: impl Iterator<Item = (&'static str, f64)>) {
        let mut known = lock(&self.known);
        let mut total = 0.0;
        for (kernel, seconds) in dispatches {
            let (expected, longest) = known.kernels.entry(kernel).or_default();
            if seconds > self.limit && *longest <= self.limit {
                tracing::warn!(
                    "the kernel {kernel} alone took {:.0} ms, longer than --max-submission: a dispatch cannot be divided",
                    seconds * 1e3
                );
            }
            *expected = seconds.max(MEMORY * *expected);
            *longest = seconds.max(*longest);
            total += seconds;
        }
        known.longest_submission = total.max(known.longest_submission);
    }
}

impl Drop for Pace {
    fn drop(&mut self) {
        let known = lock(&self.known);
        let mut kernels: Vec<_> = known.kernels.iter().map(|(kernel, (_, longest))| (longest * 1e3, *kernel)).collect();
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
    fn kernels_share_a_submission_while_they_fit() {
        let pace = Pace::new(Duration::from_millis(100));
        assert_eq!(pace.cuts(0.0, "new"), (false, 0.1), "nothing to cut before the first");
        assert_eq!(pace.cuts(0.01, "new"), (true, 0.1), "unknown ones run alone");
        pace.learn([("new", 0.04)].into_iter());
        assert_eq!(pace.cuts(0.04, "new"), (false, 0.08));
        assert_eq!(pace.cuts(0.08, "new"), (true, 0.04));
        pace.learn([("new", 0.0)].into_iter());
        assert_eq!(pace.cuts(0.0, "new"), (false, 0.9 * 0.04), "a short one is believed slowly");
        pace.learn([("new", 0.3)].into_iter());
        assert_eq!(pace.cuts(1e-6, "new"), (true, 0.3), "a long one at once");
    }
}
