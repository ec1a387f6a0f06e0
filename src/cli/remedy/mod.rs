//! Remedies for errors. The floors below name causes and know no options; this file adds the advice.

mod device;

use self::device::{device, smaller};
use super::shard::VERIFY;
use crate::extension::folder_of;
use crate::gaussians::formats;
use crate::job::Error;
use crate::job::earlier::{is_config_kept, is_run};
use crate::scene::{OpenOptions, Scene, archive_in, photo_names};
use crate::wording::counted;
use crate::{edit, gaussians, metrics, scene, synth, train};
use std::env::consts::OS;
use std::io;
use std::path::Path;

/// Advice on `error`, as a clause that follows its cause; `None` if the cause is enough.
pub(super) fn remedy(error: &Error) -> Option<String> {
    match error {
        Error::Read { path, source }
            if path.ends_with("plan.json") && source.kind() == io::ErrorKind::NotFound && folder_of(path).is_dir() =>
        {
            Some(unplanned(folder_of(path)))
        }
        Error::Read { source, .. } => readable(source),
        Error::Write { source, .. } => writable(source),
        Error::Device(e) => device(e),
        Error::Study(_) => plain("remove this Gaussian from the model, or train the model again"),
        Error::Train(e) => training(e),
        Error::Gaussians(e) => model(e),
        Error::Edit(edit::Error::Modes(..)) => plain("choose one by --antialias=on or --antialias=off"),
        Error::Scene(e) => capture(e),
        Error::Synth(e) => synthetic(e),
        Error::Metrics(e) => scores(e),
        Error::Memory { relief, .. } => Some(smaller(*relief, false)),
        Error::Buffer { relief, .. } => Some(smaller(*relief, true)),
        Error::SelfTest { .. } => plain(
            "update the driver (known bad: llvmpipe of Mesa before 25, which ends shader loops after 65,535 iterations), or choose \
             another device with --device",
        ),
        Error::NoProgram(programs) => Some(install(programs, OS)),
        Error::Program { .. } => plain("run the same command again to resume; if it fails again, read the log"),
        Error::FewPoses { sequential, .. } => {
            let photos = "walk around the scene and take at least 20 sharp photos at one zoom, each showing two thirds of the one \
                          before; surfaces need texture";
            let pairs = if *sequential { ". `--matching exhaustive` compares more pairs" } else { "" };
            Some(format!("{photos}{pairs}"))
        }
        Error::Picture { .. } => plain("give a smaller --size or --resolution"),
        Error::Threads(_) => {
            plain("set RAYON_NUM_THREADS to a smaller number, or raise the limits on processes (ulimit -u, pids.max)")
        }
        Error::NothingToPose(_) => plain("name the folder that holds the photos"),
        Error::NotOurs(_) => plain("name an empty or new folder with -o"),
        Error::AmongPhotos(_) => plain("name another folder with -o"),
        Error::NothingToTrainOn(_) => plain("give a larger --eval-every, or --eval-every 0 to train on every photo"),
        Error::AllHidden(_) => {
            plain("masks hide where they are black: invert them, or give --effect masks=off to train without them")
        }
        Error::NothingHeldOut(_) => plain("give --eval-every 1 to score all of them"),
        Error::OtherRun { folder, .. } => {
            let [config, checkpoint] = ["config.toml", "checkpoint.safetensors"].map(|file| quoted(&folder.join(file)));
            if !is_config_kept(folder) {
                return Some(format!(
                    "use the original options and photos, which {config} no longer names: it was changed or removed since the checkpoint \
                     was written. To begin anew, delete {checkpoint}"
                ));
            }
            Some(format!(
                "use the original options (`--config {config}` gives `run` all of them) and photos, or another folder with -o"
            ))
        }
        Error::Busy(_) => plain("wait until it ends, or name another folder with -o"),
        Error::Unfinished(checkpoint) => {
            Some(format!("add --resume to continue it, or delete {} to start from the beginning", checkpoint.display()))
        }
        Error::Finished(_) => plain("name another folder with -o, or replace that run with --overwrite"),
        Error::Part { path, task, .. } => Some(divided(path, task)),
        Error::Diagnostics { .. } => plain(
            "use it with the model before the prune: the input of `compress`, or the .ply that `run` wrote beside it",
        ),
        Error::LostPhoto { .. } | Error::ChangedPhoto { .. } => {
            plain("restore the photo, or plan again in a new folder")
        }
        Error::OtherDevice { .. } => {
            plain("use a machine like the plan's, or allow this one with --mixed: the bytes may then differ")
        }
        Error::Checkpoint { .. } => {
            plain("finish the run with the version that began it, or delete the checkpoint to start from the beginning")
        }
        Error::Encode { .. } => {
            plain("rename files and folders whose names are not UTF-8; if it happens again, please report it")
        }
        Error::Config { .. } | Error::Edit(_) | Error::Usage(_) | Error::Print(_) | Error::Interrupted => None,
    }
}

