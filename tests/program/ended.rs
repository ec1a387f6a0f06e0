//! The program as tests start it, and how it ends.

pub use crate::support::content;
use qirf_vk::synth::{SynthOptions, write};
use serde_json::Value;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The program with these arguments.
pub fn qirf(arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    command.args(arguments);
    command
}

/// Exit status and output of the program.
pub struct Ended {
    pub code: Option<i32>,
    pub out: String,
    pub said: String,
}

impl Ended {
    #[track_caller]
    pub fn of(output: &Output) -> Self {
        let [out, said] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        assert!(!said.contains("panicked") && !said.contains("validation:"), "{said}");
        assert!(!said.contains('\x1b') && !out.contains('\x1b'), "colour codes outside a terminal: {said}");
        Self { code: output.status.code(), out, said }
    }

    /// Asserts that it ended with this code and printed all of `words`.
    #[track_caller]
    pub fn with(self, code: i32, words: &[&str]) -> Self {
        assert_eq!(self.code, Some(code), "{}", self.said);
        for word in words {
            assert!(self.said.contains(word), "should say {word:?}: {}", self.said);
        }
        self
    }

    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).expect("one JSON document on standard output")
    }
}

/// Runs to the end.
#[track_caller]
pub fn end(command: &mut Command) -> Ended {
    Ended::of(&command.output().expect("the program starts"))
}

/// Runs the program, which must succeed.
#[track_caller]
pub fn works(command: &mut Command) -> Ended {
    end(command).with(0, &[])
}

/// A capture in this folder: nine photos of 48 x 36.
pub fn capture(folder: &Path, points: usize) -> PathBuf {
    let scene = folder.join("scene");
    let options = SynthOptions { views: 9, width: 48, height: 36, points, ..SynthOptions::default() };
    write(&scene, &options, &|_| ()).expect("a synthetic scene");
    scene
}

/// Copies every file below a folder into another.
pub fn copy(from: &Path, to: &Path) {
    for (path, bytes) in content(from) {
        let path = to.join(path.strip_prefix(from).unwrap());
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

/// Multiplies the lengths of a COLMAP model in text by a factor.
pub fn rescale(model: &Path, factor: f64) {
    for (file, first) in [("images.txt", 5), ("points3D.txt", 1)] {
        let scaled = |line: &str| {
            let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
            // Lines of observations stay.
            if !line.starts_with('#') && (first == 1 || line.contains(".png")) {
                words[first..first + 3].iter_mut().for_each(|w| *w = (factor * w.parse::<f64>().unwrap()).to_string());
            }
            words.join(" ") + "\n"
        };
        let text = fs::read_to_string(model.join(file)).unwrap();
        fs::write(model.join(file), text.lines().map(scaled).collect::<String>()).unwrap();
    }
}
