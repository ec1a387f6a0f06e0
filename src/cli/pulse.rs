//! Progress without a terminal: a plain line every ten seconds, also while a job reports no step.

use super::console::Console;
use crate::lock::lock;
use std::io::{self, IsTerminal};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Time between two lines.
const EVERY: Duration = Duration::from_secs(10);

/// Steps of a stage: its name, those done, and their number.
pub(super) type Steps = (&'static str, u64, u64);

/// A thread that says at even intervals how far a job is; none where nobody would read that.
pub(super) struct Pulse(Option<Teller>);

struct Teller {
    job: Arc<Job>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

/// A job as its thread knows it.
struct Job {
    state: Mutex<State>,
    /// Notified at the end.
    end: Condvar,
}

/// The last report of a job.
struct State {
    begun: Instant,
    steps: Steps,
    message: String,
    /// When the stage was first seen, and the steps done then.
    first: (Instant, u64),
    ended: bool,
}

impl Pulse {
    /// Starts the thread. None runs on a terminal, where bars are, or with `--quiet`.
    pub fn new(console: &Console) -> Self {
        if console.quiet || io::stderr().is_terminal() {
            return Self(None);
        }
        let console = console.clone();
        Self::every(EVERY, move |line| console.note(line))
    }

    /// Says a line after each `period`. Where the system has no room for a thread, the job runs without these lines.
    fn every(period: Duration, say: impl Fn(String) + Send + 'static) -> Self {
        let now = Instant::now();
        let state = State { begun: now, steps: ("", 0, 0), message: String::new(), first: (now, 0), ended: false };
        let job = Arc::new(Job { state: Mutex::new(state), end: Condvar::new() });
        let told = Arc::clone(&job);
        let thread = thread::Builder::new().name("pulse".to_owned()).spawn(move || told.tell(period, &say));
        Self(thread.ok().map(|thread| Teller { job, thread: Mutex::new(Some(thread)) }))
    }

    /// Records the steps of a stage, and a message.
    pub fn beat(&self, steps: Steps, message: &str) {
        let Some(teller) = &self.0 else { return };
        let mut state = lock(&teller.job.state);
        if state.steps.0 != steps.0 {
            state.first = (Instant::now(), steps.1);
        }
        state.steps = steps;
        message.clone_into(&mut state.message);
    }

    /// Ends: no line comes after this.
    pub fn end(&self) {
        let Some(Teller { job, thread }) = &self.0 else { return };
        lock(&job.state).ended = true;
        job.end.notify_all();
        let thread = lock(thread).take();
        // It may be in the middle of a line.
        let _ = thread.map(JoinHandle::join);
    }
}

impl Drop for Pulse {
    fn drop(&mut self) {
        self.end();
    }
}

impl Job {
    /// Says a line after each `period`, until the end.
    fn tell(&self, period: Duration, say: &impl Fn(String)) {
        loop {
            let waiting = self.end.wait_timeout_while(lock(&self.state), period, |state| !state.ended);
            let (state, waited) = waiting.unwrap_or_else(PoisonError::into_inner);
            if !waited.timed_out() {
                return;
            }
            let line = state.line(Instant::now());
            // A reader that is slow to take the line does not hold up the job.
            drop(state);
            say(line);
        }
    }
}

impl State {
    /// Where a stage is; between two stages, which one was the last, and the time since the start.
    fn line(&self, now: Instant) -> String {
        let seconds = |since: Instant| now.saturating_duration_since(since).as_secs_f64();
        let (stage, done, total) = self.steps;
        if done < total {
            let (first, from) = self.first;
            return line(self.steps, done.saturating_sub(from) as f64 / seconds(first), &self.message);
        }
        let last = if stage.is_empty() { "working".to_owned() } else { format!("{stage} done, working") };
        format!("{last}  {:.0} s so far", seconds(self.begun))
    }
}

/// A line at `rate` steps a second.
fn line((stage, done, total): Steps, rate: f64, message: &str) -> String {
    let mut line = format!("{stage} {done}/{total}");
    if !message.is_empty() {
        line += &format!("  {message}");
    }
    if rate > 0.0 {
        line += &format!("  {rate:.1}/s ({:.0} s left)", (total - done) as f64 / rate);
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn a_line_says_where_a_stage_is() {
        let said = line(("training", 250, 1000), 12.5, "loss 0.0312  7 Gaussians");
        assert_eq!(said, "training 250/1000  loss 0.0312  7 Gaussians  12.5/s (60 s left)");
        assert_eq!(line(("photos", 0, 9), 0.0, ""), "photos 0/9");
    }

    #[test]
    fn lines_come_without_reports_and_none_after_the_end() {
        let (sender, said) = mpsc::channel();
        let pulse = Pulse::every(Duration::from_millis(5), move |line| drop(sender.send(line)));
        let next = |wanted: &str| {
            let mut line = String::new();
            while !line.starts_with(wanted) {
                line = said.recv_timeout(Duration::from_secs(60)).expect("a line within a minute");
            }
            line
        };
        assert!(next("working").ends_with(" s so far"));
        // Once reported, the stage is told again and again; and, once it is done, that.
        pulse.beat(("photos", 3, 9), "half");
        assert_eq!([next("photos"), next("photos")], ["photos 3/9  half"; 2]);
        pulse.beat(("photos", 9, 9), "");
        assert!(next("photos done, working").ends_with(" s so far"));
        pulse.end();
        while said.try_recv().is_ok() {}
        assert!(matches!(said.recv_timeout(Duration::from_millis(20)), Err(mpsc::RecvTimeoutError::Disconnected)));
    }
}
