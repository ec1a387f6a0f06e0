//! COLMAP: features of every photo, matches of pairs, and the poses of all.

use super::child::{self, Output, Said};
use super::folder::Folder;
use super::parts;
use super::rig::{self, Rig};
use super::{Matching, Stage, Watcher};
use crate::job::{Error, host_bytes};
use crate::scene::{CameraKind, Names};
use crate::wording;
use std::fs;
use std::path::{Path, PathBuf};

/// The program.
pub(super) const PROGRAM: &str = "colmap";

/// Its command that keeps cameras of rigs together, from 3.12 on.
const RIGS: &str = "rig_configurator";
/// Longest side in pixels, and number of features of a photo, where a CPU finds and compares them: a pair takes 0.48 s
/// instead of 0.80.
const ON_CPU: (&str, &str) = ("1600", "4096");
/// Models of cameras whose field of view is known, and of others. With four coefficients and a wrong focal length to begin
/// with, COLMAP 3.8 placed 3 of 23 photos of the scene king; with one coefficient all of them.
const MODELS: (&str, &str) = ("OPENCV", "SIMPLE_RADIAL");
/// A quarter of the host memory that a thread may need, in bytes.
const THREAD_BYTES: u64 = 1 << 28;

/// Estimates poses, and writes them to the folder of models. Finished steps of an interrupted job are not repeated; unfinished
/// ones continue with the contents of the database.
pub(super) fn run(
    folder: &mut Folder,
    (matching, rig): (Matching, Option<&Rig>),
    watcher: &dyn Watcher,
) -> Result<(), Error> {
    let colmap = Colmap { log: folder.log(), watcher };
    let lens = rig.and_then(|rig| rig.lens);
    let rig = match rig {
        Some(rig) => colmap.knows_rigs()?.then_some(rig),
        None => None,
    };
    colmap.features(folder, (rig, lens))?;
    // Sequential pairs follow frames, so that a known rig comes before them.
    let placed = match rig.filter(|rig| rig.known) {
        Some(rig) => colmap.configure(folder, rig, None)?,
        None => false,
    };
    colmap.matches(folder, matching)?;
    colmap.map(folder, (placed, lens.is_some()))?;
    rig.filter(|rig| !rig.known).map_or(Ok(()), |rig| colmap.together(folder, rig))
}

/// COLMAP with its log.
struct Colmap<'a> {
    log: PathBuf,
    watcher: &'a dyn Watcher,
}