/// Advice on a folder without the plan of a divided job.
fn unplanned(folder: &Path) -> String {
    let what = if is_run(folder) { "is the folder of a run, and holds no plan" } else { "holds no plan" };
    format!("{} {what}: `qirf-vk shard plan` writes one", folder.display())
}

/// Advice on a file of a divided job, which a task wrote or was to write, or on the job's folder.
fn divided(path: &Path, task: &str) -> String {
    if task == "plan" {
        format!("restore {}, or plan again in a new folder", path.display())
    } else if task == VERIFY {
        "delete these files and those of all tasks that need them, directly or not (tasks.json), and run the job again: it repeats \
         the missing tasks"
            .to_owned()
    } else if path.exists() {
        format!("delete {} and run the job again: it repeats the missing tasks", path.display())
    } else {
        // The files of a stage's parts are in a folder of that stage.
        let folder = path.ancestors().nth(if task.contains('/') { 2 } else { 1 }).unwrap_or(path);
        let folder = quoted(folder);
        format!("run `qirf-vk shard task {folder} {task}`, or `qirf-vk shard all {folder}`")
    }
}

/// Advice on a file or folder that cannot be read.
fn readable(cause: &io::Error) -> Option<String> {
    match cause.kind() {
        io::ErrorKind::NotFound => plain("check the path"),
        io::ErrorKind::PermissionDenied => plain("check its permissions"),
        io::ErrorKind::InvalidData => plain("it is not a UTF-8 text file: check the path"),
        _ => plain("check that it exists and that you may read it"),
    }
}

/// Advice on a file or folder that cannot be written.
fn writable(cause: &io::Error) -> Option<String> {
    match cause.kind() {
        io::ErrorKind::NotFound => plain("create its folder, or choose another path"),
        io::ErrorKind::PermissionDenied if cfg!(windows) => {
            plain("close the program that has it open, check its permissions, or choose another path")
        }
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            plain("check its permissions, or choose another path")
        }
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            plain("free some space, or choose another path")
        }
        _ => plain("choose another path"),
    }
}

/// Advice on a path that is neither the scene nor the model that was expected; `None` if its contents are unknown.
fn other_kind(path: &Path) -> Option<String> {
    if path.is_file() && formats::is_model_name(path) {
        let path = quoted(path);
        Some(format!(
            "it is a model (`qirf-vk view {path}` shows it): give the folder of photos with poses that it was trained on"
        ))
    } else if is_run(path) {
        let [model, config] = ["model.ply", "config.toml"].map(|file| quoted(&path.join(file)));
        Some(format!("it is the folder of a run: its model is {model}, and {config} names its scene"))
    } else if path.join("plan.json").is_file() {
        Some(format!("it is the folder of a divided job: `qirf-vk shard status {}` shows its state", quoted(path)))
    } else if Scene::find(path, &OpenOptions::default()).is_ok() {
        Some(format!("it is a scene: give a model, or train one with `qirf-vk run {} -o DIR`", quoted(path)))
    } else {
        None
    }
}

