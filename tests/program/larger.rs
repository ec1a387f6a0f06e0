//! Models larger than the device: every command that reads one does its work in parts, and writes the same bytes.

use super::ended::{self, Ended, end};
use crate::support::Random;
use qirf_vk::gaussians::{Gaussians, formats};
use std::fs;
use std::path::{Path, PathBuf};

/// Bytes of the largest buffer: 2,700 of the 4,000 Gaussians have room for their colours.
const BUFFERS: &str = "buffers=100000";

/// A ball of small Gaussians with colours that depend on the direction.
pub(super) fn ball(folder: &Path) -> PathBuf {
    let mut random = Random(11);
    let mut model = Gaussians::zeroed(4000, 1);
    for i in 0..model.len() {
        let place = [0; 3].map(|_| random.within(-1.0, 1.0));
        let length = place.iter().map(|x| x * x).sum::<f64>().sqrt();
        model.means[i] = place.map(|x| (x / length) as f32);
        model.log_scales[i] = [random.within(0.02, 0.06).ln() as f32; 3];
        model.rotations[i] = [1.0, 0.0, 0.0, 0.0];
        model.opacity_logits[i] = random.within(-1.0, 3.0) as f32;
    }
    for value in model.sh.iter_mut().flatten() {
        *value = random.within(-0.6, 0.6) as f32;
    }
    let path = folder.join("ball.ply");
    formats::write(&path, &model, formats::RenderMode::Plain).expect("a model file");
    path
}

/// Runs the program on a device with large buffers, or with small ones.
fn qirf(folder: &Path, small: bool, arguments: &[&str]) -> Ended {
    end(ended::qirf(arguments).current_dir(folder).envs(small.then_some(("QIRF_LIMITS", BUFFERS))))
}

/// It must have ended well, and told of parts just where it drew them.
fn told(ended: Ended, parts: bool) -> Ended {
    assert_eq!(ended.said.contains("cannot hold 4000 Gaussians at once"), parts, "{}", ended.said);
    ended.with(0, &[])
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let read = |entry: fs::DirEntry| (entry.file_name().display().to_string(), fs::read(entry.path()).unwrap());
    let mut all: Vec<_> = fs::read_dir(folder).unwrap().flatten().map(read).collect();
    all.sort();
    all
}

#[test]
fn larger_models_are_compressed_rendered_and_scored_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    ball(root);
    let mut scores = Vec::new();
    for (small, out) in [(false, "whole"), (true, "parts")] {
        let model = format!("{out}.ply");
        let compress = ["compress", "ball.ply", "-o", &model, "--views", "20", "--size", "72x56", "--json"];
        told(qirf(root, small, &compress), small);
        let render = ["render", "ball.ply", "--orbit", "3", "--size", "80x60", "--format", "npy", "-o", out];
        told(qirf(root, small, &render), small);
        // The device holds the compressed model, and not the original.
        let eval = qirf(root, small, &["eval", "whole.ply", "--against", "ball.ply", "--json"]);
        scores.push(told(eval, small).json()["test"].clone());
    }
    assert!(fs::read(root.join("whole.ply")).unwrap() == fs::read(root.join("parts.ply")).unwrap());
    assert_eq!(files(&root.join("whole")), files(&root.join("parts")));
    assert!(scores[0]["psnr"].as_f64().is_some_and(|psnr| psnr > 20.0), "{scores:?}");
    assert_eq!(scores[0], scores[1]);
}

/// A tight budget changes no byte: the work is done in parts, or refused.
#[test]
fn budgets_of_memory_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    ball(root);
    let compress = |out: &str, more: &[&str]| {
        let options = ["compress", "ball.ply", "-o", out, "--views", "12", "--size", "72x56"];
        qirf(root, false, &[&options[..], more].concat())
    };
    told(compress("whole.ply", &[]), false);
    let right = fs::read(root.join("whole.ply")).unwrap();
    let mut in_parts = 0;
    for budget in ["4M", "3M", "2M", "1500k"] {
        let Ended { code, said, .. } = compress("tight.ply", &["--memory-budget", budget]);
        match code {
            Some(0) => {
                assert!(fs::read(root.join("tight.ply")).unwrap() == right, "{budget}");
                in_parts += u32::from(said.contains("drawn in parts"));
            }
            Some(5) => assert!(said.contains("bytes") && !root.join("tight.ply").exists(), "{budget}: {said}"),
            _ => panic!("{budget}: {said}"),
        }
        println!("{budget}: {code:?}");
        let _ = fs::remove_file(root.join("tight.ply"));
    }
    assert!(in_parts > 0);
}

/// What must be on the device at once is refused with a way out: gradients of pictures that show the whole model.
#[test]
fn what_must_be_on_the_device_at_once_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    ball(root);
    qirf(root, true, &["compress", "ball.ply", "-o", "css.ply", "--selector", "css", "--views", "8"])
        .with(5, &["binds at most 100000", "--selector pairs"]);
    assert!(!root.join("css.ply").exists());
}
