//! With a shell script in COLMAP's place: it notes how it is called, and does what the test wants.

use crate::program::ended::copy;
use crate::program::faults::harness::{Ended, content, end, program, scene, start};
use crate::support::documented;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;

const SCRIPT: &str = r#"#!/bin/sh
echo "$*" >> "$FAKE/calls"
if [ "$2" = -h ]; then
  if [ -n "$FAKE_LATE" ]; then (sleep 0.3; cat "$FAKE/help") & exit; fi
  cat "$FAKE/help"; exit
fi
command=$1
if [ "$command" = "$FAKE_AT" ]; then
  if [ "$FAKE_DOES" = hang ]; then
    trap '' INT TERM
    echo $$ > "$FAKE/pid"
    while :; do sleep 1; done
  fi
  echo "no memory is left" >&2
  echo "----" >&2
  exit 7
fi
while [ $# -gt 1 ]; do
  case $1 in
    --image_list_path) list=$2 ;;
    --output_path) output=$2 ;;
  esac
  shift
done
case $command in
  feature_extractor) n=0; while read -r name; do n=$((n + 1)); echo "Processed file [$n/9]"
    echo "  Name: $name"
    case $name in *strange*) echo "  ERROR: Failed to read image file format." ;; esac; done < "$list" ;;
  exhaustive_matcher) echo "Matching block [1/1, 1/1]" ;;
  mapper)
    cp -r "$FAKE/models/." "$output"
    if [ -z "$(ls "$output")" ]; then echo "ERROR: failed to create sparse model"; exit 1; fi ;;
esac
"#;

const OPENMVG: &str = r#"#!/bin/sh
[ "$2 $3" = "--colmap --share-intrinsics" ] && [ "$5" = --output ] || exit 2
mkdir -p "$6/colmap/sparse" && cp -r "$FAKE/models/0" "$6/colmap/sparse/0"
"#;

const OLD: &str = "COLMAP 3.8 (Commit Unknown without CUDA)
  --ImageReader.single_camera arg (=0)
  --ImageReader.existing_camera_id arg (=-1)
  --ImageReader.camera_model arg (=SIMPLE_RADIAL)
  --SiftExtraction.use_gpu arg (=1)
  --SiftMatching.use_gpu arg (=1)
  --SequentialMatching.overlap arg (=10)
";

/// A folder with twelve photos, the script, and its answers.
pub struct Stage {
    folder: TempDir,
}

impl Stage {
    pub fn new() -> Self {
        let stage = Self { folder: tempfile::tempdir().unwrap() };
        for sub in ["photos", "bin", "fake/models"] {
            fs::create_dir_all(stage.path(sub)).unwrap();
        }
        for name in names(0..12) {
            image::RgbImage::new(40, 30).save(stage.path("photos").join(name)).unwrap();
        }
        for (name, text) in [("colmap", SCRIPT), ("openmvg-sfm", OPENMVG)] {
            let script = stage.path("bin").join(name);
            fs::write(&script, text).unwrap();
            fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        }
        fs::write(stage.path("fake/help"), OLD).unwrap();
        stage
    }

    pub fn path(&self, part: &str) -> PathBuf {
        self.folder.path().join(part)
    }

    /// A model that the script will give.
    pub fn gives(&self, number: usize, photos: std::ops::Range<usize>) {
        self.gives_named(number, &names(photos));
    }

    /// The same with photos of these names.
    pub fn gives_named(&self, number: usize, photos: &[String]) {
        let model = self.path("fake/models").join(number.to_string());
        fs::create_dir_all(&model).unwrap();
        let line = |(i, name): (usize, &String)| format!("{i} 1 0 0 0 0.{i} 0 4 1 {name}\n\n");
        fs::write(model.join("cameras.txt"), "1 PINHOLE 40 30 35 35 20 15\n").unwrap();
        fs::write(model.join("images.txt"), (1..).zip(photos).map(line).collect::<String>()).unwrap();
        fs::write(model.join("points3D.txt"), "1 0 0 0 10 20 30 0.5 1 0\n").unwrap();
    }