#[allow(clippy::unnecessary_wraps)] // every arm of the matches here is an option
fn plain(text: &str) -> Option<String> {
    Some(text.to_owned())
}

fn training(error: &train::Error) -> Option<String> {
    match error {
        train::Error::Device(e) => device(e),
        train::Error::NoViews => plain("hold fewer out with a larger --eval-every, or add photos"),
        train::Error::Photos(_) => plain("free some space, or give a smaller --resolution"),
        train::Error::OtherPhotos { .. } => plain("restore its photos, or start without --resume"),
        train::Error::Method { .. } => plain("start without --resume"),
        train::Error::Points { .. } => plain("check the poses and the scene's scale, or give --init MODEL"),
    }
}

fn model(error: &gaussians::Error) -> Option<String> {
    match error {
        gaussians::Error::SameFile { .. } => plain("give the output another name"),
        gaussians::Error::NotAFile { .. } => plain("results are files: name one"),
        gaussians::Error::Unsupported { path, .. } if path.is_dir() => {
            other_kind(path).or_else(|| plain("give a model file or such a folder"))
        }
        // The reader of a format describes best what its file lacks.
        _ => None,
    }
}

fn capture(error: &scene::Error) -> Option<String> {
    match error {
        scene::Error::Io { source, .. } => readable(source),
        scene::Error::NoPoses { root, images, .. } => Some(pose(root, images)),
        scene::Error::NoScene { root, .. } => {
            Some(other_kind(root).unwrap_or_else(|| "give the folder that holds one of them".to_owned()))
        }
        scene::Error::SeveralScenes { .. } => plain("give the folder of one"),
        scene::Error::NoImageFolder { .. } => plain("give one with --images, or, for depth maps, with --depth"),
        scene::Error::NoPhotos { root, what, .. } => {
            Some(absent(root, Path::new(what.strip_suffix(" does not exist")?)))
        }
        scene::Error::NoViews { what, .. } if what.contains("mirrored") => None,
        scene::Error::NoViews { .. } => plain("reconstruct the scene again"),
        _ => None,
    }
}

/// Advice on a capture without any of its photos, of which this is the first.
fn absent(root: &Path, photo: &Path) -> String {
    let folder = folder_of(photo);
    let others = photo_names(folder);
    if let Some(first) = others.first() {
        let (folder, photos) = (folder.display(), counted(others.len(), "photo"));
        return format!(
            "{folder} holds {photos} of other names, such as {first}: rename them, or name another folder with --images DIR"
        );
    }
    match archive_in(root).or_else(|| archive_in(folder)) {
        Some(archive) => format!("unpack {}, if it holds them", quoted(&archive)),
        None => "name their folder with --images DIR".to_owned(),
    }
}

fn synthetic(error: &synth::Error) -> Option<String> {
    match error {
        synth::Error::Conflict(..) => plain("leave one out"),
        synth::Error::NotThere { .. } => plain("leave it out"),
        synth::Error::Foreign(_) | synth::Error::NotFolder(_) => plain("name an empty or new folder"),
        _ => None,
    }
}

fn scores(error: &metrics::Error) -> Option<String> {
    match error {
        metrics::Error::Sizes(..) => plain("render at the photo's size"),
        metrics::Error::Read { .. } => plain("check --lpips-weights, or run tools/lpips-weights"),
        metrics::Error::Weights { .. } => plain("create the file again with tools/lpips-weights"),
        metrics::Error::Pixels { .. } | metrics::Error::TooSmall { .. } => None,
    }
}

/// The commands that install one of these programs.
fn install(programs: &[&str], system: &str) -> String {
    let line = |program: &&str| match (*program, system) {
        ("openmvg-sfm", _) => "`cargo install openmvg-cli`",
        ("colmap", "windows") => "its zip for Windows, whose folder goes on the PATH",
        ("colmap", "macos") => "`brew install colmap`",
        ("colmap", _) => "`sudo apt-get install colmap`",
        (_, "windows") => "`winget install ffmpeg`",
        (_, "macos") => "`brew install ffmpeg`",
        _ => "`sudo apt-get install ffmpeg`",
    };
    let mut lines: Vec<&str> = programs.iter().map(line).collect();
    lines.dedup();
    let which = if lines.len() == 1 { "it" } else { "one" };
    format!("install {which} by {}", lines.join(" or "))
}