impl Colmap<'_> {
    fn call(&self, arguments: &[String], each: &mut dyn FnMut(&str)) -> Result<(), Error> {
        child::run((PROGRAM, arguments), Output::Text, &self.log, self.watcher, &mut |said| {
            if let Said::Line(line) = said {
                each(&line);
            }
        })
    }

    fn known(&self, command: &str) -> Result<Known, Error> {
        let mut help = String::new();
        self.call(&[command.to_owned(), "-h".to_owned()], &mut |line| help = format!("{help}{line}\n"))?;
        Ok(Known(help))
    }

    /// Returns true if this version keeps the cameras of rigs together.
    fn knows_rigs(&self) -> Result<bool, Error> {
        let knows = match self.known(RIGS) {
            Ok(help) => help.0.contains("--rig_config_path"),
            Err(Error::Program { .. }) => false,
            Err(other) => return Err(other),
        };
        if !knows {
            self.watcher.note(
                "this version of COLMAP does not support rigs (3.12 and newer do): the cameras are posed independently",
            );
        }
        Ok(knows)
    }

    /// Finds features; `lens` is that of all cameras, if it is known.
    fn features(&self, folder: &mut Folder, (rig, lens): (Option<&Rig>, Option<[f64; 4]>)) -> Result<(), Error> {
        let lens = lens.map(|lens| lens.map(|v| v.to_string()).join(","));
        let total = folder.photos().len();
        let extractor = self.known("feature_extractor")?;
        let (steps, mut unread) = steps(folder, rig);
        let mut done = 0_usize;
        for (number, step) in steps.iter().enumerate() {
            if number >= folder.features() {
                let list = child::list(folder.work().join("photos.txt"), &step.photos)?;
                let arguments = extractor.features(folder, (&list, lens.as_deref()), step);
                let (mut name, before) = (String::new(), unread.count);
                self.call(&arguments, &mut |line| {
                    if let Some((n, _)) = counted(line) {
                        self.watcher.progress(Stage::Features, done.saturating_add(n), total);
                    } else if let Some(photo) = line.trim_start().strip_prefix("Name:") {
                        photo.trim_ascii().clone_into(&mut name);
                    } else if line.contains("ERROR: Failed to read") {
                        unread.add(&name);
                    }
                })?;
                if step.camera.is_none() && unread.count > before {
                    // Without its first photo a camera is not in the database.
                    let last = format!("it cannot read {name}: convert this photo to JPEG, or leave it out");
                    return Err(Error::Program {
                        program: PROGRAM,
                        ended: "a photo".to_owned(),
                        last,
                        log: self.log.clone(),
                    });
                }
                folder.featured()?;
            }
            done += step.photos.len();
        }
        if unread.count > 0 {
            self.watcher
                .note(&format!("{} cannot be read and get no pose: {unread}", wording::counted(unread.count, "photo")));
        }
        Ok(())
    }

    fn matches(&self, folder: &mut Folder, matching: Matching) -> Result<(), Error> {
        if folder.has_matches(matching) {
            return Ok(());
        }
        let command = if matching == Matching::Sequential { "sequential_matcher" } else { "exhaustive_matcher" };
        let arguments = self.known(command)?.matches(command, folder);
        self.call(&arguments, &mut |line| {
            if let Some((n, of)) = counted(line) {
                self.watcher.progress(Stage::Matches, n, of);
            }
        })?;
        folder.matched(matching)
    }

    /// Finds the poses; `known` says whether the relative poses and the lenses of a rig's cameras are known.
    fn map(&self, folder: &Folder, known: (bool, bool)) -> Result<(), Error> {
        // Parts that an interrupted mapper left are not whole.
        let models = folder.models();
        let emptied = fs::remove_dir_all(&models).and_then(|()| fs::create_dir_all(&models));
        emptied.map_err(|source| Error::Write { path: models, source })?;
        let arguments = self.known("mapper")?.poses(folder, known);
        let total = folder.photos().len();
        let (mut placed, mut nothing) = (0, false); // photos of the largest part so far
        let ended = self.call(&arguments, &mut |line| {
            placed = placed.max(registered(line));
            nothing |= line.to_lowercase().contains("failed to create sparse model");
            self.watcher.progress(Stage::Poses, placed.min(total - 1), total);
        });
        // It fails where it finds no pose, which is told with all that it found.
        if nothing && matches!(ended, Err(Error::Program { .. })) { Ok(()) } else { ended }
    }

    /// Puts a rig into the database, with relative poses from the file or from `model`. Returns false if COLMAP refuses it.
    fn configure(&self, folder: &Folder, rig: &Rig, model: Option<&Path>) -> Result<bool, Error> {
        let config = folder.work().join(rig::FILE);
        fs::write(&config, &rig.text).map_err(|source| Error::Write { path: config.clone(), source })?;
        let mut files = vec![("--database_path", folder.database()), ("--rig_config_path", config)];
        files.extend(model.map(|model| ("--input_path", model.to_owned())));
        match self.call(&command(RIGS, &files, Vec::new()), &mut |_| ()) {
            Err(Error::Program { log, .. }) => {
                let log = log.display();
                self.watcher.note(&format!("COLMAP refuses the rig, so the cameras are posed independently ({log})"));
                Ok(false)
            }
            ended => ended.map(|()| true),
        }
    }

    /// Finds the poses again, with the cameras of a rig kept together. Their relative poses are the means over the poses so
    /// far.
    fn together(&self, folder: &Folder, rig: &Rig) -> Result<(), Error> {
        let (models, alone) = (folder.models(), folder.work().join("alone"));
        let Some((model, without)) = parts::largest(&models) else { return Ok(()) };
        if !self.configure(folder, rig, Some(&model))? {
            return Ok(());
        }
        let moved = |from: &Path, to: &Path| {
            let _ = fs::remove_dir_all(to);
            fs::rename(from, to).map_err(|source| Error::Write { path: to.to_owned(), source })
        };
        moved(&models, &alone)?;
        fs::create_dir_all(&models).map_err(|source| Error::Write { path: models.clone(), source })?;
        self.map(folder, (false, false))?;
        let with = parts::largest(&models).map_or(0, |(_, photos)| photos);
        if with < without {
            self.watcher.note(&format!(
                "with the rig {with} photos have poses, without it {without}: the cameras are posed independently"
            ));
            moved(&alone, &models)?;
        }
        let _ = fs::remove_dir_all(&alone);
        Ok(())
    }
}

