// Mutants of the shaders: removes each barrier and each bounds check in turn, and runs the device tests of the shaders that
// this changes. A mutant that no test notices shows what the tests do not cover. `make mutants` runs it; results are in
// docs/numerics.md.
//
// Only the mutated shaders are compiled anew: the tests read them from a folder (QIRF_SHADERS).

#[path = "compile.rs"]
mod compile;

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// A room or shader, and names of the tests that show what it does; the longest match counts.
const TESTS: &[(&str, &[&str])] = &[
    ("primitives/arguments", &["primitives::a_count"]),
    ("primitives/compact", &["primitives::compact", "selftest::compact"]),
    ("primitives/gather", &["selftest::compact", "guards::a_store"]),
    ("primitives/reduce", &["primitives::reduce"]),
    ("primitives/scan", &["primitives::scan", "primitives::totals", "selftest::scan"]),
    ("primitives/sort", &["selftest::sort"]),
    ("qirf/", &["device::overlap::", "many_blocks"]),
    ("qirf/participation", &["device::participation::"]),
    ("qirf/rrdm", &["device::rrdm::", "many_blocks"]),
    ("rates/", &["device::rates::"]),
    ("render/", &["rasterise::golden_pictures", "rasterise::culling", "rasterise::the_twin", "depth_order::leaves"]),
    (
        "render/bin",
        &["rasterise::a_view_of_fewer", "rasterise::golden_pictures", "depth_order::leaves", "bin::subgroups"],
    ),
    ("render/project_backward", &["rasterise_backward::golden", "rasterise_backward::project"]),
    ("render/rasterise_backward", &["rasterise_backward::golden", "rasterise_backward::project", "order::surplus"]),
    ("render/rasterise_backward_atomic", &["rasterise_backward::golden"]), // its walk is the other's
    ("response/", &["device::respond::"]),
    ("response/score", &["device::respond::", "order::surplus"]),
    ("lab/learnt_mask", &["train::learnt_mask::"]),
    ("lab/learnt_mask_adam", &["train::learnt_mask::"]),
    ("lab/learnt_mask_gradient", &["train::learnt_mask::"]),
    ("lab/mcmc", &["train::mcmc::"]),
    ("train/", &["train::density::"]),
    ("train/adam", &["train::adam::", "order::surplus"]),
    ("train/exposure", &["exposure::the_kernel"]),
    ("train/depth_loss", &["depth_loss::"]),
    ("train/dropout", &["dropout::"]),
    ("train/poses", &["poses::the_kernel"]),
    ("train/halve", &["halve::the_device"]),
    ("train/loss", &["train::loss::the_golden", "train::loss::noise", "train::loss::smooth"]),
    ("train/loss_tiles", &["train::loss::the_golden", "train::loss::noise", "train::loss::smooth", "order::surplus"]),
    ("train/mask", &["train::mask::"]),
    ("train/smoothing", &["smoothing::scales"]),
];

/// Rooms whose shaders compute no result.
const WITHOUT: &[&str] = &["probe/"];

/// What is removed: calls as statements.
const BARRIERS: &[&str] =
    &["full_barrier();", "subgroupBarrier();", "memoryBarrierBuffer();", "memoryBarrierShared();", "barrier();"];

/// Names of indices. A comparison of one of them (`<`, `>=`, `>`) in an `if`, a conditional expression, or the definition of
/// `there` or `inside` is a bounds check.
const INDICES: &[&str] = &[
    "i",
    "j",
    "p",
    "n",
    "at",
    "row",
    "tile",
    "start",
    "along",
    "lane",
    "group",
    "centre",
    "output_at",
    "first",
    "group_index()",
    "group_index() * BLOCK",
    "run.channel",
];

const TUNINGS: [&str; 2] = ["cpu", "gpu"];
/// A mutant may take this many times as long as the tests without one, and a minute: some compile for long.
const PATIENCE: u32 = 4;

