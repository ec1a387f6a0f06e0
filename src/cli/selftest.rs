//! `qirf-vk selftest`.

use super::Global;
use super::console::Console;
use crate::gpu::{Device, DeviceKind};
use crate::job::Error;
use crate::selftest::{self, Case, Check, News, ROUNDING, Verdict};
use serde_json::json;
use std::io::{self, IsTerminal};
use std::thread;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk selftest
  qirf-vk selftest --device 1 --json > selftest.json

Every kernel runs on embedded hard cases, and its results are compared with known ones or with the host's, which are exact or in \
float64. An error slightly above its bound, as rounding on this device can cause, is a warning. The exit code is 4 if \
any result is wrong.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Run only a few small cases of each kind
    #[arg(long)]
    quick: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let device = global.open()?;
        let info = device.info();
        let begun = Instant::now();
        if !self.json {
            console.print(format_args!("{} ({})", info.name, info.driver))?;
            console.print(format_args!("{:<13} {:<44} {:>9} {:>9}", "room", "check", "seen", "allowed"))?;
        }
        let mut handles = vec![device.clone()];
        if info.kind == DeviceKind::Cpu && thread::available_parallelism().is_ok_and(|n| n.get() > 1) {
            handles.push(global.open_again(&device)?);
        }
        let checks = self.checks(console, &handles)?;
        let verdict = verdict(&checks, &info.name, &info.driver);
        let seconds = begun.elapsed().as_secs_f64();
        let [passed, rounding, wrong] = counts(&checks);
        if self.json {
            console.json(&json!({
                "device": info, "passed": verdict.is_ok(), "seconds": seconds, "checks": checks,
                "counts": { "pass": passed, "rounding": rounding, "wrong": wrong },
            }))?;
        }
        verdict?;
        if rounding > 0 {
            let exceed = if rounding == 1 { "exceeds its bound" } else { "exceed their bounds" };
            console.warn(format_args!(
                "{rounding} of {} checks {exceed}, by less than {ROUNDING} times: this device rounds differently, \
                 but computes the right numbers",
                checks.len()
            ));
        }
        console.note(format_args!("{passed} of {} checks passed, none is wrong ({seconds:.1} s)", checks.len()));
        Ok(())
    }

    /// Runs the cases: the progress line names those in progress, and results are printed in order.
    fn checks(&self, console: &Console, handles: &[Device]) -> Result<Vec<Check>, Error> {
        let bar = console.bar(selftest::cases(self.quick).count() as u64, "checking");
        let checks = selftest::run(handles, self.quick, |news| {
            match news {
                News::UnderWay(cases) => bar.set_message(under_way(cases)),
                News::Done(checks) => {
                    bar.inc(1);
                    if !self.json {
                        // Hides the bar while lines are printed.
                        bar.suspend(|| checks.iter().try_for_each(|c| console.print(row(console, c))))?;
                    }
                }
            }
            Ok::<(), Error>(())
        });
        bar.finish_and_clear();
        checks
    }
}

/// The cases in progress, by room and name.
fn under_way(cases: &[&Case]) -> String {
    let names: Vec<String> = cases.iter().map(|case| format!("{}: {}", case.room(), case.name())).collect();
    format!("checking {}", names.join("; "))
}

/// Numbers of checks that passed, that exceed their bounds by rounding, and that failed.
fn counts(checks: &[Check]) -> [usize; 3] {
    [Verdict::Pass, Verdict::Rounding, Verdict::Wrong].map(|v| checks.iter().filter(|c| c.verdict == v).count())
}

/// One wrong result is enough: everything that uses this part of the engine may be wrong.
fn verdict(checks: &[Check], device: &str, driver: &str) -> Result<(), Error> {
    let failed: Vec<&Check> = checks.iter().filter(|c| c.verdict == Verdict::Wrong).collect();
    if failed.is_empty() {
        return Ok(());
    }
    let mut rooms: Vec<&str> = failed.iter().map(|c| c.room).collect();
    rooms.dedup();
    Err(Error::SelfTest {
        failed: failed.len(),
        checks: checks.len(),
        rooms: rooms.join(", "),
        device: device.to_owned(),
        driver: driver.to_owned(),
    })
}

fn row(console: &Console, check: &Check) -> String {
    let number = |v: f64| if v == 0.0 { "0".to_owned() } else { format!("{v:.1e}") };
    let seen = check.seen.map_or_else(|| "-".to_owned(), number);
    let (code, word) = match check.verdict {
        Verdict::Pass => ("32", "pass"),
        Verdict::Rounding => ("33", "rounding"),
        Verdict::Wrong => ("1;31", "WRONG"),
    };
    let verdict = console.paint(code, word, io::stdout().is_terminal());
    let problem = check.problem.as_ref().map(|p| format!("  {p}")).unwrap_or_default();
    format!("{:<13} {:<44} {seen:>9} {:>9}  {verdict}{problem}", check.room, check.name, number(check.allowed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::remedy::remedy;
    use crate::job::Exit;

    #[test]
    fn one_wrong_check_is_exit_code_4_and_names_its_room() {
        let check = |room, seen: Option<f64>| {
            let verdict = match seen {
                Some(v) if v <= 1e-3 => Verdict::Pass,
                Some(v) if v <= 2e-3 => Verdict::Rounding,
                _ => Verdict::Wrong,
            };
            Check { room, name: "sums".into(), seen, allowed: 1e-3, verdict, problem: None }
        };
        let verdict = |checks: &[Check]| verdict(checks, "Some GPU", "driver 1");
        assert!(verdict(&[check("sort", Some(0.0)), check("scan", Some(2e-3))]).is_ok(), "rounding");
        for bad in [Some(3e-3), None] {
            let checks = [check("scan", Some(0.0)), check("sort", bad), check("sort", bad), check("adam", bad)];
            let error = verdict(&checks).unwrap_err();
            assert_eq!(Exit::of(&error), Exit::Device);
            let (told, remedy) = (error.to_string(), remedy(&error).unwrap());
            for part in ["3 of 4", "Some GPU", "driver 1", "sort, adam"] {
                assert!(told.contains(part), "{told}");
            }
            assert!(remedy.contains("Mesa before 25") && remedy.contains("--device"), "{remedy}");
        }
    }
}