    /// The program in this folder, with the script before all other programs.
    pub fn program(&self, arguments: &[&str]) -> Command {
        let mut path = vec![self.path("bin")];
        path.extend(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()));
        let mut command = program();
        command.args(arguments).current_dir(self.folder.path()).env("FAKE", self.path("fake"));
        command.env("PATH", std::env::join_paths(path).unwrap());
        command
    }

    pub fn pose(&self, more: &[&str]) -> Command {
        self.program(&[&["pose", "photos", "-o", "scene"], more].concat())
    }

    /// The script's calls so far whose first word is this; help is not counted.
    pub fn calls(&self, of: &str) -> Vec<String> {
        let calls = fs::read_to_string(self.path("fake/calls")).unwrap_or_default();
        calls.lines().filter(|l| l.starts_with(of) && !l.ends_with("-h")).map(ToOwned::to_owned).collect()
    }
}

fn names(photos: std::ops::Range<usize>) -> Vec<String> {
    photos.map(|i| format!("{i:02}.png")).collect()
}

pub fn works(mut command: Command) -> (Ended, String) {
    let ended = end(&mut command).with(0, &[]);
    let said = ended.out.clone();
    (ended, said)
}

/// The last output of a program may arrive after its end.
#[test]
fn late_words_are_heard() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let mut pose = stage.pose(&[]);
    pose.env("FAKE_LATE", "1");
    works(pose);
    assert!(stage.calls("exhaustive_matcher")[0].contains("--SiftMatching.use_gpu 0"));
}

#[test]
fn photos_that_colmap_cannot_read_are_named() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    fs::copy(stage.path("photos/05.png"), stage.path("photos/strange.png")).unwrap();
    fs::write(stage.path("photos/garbage.png"), "no photo").unwrap();
    let (ended, said) = works(stage.pose(&[]));
    assert!(ended.said.contains("2 photos cannot be read and get no pose: garbage.png, strange.png"), "{}", ended.said);
    assert!(said.contains("12 of 14 photos have poses"), "{said}");
    // The first photo of a camera: no other could share it.
    fs::copy(stage.path("photos/05.png"), stage.path("photos/00 strange.png")).unwrap();
    end(&mut stage.pose(&[])).with(3, &["cannot read 00 strange.png", "leave it out"]);
}

#[test]
fn photos_of_many_bits_are_placed_in_eight() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let deep = |x: u32, y: u32| image::Rgb([(x * 1500) as u16, (y * 2000) as u16, 257]);
    let photo = image::ImageBuffer::from_fn(40, 30, deep);
    photo.save(stage.path("photos/03.png")).unwrap();
    photo.save(stage.path("photos/deep.tif")).unwrap();
    works(stage.pose(&[]));
    let images = stage.path("scene/images");
    for name in ["03.png", "deep.tif.png"] {
        let placed = image::open(images.join(name)).unwrap();
        assert_eq!(placed.color(), image::ColorType::Rgb8, "{name}");
        assert_eq!(placed.to_rgb8(), image::DynamicImage::from(photo.clone()).to_rgb8(), "{name}");
    }
    assert!(!images.join("deep.tif").exists());
    let own = image::open(stage.path("photos/03.png")).unwrap();
    assert_eq!(own.color(), image::ColorType::Rgb16, "the photo itself stays as it is");
}

/// COLMAP's models may share photos.
#[test]
fn parts_without_a_photo_of_their_own_are_not_told() {
    let stage = Stage::new();
    stage.gives(0, 0..9);
    stage.gives(1, 2..6);
    stage.gives(2, 7..12);
    let (_, said) = works(stage.pose(&[]));
    assert!(said.contains("9 of 12 photos have poses; 3 form a separate part"), "{said}");
    assert_eq!(said.matches("separate part").count(), 1, "{said}");
}

