//! COLMAP: features of every photo, matches of pairs, and the poses of all.

use super::child::{self, Output, Said};
use super::folder::Folder;
use super::{FEATURES, MATCHES, Matching, POSES, Watcher};
use crate::pipeline::Error;
use crate::pipeline::session::host_bytes;
use crate::scene::CameraKind;
use std::fs;
use std::path::{Path, PathBuf};

/// The program.
pub(super) const PROGRAM: &str = "colmap";

/// Longest side in pixels, and number of features of a photo, where a CPU finds and compares them: a pair takes 0.48 s
/// instead of 0.80.
const ON_CPU: (&str, &str) = ("1600", "4096");
/// Models of cameras whose field of view is known, and of others. With four coefficients and a wrong focal length to begin
/// with, COLMAP 3.8 placed 3 of 23 photos of the scene king; with one coefficient all of them.
const MODELS: (&str, &str) = ("OPENCV", "SIMPLE_RADIAL");
/// A quarter of the host memory that a thread may need, in bytes.
const THREAD_BYTES: u64 = 1 << 28;

/// Estimates poses, into the folder of models. Finished steps of an interrupted job are not repeated; unfinished ones go
/// on with what is in the database.
pub(super) fn run(folder: &mut Folder, matching: Matching, watcher: &dyn Watcher) -> Result<(), Error> {
    let log = folder.log();
    let call = |arguments: &[String], each: &mut dyn FnMut(&str)| {
        child::run((PROGRAM, arguments), Output::Text, &log, watcher, &mut |said| {
            if let Said::Line(line) = said {
                each(&line);
            }
        })
    };
    let known = |command: &str| -> Result<Known, Error> {
        let mut help = String::new();
        call(&[command.to_owned(), "-h".to_owned()], &mut |line| help = format!("{help}{line}\n"))?;
        Ok(Known(help))
    };
    let total = folder.photos().len();

    let extractor = known("feature_extractor")?;
    let mut done = 0;
    for (number, step) in steps(folder).iter().enumerate() {
        if number >= folder.features() {
            let list = child::list(folder.work().join("photos.txt"), &step.photos)?;
            let arguments = extractor.features(folder, &list, step);
            call(&arguments, &mut |line| {
                if let Some((n, _)) = counted(line) {
                    watcher.posing(FEATURES, done + n, total);
                }
            })?;
            folder.featured()?;
        }
        done += step.photos.len();
    }

    if !folder.has_matches(matching) {
        let command = if matching == Matching::Sequential { "sequential_matcher" } else { "exhaustive_matcher" };
        let arguments = known(command)?.matches(command, folder);
        call(&arguments, &mut |line| {
            if let Some((n, of)) = counted(line) {
                watcher.posing(MATCHES, n, of);
            }
        })?;
        folder.matched(matching)?;
    }

    // Parts that an interrupted mapper left are not whole.
    let models = folder.models();
    let emptied = fs::remove_dir_all(&models).and_then(|()| fs::create_dir_all(&models));
    emptied.map_err(|source| Error::Write { path: models, source })?;
    let arguments = known("mapper")?.poses(folder);
    let (mut placed, mut nothing) = (0, false);
    let ended = call(&arguments, &mut |line| {
        placed += usize::from(line.contains("Registering image"));
        nothing |= line.to_lowercase().contains("failed to create sparse model");
        watcher.posing(POSES, placed.min(total - 1), total);
    });
    // It fails where it finds no pose, which is told with all that it found.
    if nothing && matches!(ended, Err(Error::Program { .. })) { Ok(()) } else { ended }
}

/// A step of the features: photos of one camera.
struct Step {
    photos: Vec<String>,
    /// The camera's number, if it is in the database already.
    camera: Option<usize>,
    model: &'static str,
}

/// The steps of the features. The first photo of a camera puts it into the database, so that the others can share it even
/// after an interruption.
fn steps(folder: &Folder) -> Vec<Step> {
    let mut cameras: Vec<(CameraKind, Vec<String>)> = Vec::new();
    for name in folder.photos() {
        let Some(kind) = CameraKind::of(&folder.images().join(name)) else { continue };
        match cameras.iter_mut().find(|(known, _)| kind.shares(known)) {
            Some((_, photos)) => photos.push(name.clone()),
            None => cameras.push((kind, vec![name.clone()])),
        }
    }
    let steps = (1..).zip(cameras).flat_map(|(number, (kind, mut photos))| {
        let model = if kind.has_focal { MODELS.0 } else { MODELS.1 };
        let others = photos.split_off(1);
        [Step { photos, camera: None, model }, Step { photos: others, camera: Some(number), model }]
    });
    steps.filter(|step| !step.photos.is_empty()).collect()
}

/// The help of a command, which tells the options of this version of COLMAP.
struct Known(String);

