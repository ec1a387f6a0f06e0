//! Mutated files of every input format: none may panic, abort, hang, or take more than 2 GB; salvageable files load.
//!
//! The cases run in a child of this test program whose address space the system limits, so that an abort or a request
//! for too much memory ends the child and not the test: the parent names the case and continues after it. Case N is the
//! same everywhere; `QIRF_FAULTS=N..N+1 cargo test --test program -- --ignored faults::mutations::worker --nocapture`
//! repeats it.

use crate::support::files::corpus::{Input, damaged, inputs};
use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Address space of the child in KiB.
const MEMORY: u32 = 2 << 20;
/// Longest time that one case may take.
const PATIENCE: Duration = Duration::from_secs(20);
/// Exit code of a child whose case took longer.
const HANGS: i32 = 97;
/// Children that may die before the parent gives up.
const DEATHS: usize = 20;

#[test]
fn a_few_mutations_of_every_format() {
    parent(0..600);
}

/// `make faults`. `QIRF_FAULTS_CASES` sets another number of cases.
#[test]
#[ignore = "minutes"]
fn ten_thousand_mutations() {
    let cases = std::env::var("QIRF_FAULTS_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(10_000);
    let begun = Instant::now();
    parent(0..cases);
    println!("{cases} cases in {:.1} s", begun.elapsed().as_secs_f64());
}

/// Runs the cases in children, and fails with a list of all faults.
fn parent(cases: Range<u64>) {
    let folder = tempfile::tempdir().unwrap();
    let note = folder.path().join("note");
    let mut wrong = Vec::new();
    let mut from = cases.start;
    while from < cases.end && wrong.len() < DEATHS {
        let output = Command::new("sh")
            .args(["-c", &format!("ulimit -v {MEMORY} && exec \"$0\" \"$@\"")])
            .arg(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "program::faults::mutations::worker", "--nocapture"])
            .env("QIRF_FAULTS", format!("{from}..{}", cases.end))
            .env("QIRF_FAULTS_NOTE", &note)
            // A thread's stack and heap take address space whether they are used or not.
            .envs([("RAYON_NUM_THREADS", "2"), ("OPENBLAS_NUM_THREADS", "1"), ("MALLOC_ARENA_MAX", "2")])
            .output()
            .expect("a shell");
        let text = String::from_utf8_lossy(&output.stdout);
        println!("{}", text.lines().filter(|l| l.starts_with("| ")).collect::<Vec<_>>().join("\n"));
        let told: Vec<_> = text.lines().filter(|l| l.starts_with("case ")).map(str::to_owned).collect();
        if output.status.success() {
            break;
        }
        if output.status.code() == Some(101) {
            // The child ran to its end and found faults, or its own checks failed.
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            wrong.extend(if told.is_empty() { vec![said] } else { told });
            break;
        }
        wrong.extend(told);
        let Some(last) = fs::read_to_string(&note).ok().and_then(|t| t.trim().parse::<u64>().ok()) else {
            panic!("the child did not start: {}", String::from_utf8_lossy(&output.stderr));
        };
        let how = if output.status.code() == Some(HANGS) { "takes too long".into() } else { output.status.to_string() };
        let said = String::from_utf8_lossy(&output.stderr);
        wrong.push(format!("case {last} ends the program: {how}: {}", said.lines().last().unwrap_or_default()));
        from = last + 1;
    }
    assert!(wrong.is_empty(), "{} of {cases:?} go wrong:\n{}", wrong.len(), wrong.join("\n"));
}

/// Counts of one input's cases.
#[derive(Default)]
struct Tally {
    loaded: u32,
    refused: u32,
    slowest: Duration,
}