struct Mutant {
    file: PathBuf,
    line: usize,
    kind: &'static str,
    /// The part of the line that is replaced, where, and by what.
    removed: String,
    column: usize,
    by: &'static str,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("mutants: {e}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let wanted: Vec<String> = env::args().skip(1).collect();
    let root = env::current_dir()?;
    let scratch = root.join("target/mutants");
    let _ = fs::remove_dir_all(scratch.join("glsl")); // the cache of compiled kernels stays
    let sources = compile::sources(Path::new("glsl"));
    for source in &sources {
        copy(source, &scratch)?;
    }
    // A copy: cargo may build anew meanwhile.
    let program = scratch.join("device-tests");
    fs::copy(self::program()?, &program)?;
    env::set_current_dir(&scratch)?; // shaders are compiled here
    let runner = Runner { root, scratch: scratch.clone(), program, usual: BTreeMap::new() };
    let mutants: Vec<Mutant> = sources.iter().flat_map(|s| mutants(s)).collect();
    let chosen = |m: &&Mutant| {
        let place = format!("{}:{}", m.file.display(), m.line);
        wanted.is_empty() || wanted.iter().any(|w| place.contains(w.as_str()))
    };
    let mutants: Vec<&Mutant> = mutants.iter().filter(chosen).collect();
    println!("{} mutants", mutants.len());
    report(runner, &mutants, &sources)
}

/// Runs every mutant and prints what became of it, and sums by kind.
fn report(mut runner: Runner, mutants: &[&Mutant], sources: &[PathBuf]) -> Result<(), Box<dyn Error>> {
    let mut sums: BTreeMap<&str, [usize; 4]> = BTreeMap::new();
    for mutant in mutants {
        let shaders = including(&mutant.file, sources);
        let mutated = mutant.apply()?;
        let original = fs::read_to_string(&mutant.file)?;
        fs::write(&mutant.file, mutated)?;
        let modules = runner.compile(&shaders);
        fs::write(&mutant.file, original)?;
        let place = format!("{}:{}: {} `{}`", mutant.file.display(), mutant.line, mutant.kind, mutant.removed);
        if let Err(e) = modules {
            println!("{place}: does not compile: {}", e.lines().next().unwrap_or_default());
            continue;
        }
        let tests = tests_of(&shaders);
        let ends: Result<Vec<_>, _> = TUNINGS.iter().map(|tuning| runner.test(&tests, tuning, true)).collect();
        let ends = match ends {
            Ok(ends) => ends,
            Err(e) => {
                println!("{place}: not judged: {e}");
                continue;
            }
        };
        let sum = sums.entry(mutant.kind).or_default();
        sum[0] += 1;
        for (k, end) in ends.iter().enumerate() {
            sum[1 + k] += usize::from(end.is_some());
        }
        sum[3] += usize::from(ends.iter().all(Option::is_none));
        for (tuning, end) in TUNINGS.iter().zip(&ends) {
            println!(
                "{place}: {tuning}: {}",
                end.as_ref().map_or("survived".to_owned(), |by| format!("killed by {by}"))
            );
        }
    }
    println!(
        "\n| removed | mutants | killed as tuned for CPUs | as tuned for GPUs | survived both |\n|---|---:|---:|---:|---:|"
    );
    for (kind, [all, cpu, gpu, survived]) in sums {
        println!("| {kind} | {all} | {cpu} | {gpu} | {survived} |");
    }
    Ok(())
}

fn copy(source: &Path, scratch: &Path) -> Result<(), Box<dyn Error>> {
    let to = scratch.join(source);
    fs::create_dir_all(to.parent().ok_or("a source has a folder")?)?;
    fs::copy(source, to)?;
    Ok(())
}

/// Builds the device tests; gives their program.
fn program() -> Result<PathBuf, Box<dyn Error>> {
    let built = Command::new("cargo").args(["test", "--locked", "--test", "device", "--no-run"]).output()?;
    let text = String::from_utf8_lossy(&built.stderr);
    let path = text.lines().find(|l| l.contains("Executable")).and_then(|l| l.split(['(', ')']).nth(1));
    Ok(env::current_dir()?.join(path.ok_or_else(|| format!("the device tests were not built: {text}"))?))
}

