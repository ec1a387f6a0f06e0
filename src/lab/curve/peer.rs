//! Files of splat-transform, for comparison: the same model decimated by it and written in its formats.

use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, RenderMode};
use crate::job::{Error, Session, Stage};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Kept shares of the Gaussians, in per cent.
const SHARES: [u32; 6] = [100, 50, 28, 15, 10, 5];
const FORMATS: [&str; 2] = ["sog", "spz"];

/// The command of splat-transform, and a folder for its files.
pub struct Peer {
    command: Vec<String>,
    version: String,
    folder: PathBuf,
}

/// A file that it wrote.
pub struct PeerFile {
    /// Extension of its format.
    pub format: &'static str,
    /// Bytes.
    pub bytes: u64,
    /// Its Gaussians.
    pub model: Gaussians,
}

impl Peer {
    /// The tool that `command` starts, with its options, or none if it cannot be started. Its files are written to `folder` and
    /// removed.
    pub fn find(command: &str, folder: &Path) -> Option<Self> {
        let command: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        let (program, options) = command.split_first()?;
        let said = Command::new(program).args(options).arg("--version").output().ok()?;
        // It says its version where others say their errors.
        let said = [said.stdout, said.stderr].concat();
        let version = String::from_utf8_lossy(&said).split_whitespace().find_map(version)?;
        Some(Self { command, version, folder: folder.to_owned() })
    }

    /// Its name and version.
    pub fn name(&self) -> String {
        format!("splat-transform {}", self.version)
    }

    /// Its files of a model, from all Gaussians to few; failures are noted and left out.
    pub fn files(&self, session: &Session<'_>, model: &Gaussians, mode: RenderMode) -> Result<Vec<PeerFile>, Error> {
        let unwritten = |source| Error::Write { path: self.folder.clone(), source };
        let scratch = tempfile::tempdir_in(&self.folder).map_err(unwritten)?;
        let whole = scratch.path().join("whole.ply");
        formats::write(&whole, model, mode).map_err(Error::writing)?;
        let mut files = Vec::new();
        for (done, share) in SHARES.into_iter().enumerate() {
            session.watcher.step(Stage::Files, done, SHARES.len())?;
            let failed = |what: &str, words: &str| {
                session.watcher.note(&format!("{}, {share} %, {what}: {words}", self.name()));
            };
            let decimated = match self.decimated(&whole, share) {
                Ok(path) => path,
                Err(words) => {
                    failed("decimated", &words);
                    continue;
                }
            };
            for format in FORMATS {
                match self.file(&decimated, format) {
                    Ok(file) => files.push(file),
                    Err(words) => failed(format, &words),
                }
            }
        }
        session.watcher.progress(Stage::Files, 1, 1);
        Ok(files)
    }

    /// A model with a share of the Gaussians, beside the whole one, or the reason of a failure.
    fn decimated(&self, whole: &Path, share: u32) -> Result<PathBuf, String> {
        if share == 100 {
            return Ok(whole.to_owned());
        }
        let (out, share) = (whole.with_file_name("decimated.ply"), format!("{share}%"));
        self.start(&[whole.as_os_str(), OsStr::new("-d"), OsStr::new(&share), out.as_os_str()])?;
        Ok(out)
    }

    /// One file of these Gaussians, beside them, or the reason of a failure.
    fn file(&self, decimated: &Path, format: &'static str) -> Result<PeerFile, String> {
        let path = decimated.with_file_name(format!("packed.{format}"));
        self.start(&[decimated.as_os_str(), path.as_os_str()])?;
        let bytes = std::fs::metadata(&path).map_or(0, |m| m.len());
        // It keeps a PLY's axes in an SPZ, and an SPZ's in a PLY: only by itself do they come back.
        let back = if format == "spz" { path.with_file_name("back.ply") } else { path.clone() };
        if format == "spz" {
            self.start(&[path.as_os_str(), back.as_os_str()])?;
        }
        let model = formats::read(&back).map_err(|e| e.to_string())?.gaussians;
        Ok(PeerFile { format, bytes, model })
    }

    fn start(&self, arguments: &[&OsStr]) -> Result<(), String> {
        let (program, options) = self.command.split_first().expect("a command that was found");
        let mut command = Command::new(program);
        let said = command.args(options).args(["-q", "-w"]).args(arguments).output().map_err(|e| e.to_string())?;
        if said.status.success() {
            return Ok(());
        }
        let words = String::from_utf8_lossy(&said.stderr);
        Err(words.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it failed and said nothing").to_owned())
    }
}

/// The number in `v3.7.0`.
fn version(word: &str) -> Option<String> {
    let number = word.strip_prefix('v').unwrap_or(word);
    (number.contains('.') && number.starts_with(|c: char| c.is_ascii_digit())).then(|| number.to_owned())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_tool_is_found_wherever_it_says_its_version() {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("tool");
        let command = format!("sh {} -g cpu", script.display());
        for end in ["", " >&2"] {
            std::fs::write(&script, format!("echo 'splat-transform v3.7.0 (0f60b17)'{end}\n")).unwrap();
            let found = Peer::find(&command, folder.path()).map(|peer| peer.name());
            assert_eq!(found.as_deref(), Some("splat-transform 3.7.0"), "{end}");
        }
        std::fs::write(&script, "exit 0\n").unwrap();
        assert!(Peer::find(&command, folder.path()).is_none());
    }
}
