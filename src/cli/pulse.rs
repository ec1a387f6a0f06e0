//! Progress without a terminal: a plain line every ten seconds.

use super::console::Console;
use std::io::{self, IsTerminal};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Time between two lines.
const EVERY: Duration = Duration::from_secs(10);

/// When the last line was printed, and where each stage began.
pub(super) struct Pulse(Option<Mutex<State>>);

struct State {
    last: Instant,
    /// The stage, with the time and the steps done when it was first seen.
    stage: (&'static str, Instant, u64),
}

impl Pulse {
    /// Silent on a terminal, where bars are.
    pub fn new() -> Self {
        let now = Instant::now();
        let state = || Mutex::new(State { last: now, stage: ("", now, 0) });
        Self((!io::stderr().is_terminal()).then(state))
    }

    /// Prints where a stage is, if it is time: its name, the steps done, and their number.
    pub fn beat(&self, console: &Console, (stage, done, total): (&'static str, u64, u64), message: &str) {
        let Some(Ok(mut state)) = self.0.as_ref().map(Mutex::lock) else { return };
        let now = Instant::now();
        if state.stage.0 != stage {
            state.stage = (stage, now, done);
        }
        if now - state.last >= EVERY && done < total {
            state.last = now;
            let (_, began, from) = state.stage;
            let rate = done.saturating_sub(from) as f64 / (now - began).as_secs_f64();
            console.note(line((stage, done, total), rate, message));
        }
    }
}

/// A line at `rate` steps a second.
fn line((stage, done, total): (&str, u64, u64), rate: f64, message: &str) -> String {
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

    #[test]
    fn a_line_says_where_a_stage_is() {
        let said = line(("training", 250, 1000), 12.5, "loss 0.0312  7 Gaussians");
        assert_eq!(said, "training 250/1000  loss 0.0312  7 Gaussians  12.5/s (60 s left)");
        assert_eq!(line(("photos", 0, 9), 0.0, ""), "photos 0/9");
    }
}