#[test]
fn either_spelling_of_colmaps_options_is_spoken() {
    for (help, extraction, matching) in [
        (OLD.to_owned(), "--SiftExtraction.use_gpu 0", "--SiftMatching.use_gpu 0"),
        (OLD.replace("Sift", "Feature"), "--FeatureExtraction.use_gpu 0", "--FeatureMatching.use_gpu 0"),
    ] {
        let stage = Stage::new();
        stage.gives(0, 0..12);
        fs::write(stage.path("fake/help"), help).unwrap();
        let (_, said) = works(stage.pose(&[]));
        assert!(said.contains("12 of 12 photos have poses"), "{said}");
        // The first photo brings the camera that the others share.
        let features = stage.calls("feature_extractor");
        assert_eq!(features.len(), 2, "{features:?}");
        assert!(features.iter().all(|call| call.contains(extraction) && call.contains("camera_model SIMPLE_RADIAL")));
        assert!(
            features[0].contains("single_camera 1") && features[1].contains("existing_camera_id 1"),
            "{features:?}"
        );
        assert!(stage.calls("exhaustive_matcher")[0].contains(matching));
        assert!(!stage.calls("mapper")[0].contains("min_model_size"), "an option that it does not know");
        assert_eq!(fs::read_dir(stage.path("scene/images")).unwrap().count(), 12);
    }
}

#[test]
fn what_is_there_is_not_estimated_again() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    works(stage.pose(&[]));
    let (before, poses) = (stage.calls("").len(), content(&stage.path("scene/sparse")));
    let (_, said) = works(stage.pose(&[]));
    assert!(said.contains("12 of 12"), "{said}");
    assert_eq!((stage.calls("").len(), content(&stage.path("scene/sparse"))), (before, poses));

    // Other pairs are compared.
    works(stage.pose(&["--matching", "sequential"]));
    assert_eq!(stage.calls("sequential_matcher").len(), 1);
    assert!(stage.calls("sequential_matcher")[0].contains("--SequentialMatching.overlap 10"));
    // Another photo: all begins anew, and the photos are those that there are now.
    fs::remove_file(stage.path("photos/00.png")).unwrap();
    stage.gives(0, 1..12);
    let (_, said) = works(stage.pose(&[]));
    assert!(said.contains("11 of 11"), "{said}");
    assert_eq!(fs::read_dir(stage.path("scene/images")).unwrap().count(), 11);
    assert_eq!(fs::read_dir(stage.path("photos")).unwrap().count(), 11, "the user's own photos stay");
}

#[test]
fn photos_of_nearly_one_size_share_a_camera() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    // 240 and 241 pixels are one camera's photos, 200 another's.
    for (i, name) in names(0..12).into_iter().enumerate() {
        image::RgbImage::new([240, 241, 200][i % 3], 100).save(stage.path("photos").join(name)).unwrap();
    }
    works(stage.pose(&[]));
    let features = stage.calls("feature_extractor");
    assert_eq!(features.len(), 4, "{features:?}");
    let listed = fs::read_to_string(stage.path("scene/pose/photos.txt")).unwrap();
    assert_eq!(listed.lines().collect::<Vec<_>>(), ["05.png", "08.png", "11.png"]);
    assert!(features[3].contains("existing_camera_id 2"), "{features:?}");
}

#[test]
fn doubtful_paths_of_the_camera_are_told() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let lines = |place: &dyn Fn(f64) -> [f64; 3]| {
        let line = |(i, name): (usize, &String)| {
            let [x, y, z] = place(i as f64);
            format!("{i} 1 0 0 0 {x} {y} {z} 1 {name}\n\n")
        };
        let text: String = (1..).zip(&names(0..12)).map(line).collect();
        fs::write(stage.path("fake/models/0/images.txt"), text).unwrap();
        let _ = fs::remove_dir_all(stage.path("scene"));
        works(stage.pose(&[])).0.said
    };
    let told = ["hardly moved", "one straight line", "in one plane"];
    let round = |i: f64, height: f64| [i.sin(), height, 4.0 + i.cos()];
    for (said, wanted) in [
        (lines(&|i| [0.001 * i.sin(), 0.001 * i.cos(), 4.0]), Some(0)),
        (lines(&|i| [0.2 * i, 0.1 * i, 4.0]), Some(1)),
        (lines(&|i| round(i, 0.0)), Some(2)),
        (lines(&|i| round(i, 0.2 * (3.0 * i).sin())), None),
    ] {
        for (n, word) in told.iter().enumerate() {
            assert_eq!(said.contains(word), wanted == Some(n), "{word}: {said}");
        }
    }
}

