//! `qirf-vk selftest`.

use super::Global;
use super::console::Console;
use crate::error::Error;
use crate::selftest::{self, Check};
use serde_json::json;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk selftest
  qirf-vk selftest --device 1 --json > selftest.json";

/// Check this machine's device against the host, number by number.
///
/// Every kernel computes embedded cases whose results the host computes too, exactly or in float64.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Only a few small cases of each kind
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
            console.print(format_args!("{:<11} {:<44} {:>9} {:>9}", "room", "check", "seen", "allowed"))?;
        }
        let bar = console.bar(selftest::cases(self.quick).count() as u64, "checking");
        let mut checks: Vec<Check> = Vec::new();
        for case in selftest::cases(self.quick) {
            let made = case.run(&device);
            if !self.json {
                // The bar steps aside for the lines.
                let printed = bar.suspend(|| made.iter().try_for_each(|c| console.print(row(console, c))));
                printed?;
            }
            checks.extend(made);
            bar.inc(1);
        }
        bar.finish_and_clear();
        let failed = checks.iter().filter(|c| !c.passed()).count();
        let seconds = begun.elapsed().as_secs_f64();
        if self.json {
            let passed = failed == 0;
            console.json(&json!({ "device": info, "passed": passed, "seconds": seconds, "checks": checks }))?;
        }
        if failed > 0 {
            let (device, driver) = (info.name.clone(), info.driver.clone());
            return Err(Error::SelfTest { failed, checks: checks.len(), device, driver });
        }
        console.note(format_args!("all {} checks passed ({seconds:.1} s)", checks.len()));
        Ok(())
    }
}

fn row(console: &Console, check: &Check) -> String {
    let number = |v: f64| if v == 0.0 { "0".to_owned() } else { format!("{v:.1e}") };
    let seen = check.seen.map_or_else(|| "-".to_owned(), number);
    let (code, word) = if check.passed() { ("32", "pass") } else { ("1;31", "FAIL") };
    let verdict = console.paint(code, word, Console::stdout_is_terminal());
    let problem = check.problem.as_ref().map(|p| format!("  {p}")).unwrap_or_default();
    format!("{:<11} {:<44} {seen:>9} {:>9}  {verdict}{problem}", check.room, check.name, number(check.allowed))
}