/// The mutants of a file, top to bottom.
fn mutants(file: &Path) -> Vec<Mutant> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let mut found = Vec::new();
    for (number, whole) in text.lines().enumerate() {
        let line = whole.split("//").next().unwrap_or_default();
        let mutant = |kind, column: usize, length: usize, by| Mutant {
            file: file.to_owned(),
            line: number + 1,
            kind,
            removed: line[column..column + length].to_owned(),
            column,
            by,
        };
        // `void full_barrier() {` defines one, and `barrier();` ends the names of others.
        if let Some(call) = BARRIERS.iter().find(|call| line.trim() == **call) {
            let kind = call.trim_end_matches("();");
            found.push(mutant(kind, line.len() - line.trim_start().len(), call.len(), ""));
        }
        found.extend(checks(line).into_iter().map(|(column, length, by)| mutant("bounds check", column, length, by)));
    }
    found
}

/// The bounds checks of a line: column, length, and what the check becomes.
fn checks(line: &str) -> Vec<(usize, usize, &'static str)> {
    let conditional = ["if (", " ? ", "bool there =", "bool inside ="].iter().any(|c| line.contains(c));
    if !conditional {
        return Vec::new();
    }
    // What a loop counts is no check.
    let header = line.trim_start().strip_prefix("for (").map_or(0, |rest| line.len() - rest.len() + closing(rest));
    let by = if line.contains("return;") || line.contains("return 0;") { "false" } else { "true" };
    let mut found = Vec::new();
    for operator in [" < ", " >= ", " > "] {
        for (at, _) in line.match_indices(operator) {
            let opened = line[..at].rfind(['(', ',', '|', '&', '=', '?']).map_or(0, |k| k + 1);
            // `group_index()` and a factor behind it hold brackets of their own.
            let start = ["group_index() * BLOCK", "group_index()"]
                .iter()
                .find(|name| line[..at].ends_with(**name))
                .map_or(opened, |name| at - name.len());
            let left = line[start..at].trim();
            if at >= header && INDICES.contains(&left) {
                let start = at - left.len();
                let end = at + operator.len() + operand(&line[at + operator.len()..]);
                found.push((start, end - start, by));
            }
        }
    }
    let inside = "all(lessThan(at, size))";
    found.extend(line.match_indices(inside).map(|(at, _)| (at, inside.len(), "true")));
    found.sort_unstable();
    found
}

/// Where the bracket closes that was opened before a text.
fn closing(text: &str) -> usize {
    let mut depth = 1;
    let close = |(_, c): &(usize, char)| {
        depth += i32::from(*c == '(') - i32::from(*c == ')');
        depth == 0
    };
    text.char_indices().find(close).map_or(text.len(), |(at, _)| at)
}

/// Length of the operand that a text begins with.
fn operand(text: &str) -> usize {
    let mut depth = 0;
    for (at, c) in text.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' if depth > 0 => depth -= 1,
            ')' | ';' | '?' | '|' | '&' => return text[..at].trim_end().len(),
            _ => {}
        }
    }
    text.len()
}

impl Mutant {
    /// The mutated file.
    fn apply(&self) -> Result<String, Box<dyn Error>> {
        let text = fs::read_to_string(&self.file)?;
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        // Software devices wait for the whole workgroup at a subgroup's barrier, which would hide that one is missing.
        if self.kind == "barrier" {
            lines.iter_mut().filter(|l| l.trim() == "subgroupBarrier();").for_each(String::clear);
        }
        lines[self.line - 1].replace_range(self.column..self.column + self.removed.len(), self.by);
        Ok(lines.join("\n") + "\n")
    }
}

/// The shaders that a file is part of.
fn including(file: &Path, sources: &[PathBuf]) -> Vec<PathBuf> {
    let mut parts = BTreeSet::from([file.to_owned()]);
    loop {
        let before = parts.len();
        for source in sources {
            let text = fs::read_to_string(source).unwrap_or_default();
            let includes = |part: &PathBuf| {
                part.strip_prefix("glsl").is_ok_and(|p| text.contains(&format!("#include \"{}\"", p.display())))
            };
            if parts.iter().any(includes) {
                parts.insert(source.clone());
            }
        }
        if parts.len() == before {
            return parts.into_iter().filter(|p| p.extension().is_some_and(|e| e == "comp")).collect();
        }
    }
}

