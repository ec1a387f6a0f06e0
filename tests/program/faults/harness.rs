//! The real program on a small scene, and ways to disturb it.

pub use crate::program::ended::{Ended, content, end, works};
use crate::program::ended::{capture, qirf};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Options of every run here: four prunes with fine-tuning in between, all in a second or two.
const RUN: [&str; 6] = ["--iterations", "120", "--schedule", "gradual", "--grow-to", "300"];

/// Iterations of such a run.
pub const ITERATIONS: u32 = 120;

/// The iteration of its first prune.
pub const FIRST_PRUNE: u32 = 52;

/// Nine photos of 48 x 36, made once.
pub fn scene() -> &'static Path {
    static MADE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let scene = capture(folder.path(), 300);
        (folder, scene)
    });
    &made.1
}

/// The program.
pub fn program() -> Command {
    qirf([""; 0])
}

/// The same command under the validation layers, which make a run half as long again: for the paths that no other test
/// validates.
pub fn validated(command: &mut Command) -> &mut Command {
    command.env("QIRF_VALIDATION", "1")
}

/// The program behind a line of shell, as `"$@"`.
pub fn behind(shell: &str, command: &Command) -> Command {
    let mut wrapped = Command::new("sh");
    wrapped.args(["-c", shell, "sh"]).arg(command.get_program()).args(command.get_args());
    wrapped
}

/// A run of the scene into `out`.
pub fn run(out: &Path, more: &[&str]) -> Command {
    let mut command = program();
    command.arg("run").arg(scene()).arg("-o").arg(out).args(RUN).args(more);
    if !more.contains(&"--checkpoint-every") {
        command.args(["--checkpoint-every", "7"]);
    }
    command
}

/// Begins a run into `out`, and kills it once a condition holds.
pub fn killed(out: &Path, once: impl Fn() -> bool) {
    let mut child = start(&mut run(out, &[]));
    child.until(once);
    child.signal("KILL");
}

/// The model that an undisturbed run ends with, made once.
pub fn undisturbed() -> &'static [u8] {
    static MADE: OnceLock<Vec<u8>> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        works(validated(&mut run(folder.path(), &[])));
        fs::read(folder.path().join("model.ply")).unwrap()
    })
}

/// The running program.
pub struct UnderWay(Child);

pub fn start(command: &mut Command) -> UnderWay {
    UnderWay(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts"))
}

/// The same; its output goes to a file.
pub fn start_telling(command: &mut Command, file: &Path) -> UnderWay {
    let file = fs::File::create(file).unwrap();
    UnderWay(command.stdout(Stdio::null()).stderr(file).spawn().expect("the program starts"))
}

impl UnderWay {
    /// Waits until a condition holds; returns false if the program ends first.
    pub fn until(&mut self, so: impl Fn() -> bool) -> bool {
        let begun = Instant::now();
        while !so() {
            assert!(begun.elapsed() < Duration::from_secs(120), "nothing happens");
            if self.0.try_wait().unwrap().is_some() {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        true
    }

    /// Sends a signal, unless it ended before.
    pub fn tell(&mut self, name: &str) {
        if self.0.try_wait().unwrap().is_none() {
            let _ = Command::new("kill").args(["-s", name, &self.0.id().to_string()]).status();
        }
    }

    /// Sends a signal, unless it ended before, and waits for the end.
    pub fn signal(mut self, name: &str) -> Ended {
        self.tell(name);
        Ended::of(&self.0.wait_with_output().unwrap())
    }
}

/// Asserts that every file is of the type that its name says, and whole.
#[track_caller]
pub fn whole(folder: &Path) {
    for (path, bytes) in content(folder) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with('.') && path.parent().is_some_and(|p| p != folder) {
            continue; // a picture that a killed writer had begun
        }
        let good = match path.extension().and_then(|e| e.to_str()) {
            Some("ply") => qirf_vk::gaussians::formats::read(&path).is_ok(),
            Some("safetensors") => qirf_vk::train::checkpoint::Snapshot::read(&path).is_ok(),
            Some("toml") => qirf_vk::job::RunConfig::read(&path).is_ok(),
            // The line that a killed writer had begun may lack its end.
            Some("jsonl") => {
                let ended = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
                let mut lines = bytes[..ended].split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
                lines.all(|line| serde_json::from_slice::<serde_json::Value>(line).is_ok())
            }
            Some("json") => serde_json::from_slice::<serde_json::Value>(&bytes).is_ok(),
            Some("png") => image::load_from_memory(&bytes).is_ok(),
            Some("html") => bytes.ends_with(b"</html>") || bytes.ends_with(b"</html>\n"),
            Some("csv") => bytes.ends_with(b"\n"),
            _ => false,
        };
        assert!(good, "{name} of {} bytes is not whole", bytes.len());
    }
}