#[test]
fn a_colmap_that_dies_is_named_with_its_last_words_and_its_log() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let mut command = stage.pose(&[]);
    let ended =
        end(command.env("FAKE_AT", "mapper")).with(3, &["colmap failed", "exit status: 7", "scene/pose/log.txt"]);
    assert!(ended.said.contains("no memory is left") && ended.said.lines().count() == 1, "{}", ended.said);
    assert!(fs::read_to_string(stage.path("scene/pose/log.txt")).unwrap().contains("no memory is left"));
    // The next one goes on where this one died.
    let (features, matches) = (stage.calls("feature_extractor").len(), stage.calls("exhaustive_matcher").len());
    works(stage.pose(&[]));
    assert_eq!(stage.calls("feature_extractor").len(), features);
    assert_eq!(stage.calls("exhaustive_matcher").len(), matches);
}

#[test]
fn a_colmap_that_ignores_ctrl_c_is_ended() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let mut command = stage.pose(&[]);
    let mut running = start(command.env("FAKE_AT", "exhaustive_matcher").env("FAKE_DOES", "hang"));
    let pid = stage.path("fake/pid");
    assert!(running.until(|| fs::read_to_string(&pid).is_ok_and(|text| text.ends_with('\n'))));
    running.signal("INT").with(130, &["interrupted"]);
    let pid = fs::read_to_string(pid).unwrap();
    let alive = Command::new("kill").args(["-0", pid.trim()]).output().unwrap();
    assert!(!alive.status.success(), "colmap still runs");
    let features = stage.calls("feature_extractor").len();
    works(stage.pose(&[]));
    assert_eq!(stage.calls("feature_extractor").len(), features, "its features were kept");
}

#[test]
fn of_two_parts_the_larger_is_taken_and_both_are_told() {
    let stage = Stage::new();
    stage.gives(0, 0..4);
    stage.gives(1, 4..11);
    let (ended, said) = works(stage.pose(&[]));
    for words in ["7 of 12 photos have poses", "4 form a separate part", "1 is in no part: 11.png"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let (_, json) = works(stage.pose(&["--json"]));
    let json = serde_json::from_str(&json).unwrap();
    documented("pose", &json);
    assert_eq!((&json["others"][0][1], &json["nowhere"]["count"]), (&4.into(), &1.into()));
    // 7 of 12 are less than 80 %.
    assert!(ended.said.contains("warning:") && ended.said.contains("many photos have no pose"), "{}", ended.said);
    let (_, told) = works(stage.program(&["inspect", "scene"]));
    assert!(told.lines().any(|l| l.starts_with("views ") && l.ends_with(" 7")), "{told}");
    let (_, told) = works(stage.program(&["inspect", "scene/pose/models/0"]));
    assert!(told.lines().any(|l| l.starts_with("photos present") && l.ends_with(" 4")), "the other part: {told}");
}

#[test]
fn openmvgs_poses_are_taken_likewise() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    let (_, said) = works(stage.pose(&["--poses", "openmvg"]));
    assert!(said.contains("12 of 12 photos have poses"), "{said}");
    works(stage.program(&["inspect", "scene"]));
    assert!(stage.calls("").is_empty());
}

#[test]
fn photos_that_show_nothing_in_common_are_told_in_one_line() {
    let stage = Stage::new();
    let ended = end(&mut stage.pose(&[])).with(3, &["0 of 12 photos", "sharp"]);
    assert_eq!(ended.said.lines().count(), 1, "{}", ended.said);
    stage.gives(0, 0..2); // too few at all, and less than a fifth
    end(&mut stage.pose(&[])).with(3, &["2 of 12 photos"]);
    assert!(!stage.path("scene/sparse").exists());
}