/// The command that estimates camera poses.
fn pose(root: &Path, images: &Path) -> String {
    let input =
        if images == root || ["images", "input"].iter().any(|sub| images == root.join(sub)) { root } else { images };
    format!("`qirf-vk pose {} -o SCENE` estimates them", quoted(input))
}

pub(super) fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%=".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu;
    use std::path::PathBuf;

    fn says(error: impl Into<Error>, parts: &[&str]) {
        let error = error.into();
        let told = remedy(&error).unwrap_or_else(|| panic!("no remedy for: {error}"));
        for part in parts {
            assert!(told.contains(part), "{told:?} lacks {part:?}");
        }
    }

    #[test]
    fn remedies_name_the_options_that_help() {
        let path = || PathBuf::from("a b/c");
        says(gpu::Error::NoLoader("x".into()), &["libvulkan1", "tools/setup"]);
        says(gpu::Error::MissingFeature { device: "D".into(), feature: "f".into() }, &["--device"]);
        says(gpu::Error::Lost("submit"), &["--resume", "--resolution", "--device"]);
        says(train::Error::NoViews, &["--eval-every"]);
        says(train::Error::from(gpu::Error::NoDevice), &["mesa-vulkan-drivers"]);
        says(train::Error::from(gpu::Error::NoDriver), &["mesa-vulkan-drivers", "libglvnd0"]);
        says(train::Error::Photos(io::ErrorKind::StorageFull.into()), &["free some space", "--resolution"]);
        says(
            train::Error::Points { found: 1, asked: 3000, tries: 9, near: 0.2, cameras: 2 },
            &["poses", "--init MODEL"],
        );
        says(gaussians::Error::SameFile { path: path() }, &["another name"]);
        says(
            scene::Error::NoPhotos { root: path(), listed: 5, what: "a b/c/a.png does not exist".into() },
            &["--images DIR"],
        );
        let what = "a.png: only a.heic is there, in HEIC, which is not read".to_owned();
        assert!(remedy(&Error::Scene(scene::Error::NoPhotos { root: path(), listed: 5, what })).is_none());
        says(scene::Error::NoImageFolder { root: path(), asked: path(), known: Vec::new() }, &["--images"]);
        says(metrics::Error::Read { path: path(), source: io::ErrorKind::NotFound.into() }, &["--lpips-weights"]);
        says(synth::Error::Foreign(path()), &["empty or new folder"]);
        says(Error::Write { path: path(), source: io::ErrorKind::StorageFull.into() }, &["free some space"]);
        says(Error::Write { path: path(), source: io::ErrorKind::NotFound.into() }, &["create its folder"]);
        // A loop of links is of no stable kind.
        for kind in [io::ErrorKind::NotADirectory, io::ErrorKind::Other] {
            let nowhere = Error::Write { path: path(), source: kind.into() };
            assert_eq!(remedy(&nowhere).as_deref(), Some("choose another path"));
        }
        says(Error::Read { path: path(), source: io::ErrorKind::NotFound.into() }, &["check the path"]);
        let unplanned =
            |folder: &Path| Error::Read { path: folder.join("plan.json"), source: io::ErrorKind::NotFound.into() };
        says(unplanned(&path()), &["check the path"]);
        says(unplanned(&std::env::temp_dir()), &["holds no plan: `qirf-vk shard plan` writes one"]);
        says(Error::NothingToTrainOn(path()), &["larger --eval-every"]);
        says(Error::NothingHeldOut(path()), &["--eval-every 1"]);
        says(Error::OtherRun { folder: path(), changes: Vec::new() }, &["--config 'a b/c/config.toml'", "-o"]);
        says(Error::Unfinished(path()), &["--resume", "delete a b/c"]);
        says(Error::Finished(path()), &["--overwrite", "-o"]);
        assert!(remedy(&Error::Interrupted).is_none());
    }

    #[test]
    fn a_task_that_is_not_done_is_named_with_its_folder() {
        let part = |path: &str, task: &str| Error::Part { path: path.into(), what: String::new(), task: task.into() };
        says(part("a b/assign.json", "assign"), &["`qirf-vk shard task 'a b' assign`", "`qirf-vk shard all 'a b'`"]);
        says(part("a/dense/0001.safetensors", "dense/0001"), &["`qirf-vk shard task a dense/0001`"]);
        says(part("a", VERIFY), &["delete these files", "all tasks that need them"]);
        says(part("a/plan.json", "plan"), &["restore a/plan.json"]);
    }

    #[test]
    fn a_run_a_model_and_a_scene_in_the_wrong_place_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (run, file) = (folder.path().join("run"), folder.path().join("flowers.SPZ"));
        std::fs::create_dir(&run).unwrap();
        for path in [&run.join("config.toml"), &run.join("model.ply"), &file] {
            std::fs::write(path, "").unwrap();
        }
        let no_scene =
            |root: &Path| scene::Error::NoScene { root: root.to_owned(), looked_for: "", beside: String::new() };
        says(no_scene(&run), &["folder of a run", "model.ply", "config.toml"]);
        says(no_scene(&file), &["it is a model", "qirf-vk view"]);
        says(
            gaussians::Error::Unsupported { path: run.clone(), what: String::new() },
            &["folder of a run", "model.ply"],
        );
        std::fs::remove_file(run.join("config.toml")).unwrap();
        std::fs::write(run.join("transforms.json"), "{}").unwrap();
        says(gaussians::Error::Unsupported { path: run, what: String::new() }, &["it is a scene", "qirf-vk run"]);
        std::fs::remove_dir_all(folder.path().join("run")).unwrap();
        says(no_scene(folder.path()), &["the folder that holds one"]);
    }

    #[test]
    fn photos_that_are_packed_or_have_other_names_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (root, images) = (folder.path(), folder.path().join("images"));
        let what = format!("{} does not exist", images.join("a.png").display());
        let error = || scene::Error::NoPhotos { root: root.to_owned(), listed: 5, what: what.clone() };
        std::fs::write(root.join("images.zip"), "").unwrap();
        says(error(), &["unpack ", "images.zip"]);
        std::fs::create_dir(&images).unwrap();
        std::fs::write(images.join("image000.png"), "").unwrap();
        says(error(), &["images holds 1 photo of other names, such as image000.png", "--images DIR"]);
    }

    #[test]
    fn photos_without_poses_are_told_the_command() {
        let error = |root: &str, images: &str| scene::Error::NoPoses {
            root: root.into(),
            images: images.into(),
            photos: 3,
            beside: String::new(),
        };
        says(error("/s", "/s/images"), &["`qirf-vk pose /s -o SCENE`"]);
        says(error("/s", "/s/small"), &["`qirf-vk pose /s/small -o SCENE`"]);
        says(error("a b's", "a b's"), &[r"`qirf-vk pose 'a b'\''s' -o SCENE`"]);
        says(Error::NoProgram(vec!["colmap", "openmvg-sfm"]), &["apt-get install colmap", "cargo install openmvg-cli"]);
        assert_eq!(install(&["ffmpeg", "ffprobe"], "linux"), "install it by `sudo apt-get install ffmpeg`");
        let all = ["colmap", "openmvg-sfm", "ffmpeg"];
        let brew = "install one by `brew install colmap` or `cargo install openmvg-cli` or `brew install ffmpeg`";
        assert_eq!(install(&all, "macos"), brew);
        let there = install(&all, "windows");
        assert!(there.contains("winget") && there.contains("on the PATH") && !there.contains("apt"), "{there}");
        says(Error::FewPoses { photos: 9, posed: 1, sequential: true }, &["sharp", "--matching exhaustive"]);
    }
}