/// The kind of a camera, and its number in the rigs.
type Kind = (CameraKind, Option<usize>);

/// A step of the features: photos of one camera.
struct Step {
    photos: Vec<String>,
    /// The camera's number, if it is in the database already.
    camera: Option<usize>,
    model: &'static str,
}

/// The steps of the features, and the photos whose size cannot be read. The first photo of a camera puts it into the database,
/// so that the others can share it even after an interruption.
fn steps(folder: &Folder, rig: Option<&Rig>) -> (Vec<Step>, Names) {
    let (mut cameras, mut unread): (Vec<(Kind, Vec<String>)>, _) = (Vec::new(), Names::default());
    for name in folder.photos() {
        let Some(kind) = CameraKind::of(&folder.images().join(name)) else {
            unread.add(name);
            continue;
        };
        let of = rig.and_then(|rig| rig.camera_of(name));
        match cameras.iter_mut().find(|((known, other), _)| of == *other && kind.shares(known)) {
            Some((_, photos)) => photos.push(name.clone()),
            None => cameras.push(((kind, of), vec![name.clone()])),
        }
    }
    let steps = (1..).zip(cameras).flat_map(|(number, ((kind, _), mut photos))| {
        let model = if kind.has_focal { MODELS.0 } else { MODELS.1 };
        let others = photos.split_off(1);
        [Step { photos, camera: None, model }, Step { photos: others, camera: Some(number), model }]
    });
    (steps.filter(|step| !step.photos.is_empty()).collect(), unread)
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

    fn features(&self, folder: &Folder, (list, lens): (&Path, Option<&str>), step: &Step) -> Vec<String> {
        let gpu = self.gpu();
        let camera = step.camera.map(|c| c.to_string());
        let shared: (&[&str], &str) = match &camera {
            Some(number) => (&["ImageReader.existing_camera_id"], number),
            None => (&["ImageReader.single_camera"], "1"),
        };
        let mut options = vec![
            shared,
            (&["ImageReader.camera_model"], if lens.is_some() { "PINHOLE" } else { step.model }),
            (&["FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"], if gpu { "1" } else { "0" }),
        ];
        options.extend(lens.map(|lens| (&["ImageReader.camera_params"][..], lens)));
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

    /// The relative poses and the lenses of a rig's cameras are known and stay fixed.
    fn poses(&self, folder: &Folder, (placed, lenses): (bool, bool)) -> Vec<String> {
        let files = [
            ("--database_path", folder.database()),
            ("--image_path", folder.images()),
            ("--output_path", folder.models()),
        ];
        // Small parts are told to the user.
        let mut options: Vec<(&[&str], &str)> = vec![(&["Mapper.min_model_size"], "3")];
        if placed {
            options.push((&["Mapper.ba_refine_sensor_from_rig"], "0"));
        }
        if lenses {
            options.push((&["Mapper.ba_refine_focal_length"], "0"));
            options.push((&["Mapper.ba_refine_extra_params"], "0"));
        }
        command("mapper", &files, self.arguments(&options))
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

/// The number of photos in a part with the one that a line says is tried next: `Registering image #7 (9)`.
fn registered(line: &str) -> usize {
    let told = line.split_once("Registering image").and_then(|(_, rest)| rest.rsplit_once('(')?.1.split_once(')'));
    told.and_then(|(n, _)| n.trim().parse().ok()).unwrap_or(0)
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
            Some((n.checked_sub(1)?.checked_mul(each)?.checked_add(m)?, of.checked_mul(each)?))
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
        assert_eq!(["Registering image #7 (9)", "=> Image sees 20 / 30 points"].map(registered), [9, 0]);
        for other in [
            "[9223372036854775807/9223372036854775807, 2/3]",
            "  Name: a[1].jpg",
            "Registering image #3 (4)",
            "[x/2]",
            "[0/2, 1/2]",
            "[",
        ] {
            assert_eq!(counted(other), None, "{other}");
        }
    }
}