#[test]
fn what_cannot_be_posed_is_refused_and_changes_nothing() {
    let stage = Stage::new();
    let without = |arguments: &[&str]| {
        let mut command = stage.program(arguments);
        command.env("PATH", stage.path("fake"));
        end(&mut command)
    };
    without(&["pose", "photos", "-o", "scene"]).with(2, &["colmap and openmvg-sfm are", "apt-get install colmap"]);
    without(&["pose", "photos", "-o", "scene", "--poses", "openmvg"]).with(2, &["cargo install openmvg-cli"]);
    assert!(!stage.path("scene").exists());
    fs::write(stage.path("walk.mp4"), "no video").unwrap();
    let mut command = stage.program(&["pose", "walk.mp4", "-o", "scene"]);
    end(command.env("PATH", stage.path("bin"))).with(2, &["ffmpeg", "apt-get install ffmpeg"]);
    let pose = |input: &str, output: &str| end(&mut stage.program(&["pose", input, "-o", output]));
    pose("fake", "other").with(3, &["holds no photos"]);
    pose("absent", "other").with(3, &["absent"]);
    let before = content(&stage.path("photos"));
    pose("photos", "photos").with(2, &["is not an output folder", "-o"]);
    assert_eq!(content(&stage.path("photos")), before);
    // A record that names files elsewhere is not this program's, and removes none.
    fs::create_dir(stage.path("trap")).unwrap();
    let record = r#"{"made_by":"qirf-vk pose","key":{"files":[],"frames":null},"backend":"auto","matching":"auto",
        "photos":["../../walk.mp4"],"features":0,"matched":null,"posed":null}"#;
    fs::write(stage.path("trap/pose.json"), record).unwrap();
    pose("photos", "trap").with(2, &["is not an output folder"]);
    assert!(stage.path("walk.mp4").is_file());
    // Folders of photos are told the command.
    end(&mut stage.program(&["inspect", "photos"])).with(3, &["qirf-vk pose photos -o SCENE"]);
}

#[test]
fn poses_that_are_there_already_are_told() {
    let stage = Stage::new();
    stage.gives(0, 0..12);
    copy(&stage.path("fake/models/0"), &stage.path("photos/sparse/0"));
    let told = "photos has poses already: `qirf-vk run photos -o DIR` uses them";
    end(&mut stage.pose(&[])).with(0, &[told]);
    fs::remove_dir_all(stage.path("photos/sparse")).unwrap();
    assert!(!works(stage.pose(&[])).0.said.contains("poses already"));
}

#[test]
fn one_command_leads_from_photos_to_a_model() {
    let stage = Stage::new();
    let photos = scene().join("images");
    let known = stage.path("fake/models/0");
    fs::create_dir_all(&known).unwrap();
    for entry in fs::read_dir(scene().join("sparse/0")).unwrap().flatten() {
        fs::copy(entry.path(), known.join(entry.file_name())).unwrap();
    }
    let photos = photos.to_str().unwrap();
    let run = ["run", photos, "-o", "out", "--iterations", "20", "--no-prune"];
    let ended = end(&mut stage.program(&run)).with(0, &["9 of 9 photos have poses"]);
    assert!(stage.path("out/model.ply").is_file() && stage.path("out/report.html").is_file(), "{}", ended.said);
    let config = fs::read_to_string(stage.path("out/config.toml")).unwrap();
    assert!(config.contains("scene = \"scene\""), "{config}");
    // The poses are those that were given, and are used again.
    let calls = stage.calls("").len();
    let bytes = fs::read(stage.path("out/model.ply")).unwrap();
    end(&mut stage.program(&[&run[..], &["--overwrite"]].concat())).with(0, &[]);
    assert_eq!((stage.calls("").len(), fs::read(stage.path("out/model.ply")).unwrap()), (calls, bytes.clone()));
    let direct = ["run", scene().to_str().unwrap(), "-o", "direct", "--iterations", "20", "--no-prune"];
    end(&mut stage.program(&direct)).with(0, &[]);
    assert!(fs::read(stage.path("direct/model.ply")).unwrap() == bytes, "the same scene with known poses");
}
