//! `log.jsonl`: the progress of a run, as lines of JSON (docs/metrics.md).

use super::error::Error;
use crate::gaussians::formats;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Lines of a run beside those with a PSNR.
const LINES: u32 = 200;

/// One line: the state after an iteration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogLine {
    /// Iterations done.
    pub iteration: u32,
    /// Iterations of the whole run.
    pub iterations: u32,
    /// Training and pruning until then, in seconds, as in the record's curve.
    pub seconds: f64,
    /// Loss of the iteration, over one photo; null where it is not a number.
    pub loss: Option<f32>,
    /// Gaussians.
    pub gaussians: usize,
    /// Mean PSNR of the held-out views in dB; absent where it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psnr: Option<f64>,
    /// Learning rate of each attribute, in units of the stored parameters.
    pub rates: LoggedRates,
    /// Bytes in the device's buffers.
    pub device_bytes: u64,
}

/// Learning rates by attribute.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedRates {
    /// Learning rate of centres.
    pub means: f32,
    /// Learning rate of logarithms of scales.
    pub log_scales: f32,
    /// Learning rate of quaternions.
    pub rotations: f32,
    /// Learning rate of opacities' logits.
    pub opacity_logits: f32,
    /// Learning rate of constant colours.
    pub sh0: f32,
    /// Learning rate of all other bands.
    pub sh_rest: f32,
}

/// The open file.
pub struct RunLog {
    path: PathBuf,
    file: File,
}

impl RunLog {
    /// Opens the log of a run that continues after `iteration`: earlier lines stay, others go.
    pub fn open(path: &Path, iteration: u32) -> Result<Self, Error> {
        let before = if iteration == 0 { Vec::new() } else { std::fs::read(path).unwrap_or_default() };
        let stays =
            |line: &&[u8]| serde_json::from_slice::<LogLine>(line).is_ok_and(|line| line.iteration <= iteration);
        formats::write_atomically(path, |out| {
            before.split(|b| *b == b'\n').filter(stays).try_for_each(|line| out.write_all(&[line, b"\n"].concat()))
        })
        .map_err(Error::writing)?;
        let opened = File::options().append(true).open(path);
        let file = opened.map_err(|source| Error::Write { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), file })
    }

    /// Returns true if a line is due after iteration `now`, the first one after `before`.
    pub fn due(before: u32, now: u32, iterations: u32) -> bool {
        let every = iterations.div_ceil(LINES).max(1);
        now / every > before / every || now == iterations
    }

    /// Adds a line; readers see it at once.
    pub fn add(&mut self, line: &LogLine) -> Result<(), Error> {
        let text = serde_json::to_string(line).map_err(|e| Error::encoding("log.jsonl", e))?;
        let path = || self.path.clone();
        self.file.write_all(format!("{text}\n").as_bytes()).map_err(|source| Error::Write { path: path(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(iteration: u32) -> LogLine {
        let rates = LoggedRates {
            means: 1e-4,
            log_scales: 5e-3,
            rotations: 1e-3,
            opacity_logits: 0.05,
            sh0: 0.01,
            sh_rest: 0.0,
        };
        LogLine {
            iteration,
            iterations: 30,
            seconds: 0.5,
            loss: None,
            gaussians: 7,
            psnr: None,
            rates,
            device_bytes: 9,
        }
    }

    #[test]
    fn a_resumed_run_goes_on_where_its_checkpoint_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let mut log = RunLog::open(&path, 0).unwrap();
        for iteration in [10, 20, 30] {
            log.add(&line(iteration)).unwrap();
        }
        // A killed program may leave half a line.
        std::fs::write(&path, [&std::fs::read(&path).unwrap()[..], b"\xff\n{\"iteration\": 1"].concat()).unwrap();
        RunLog::open(&path, 20).unwrap().add(&line(25)).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let read = |line: &str| serde_json::from_str::<LogLine>(line).unwrap();
        assert_eq!(text.lines().map(read).collect::<Vec<_>>(), [line(10), line(20), line(25)]);
        RunLog::open(&path, 0).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "");
    }

    #[test]
    fn lines_are_due_by_iterations() {
        let due =
            |from: u32, iterations| (from + 1..=iterations).filter(|i| RunLog::due(i - 1, *i, iterations)).count();
        assert_eq!(due(0, 30_000), 200);
        assert_eq!(due(0, 50), 50);
        assert!(RunLog::due(150, 301, 30_000) && !RunLog::due(150, 299, 30_000));
    }
}