impl Known {
    /// Arguments for those of the options that this version knows. Options were renamed: of several spellings the first one
    /// known is used.
    fn arguments(&self, options: &[(&[&str], &str)]) -> Vec<String> {
        let words: Vec<&str> = self.0.split_whitespace().collect();
        let known =
            |spellings: &[&str]| spellings.iter().map(|s| format!("--{s}")).find(|s| words.contains(&s.as_str()));
        options.iter().filter_map(|(s, value)| Some([known(s)?, (*value).to_owned()])).flatten().collect()
    }

    /// True if features are to be found and compared by a GPU.
    fn gpu(&self) -> bool {
        let devices = ["/dev/nvidiactl", "/dev/dxg"];
        self.0.contains("with CUDA") && (cfg!(windows) || devices.iter().any(|d| Path::new(d).exists()))
    }

    fn features(&self, folder: &Folder, list: &Path, step: &Step) -> Vec<String> {
        let gpu = self.gpu();
        let camera = step.camera.map(|c| c.to_string());
        let shared: (&[&str], &str) = match &camera {
            Some(number) => (&["ImageReader.existing_camera_id"], number),
            None => (&["ImageReader.single_camera"], "1"),
        };
        let mut options = vec![
            shared,
            (&["ImageReader.camera_model"], step.model),
            (&["FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"], if gpu { "1" } else { "0" }),
        ];
        let threads = threads();
        if !gpu {
            options.extend::<[(&[&str], &str); 3]>([
                (&["FeatureExtraction.num_threads", "SiftExtraction.num_threads"], &threads),
                (&["FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"], ON_CPU.0),
                (&["SiftExtraction.max_num_features"], ON_CPU.1),
            ]);
        }
        let files = [
            ("--database_path", folder.database()),
            ("--image_path", folder.images()),
            ("--image_list_path", list.to_owned()),
        ];
        command("feature_extractor", &files, self.arguments(&options))
    }

    fn matches(&self, name: &str, folder: &Folder) -> Vec<String> {
        let options: [(&[&str], &str); 4] = [
            (&["FeatureMatching.use_gpu", "SiftMatching.use_gpu"], if self.gpu() { "1" } else { "0" }),
            (&["SequentialMatching.overlap"], "10"),
            (&["SequentialMatching.quadratic_overlap"], "1"),
            // Progress is told after each block.
            (&["ExhaustiveMatching.block_size"], "10"),
        ];
        command(name, &[("--database_path", folder.database())], self.arguments(&options))
    }

    fn poses(&self, folder: &Folder) -> Vec<String> {
        let files = [
            ("--database_path", folder.database()),
            ("--image_path", folder.images()),
            ("--output_path", folder.models()),
        ];
        // Small parts are told to the user.
        command("mapper", &files, self.arguments(&[(&["Mapper.min_model_size"], "3")]))
    }
}

fn command(name: &str, files: &[(&str, PathBuf)], options: Vec<String>) -> Vec<String> {
    let files = files.iter().flat_map(|(option, path)| [(*option).to_owned(), path.display().to_string()]);
    std::iter::once(name.to_owned()).chain(files).chain(options).collect()
}

/// Threads that the host's memory suffices for.
fn threads() -> String {
    let most = host_bytes(None) / THREAD_BYTES;
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get) as u64;
    most.clamp(1, cores).to_string()
}

/// Progress in brackets: `[3/50]`, or `[2/5, 1/5]`, which counts both.
fn counted(line: &str) -> Option<(usize, usize)> {
    let inside = line.rsplit_once('[')?.1.split_once(']')?.0;
    let mut counts = inside.split(',').map(|part| -> Option<(usize, usize)> {
        let (n, of) = part.trim().split_once('/')?;
        Some((n.parse().ok()?, of.parse().ok()?))
    });
    let (n, of) = counts.next()??;
    match counts.next() {
        None => Some((n, of)),
        Some(inner) => {
            let (m, each) = inner?;
            Some((n.checked_sub(1)? * each + m, of * each))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_spelled_as_this_version_knows_them() {
        let options: [(&[&str], &str); 2] = [(&["New.use_gpu", "Old.use_gpu"], "0"), (&["Gone.x"], "1")];
        let spelled = |help: &str| Known(help.to_owned()).arguments(&options).join(" ");
        assert_eq!(spelled("  --Old.use_gpu arg (=1)\n"), "--Old.use_gpu 0");
        assert_eq!(spelled("  --Old.use_gpu arg (=1)\n  --New.use_gpu arg (=1)\n --Gone.xy arg"), "--New.use_gpu 0");
        assert!(!Known("COLMAP 3.8 (Commit Unknown on Unknown without CUDA)".into()).gpu());
    }

    #[test]
    fn progress_is_read_from_either_kind_of_line() {
        assert_eq!(counted("Processed file [12/50]"), Some((12, 50)));
        assert_eq!(counted("I2026 08:00:00 99 a.cc:12] Matching image [3/50] in 0.1s"), Some((3, 50)));
        assert_eq!(counted("Matching block [2/5, 1/5] in 3.2s"), Some((6, 25)));
        for other in ["  Name: a[1].jpg", "Registering image #3 (4)", "[x/2]", "[0/2, 1/2]", "["] {
            assert_eq!(counted(other), None, "{other}");
        }
    }
}