/// Filters of the tests that run these shaders.
fn tests_of(shaders: &[PathBuf]) -> Vec<&'static str> {
    let mut tests = BTreeSet::new();
    for shader in shaders {
        let name = shader.with_extension("").display().to_string().replacen("glsl/", "", 1);
        if WITHOUT.iter().any(|room| name.starts_with(room)) {
            continue;
        }
        let best = TESTS.iter().filter(|(part, _)| *part == name || part.ends_with('/') && name.starts_with(part));
        let best = best.max_by_key(|(part, _)| part.len());
        tests.extend(best.unwrap_or_else(|| panic!("{name}: name its tests in TESTS")).1);
    }
    tests.into_iter().collect()
}

struct Runner {
    root: PathBuf,
    scratch: PathBuf,
    program: PathBuf,
    /// How long tests take without a mutant.
    usual: BTreeMap<(Vec<&'static str>, &'static str), Duration>,
}

impl Runner {
    fn modules(&self) -> PathBuf {
        self.scratch.join("modules")
    }

    fn compile(&self, shaders: &[PathBuf]) -> Result<(), String> {
        let _ = fs::remove_dir_all(self.modules());
        fs::create_dir_all(self.modules()).map_err(|e| e.to_string())?;
        for shader in shaders {
            let bytes = compile::compile(shader)?;
            fs::write(self.modules().join(compile::file(shader)), bytes).map_err(|e| e.to_string())?;
        }
        Ok(())
    }

    /// Runs tests; gives what the first failure was, if any.
    fn test(
        &mut self,
        tests: &[&'static str],
        tuning: &'static str,
        mutated: bool,
    ) -> Result<Option<String>, Box<dyn Error>> {
        let key = (tests.to_vec(), tuning);
        let limit = if mutated {
            if !self.usual.contains_key(&key) {
                let begun = Instant::now();
                if let Some(by) = self.test(tests, tuning, false)? {
                    return Err(format!("without a mutant, {tests:?} fail as tuned for {tuning}s: {by}").into());
                }
                self.usual.insert(key.clone(), begun.elapsed());
            }
            self.usual[&key] * PATIENCE + Duration::from_secs(60)
        } else {
            Duration::from_secs(1800)
        };
        let cache = self.scratch.join("cache");
        let mut command = Command::new(&self.program);
        command.args(tests).args(["--nocapture", "--test-threads", "2"]).current_dir(&self.root);
        // Small dispatches then have surplus workgroups.
        command.env("QIRF_ORDER", "recorded");
        command.env("QIRF_TUNING", tuning).env("XDG_CACHE_HOME", &cache).env("MESA_SHADER_CACHE_DIR", &cache);
        if mutated {
            command.env("QIRF_SHADERS", self.modules());
        }
        first_failure(command, limit)
    }
}

/// Runs a test program until its first failure, its end, or the limit.
fn first_failure(mut command: Command, limit: Duration) -> Result<Option<String>, Box<dyn Error>> {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let (send, lines) = mpsc::channel();
    let readers: [Box<dyn BufRead + Send>; 2] = [
        Box::new(BufReader::new(child.stdout.take().ok_or("no output")?)),
        Box::new(BufReader::new(child.stderr.take().ok_or("no errors")?)),
    ];
    for reader in readers {
        let send = send.clone();
        thread::spawn(move || reader.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
    }
    drop(send);
    let deadline = Instant::now() + limit;
    let mut how = "";
    let found = loop {
        match lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => {
                how = match () {
                    () if line.contains("wrote behind these buffers") => " (red zones)",
                    () if line.starts_with("validation:") => " (validation)",
                    () => how,
                };
                if line.starts_with("test ") && line.contains("FAILED") || line.contains("panicked at") {
                    // Names of threads are those of tests.
                    let name = line.split('\'').nth(1).or_else(|| line.split(' ').nth(1)).unwrap_or_default();
                    let next = lines.recv_timeout(Duration::from_secs(1)).unwrap_or_default();
                    let zones = if next.contains("wrote behind") { " (red zones)" } else { how };
                    break Some(format!("{name}{zones}"));
                }
                if line.starts_with("test result: ok. 0 passed") {
                    break Some("nothing: no test has these names".into());
                }
            }
            Err(mpsc::RecvTimeoutError::Timeout) => break Some("its time limit".into()),
            Err(mpsc::RecvTimeoutError::Disconnected) => break None,
        }
    };
    if found.is_some() {
        let _ = child.kill();
    }
    let ended = child.wait()?;
    Ok(found.or_else(|| (!ended.success()).then(|| format!("its end: {ended}"))))
}