/// The child that the parent starts; run on its own it does nothing.
#[test]
#[ignore = "started by the tests above"]
fn worker() {
    let Ok(cases) = std::env::var("QIRF_FAULTS") else { return };
    let (from, to) = cases.split_once("..").expect("QIRF_FAULTS=FROM..TO");
    let (from, to): (u64, u64) = (from.parse().unwrap(), to.parse().unwrap());
    let note = std::env::var_os("QIRF_FAULTS_NOTE");
    let begun = Instant::now();
    watch(begun);
    let place = remember_panics();

    let inputs = inputs();
    let folders: Vec<_> = inputs.iter().map(|_| tempfile::tempdir().unwrap()).collect();
    let mut tallies: BTreeMap<&str, Tally> = BTreeMap::new();
    for (input, folder) in inputs.iter().zip(&folders) {
        input.prepare(folder.path());
        assert!(input.read(&input.bytes, folder.path()), "{} is good as it is", input.name);
    }
    let mut wrong = 0;
    for case in from..to {
        let i = (case % inputs.len() as u64) as usize;
        let input = &inputs[i];
        let bytes = damaged(case, input, &inputs);
        if let Some(note) = &note {
            fs::write(note, case.to_string()).unwrap();
        }
        NOW.store(begun.elapsed().as_millis() as u64 + 1, Ordering::SeqCst);
        let started = Instant::now();
        let read = catch_unwind(AssertUnwindSafe(|| input.read(&bytes, folders[i].path())));
        NOW.store(0, Ordering::SeqCst);
        let tally = tallies.entry(&input.name).or_default();
        tally.slowest = tally.slowest.max(started.elapsed());
        match read {
            Ok(true) => tally.loaded += 1,
            Ok(false) => tally.refused += 1,
            Err(_) => {
                wrong += 1;
                println!("case {case} ({}) panics: {}", input.name, place.lock().unwrap());
                keep(case, input, &bytes);
            }
        }
    }
    for (name, t) in &tallies {
        println!(
            "| {name}: {} loaded, {} refused, slowest {:.0} ms",
            t.loaded,
            t.refused,
            t.slowest.as_secs_f64() * 1e3
        );
        // A few cases may all have the same outcome.
        if t.loaded + t.refused >= 100 && name != &"checkpoint.safetensors" {
            assert!(t.loaded > 0 && t.refused > 0, "{name}: all mutations have the same outcome");
        }
    }
    assert_eq!(wrong, 0, "cases went wrong");
}

/// Writes good files for every input into its folder of seeds, `QIRF_FUZZ_CORPUS/NAME`; does nothing if that is not set.
#[test]
#[ignore = "started by make fuzz"]
fn seeds() {
    let Some(corpus) = std::env::var_os("QIRF_FUZZ_CORPUS") else { return };
    let all = inputs();
    for it in &all {
        let folder = Path::new(&corpus).join(&it.name);
        fs::create_dir_all(&folder).unwrap();
        // Every file for the same reader is a good seed.
        let kin = |i: &&Input| i.file == it.file || (i.beside.is_empty() && same_extension(&i.file, &it.file));
        for (k, input) in all.iter().filter(kin).enumerate() {
            fs::write(folder.join(format!("good-{k}")), &input.bytes).unwrap();
        }
    }
}

fn same_extension(a: &str, b: &str) -> bool {
    Path::new(a).extension() == Path::new(b).extension()
}

/// Keeps a damaged file for inspection if `QIRF_FAULTS_KEEP` names a folder.
fn keep(case: u64, input: &Input, bytes: &[u8]) {
    if let Some(folder) = std::env::var_os("QIRF_FAULTS_KEEP") {
        let name = format!("{case}-{}", input.file.replace('/', "-"));
        fs::write(Path::new(&folder).join(name), bytes).unwrap();
    }
}

/// Start of the current case in milliseconds, plus one; 0 between cases.
static NOW: AtomicU64 = AtomicU64::new(0);

/// Ends the program if a case takes too long.
fn watch(begun: Instant) {
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_millis(200));
            let since = NOW.load(Ordering::SeqCst);
            if since > 0 && begun.elapsed() > PATIENCE + Duration::from_millis(since) {
                std::process::exit(HANGS);
            }
        }
    });
}

/// Place and message of the last panic, instead of a trace for each.
fn remember_panics() -> &'static Mutex<String> {
    static PLACE: Mutex<String> = Mutex::new(String::new());
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if NOW.load(Ordering::SeqCst) == 0 {
            usual(info);
        } else if let Ok(mut place) = PLACE.lock() {
            *place = info.to_string().replace('\n', " ");
        }
    }));
    &PLACE
}
