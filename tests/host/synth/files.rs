//! Files: their bytes, refusals, and other files in the folder.

use super::terrain::strip;
use super::{make, options};
use crate::support::content;
use qirf_vk::synth::{self, Effect, Error, SynthOptions};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// All files below a folder with their bytes.
fn bytes(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let name = |path: &Path| path.strip_prefix(dir).unwrap().display().to_string();
    content(dir).into_iter().map(|(path, bytes)| (name(&path), bytes)).collect()
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_others_for_another_seed() {
    let o = options(6, &[Effect::Masks, Effect::Exposure, Effect::Distortion]);
    let on = |threads: usize, o: &SynthOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bytes(make(o).0.path()))
    };
    let one = on(1, &o);
    assert_eq!(one.len(), 6 + 6 + 3 + 1);
    assert!(one == on(2, &o) && on(1, &strip(6)) == on(2, &strip(6)), "two threads changed the files");
    let other = on(2, &SynthOptions { seed: 2, ..o });
    assert_ne!(one["images/view_0000.png"], other["images/view_0000.png"]);
}

#[test]
fn what_others_keep_in_a_folder_stays() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("thesis.tex"), "ten years").unwrap();
    let small = SynthOptions { width: 16, height: 16, ..options(3, &[]) };
    let refused = synth::write(dir.path(), &small, &|_| ());
    assert!(matches!(refused, Err(Error::Foreign(_))), "{refused:?}");
    fs::write(dir.path().join("synth.json"), r#"{"made_by": "a synthesizer", "options": {"views": 3}}"#).unwrap();
    assert!(matches!(synth::write(dir.path(), &small, &|_| ()), Err(Error::Foreign(_))));
    assert_eq!(bytes(dir.path()).len(), 2);
    let file = dir.path().join("thesis.tex");
    assert!(matches!(synth::write(&file, &small, &|_| ()), Err(Error::NotFolder(_))));

    // An existing synthetic scene is replaced; the user's own files in it are left alone, even if named like a photo.
    let (scene, _) = make(&options(5, &[Effect::Masks]));
    for added in ["model.ply", "images/view_0099.png", "images/mine.png"] {
        fs::write(scene.path().join(added), "mine").unwrap();
    }
    synth::write(scene.path(), &small, &|_| ()).unwrap();
    let after = bytes(scene.path());
    assert_eq!(after["model.ply"], b"mine");
    assert_eq!(after["images/mine.png"], b"mine");
    assert_eq!(after["images/view_0099.png"], b"mine");
    assert!(!after.contains_key("images/view_0004.png") && !scene.path().join("masks").exists());
    assert_eq!(after.len(), 3 + 3 + 3 + 1);
}

#[test]
fn numbers_out_of_range_and_impossible_effects_are_refused_before_anything_is_written() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("scene");
    let base = options(3, &[]);
    let bad = [
        SynthOptions { width: 15, ..base.clone() },
        SynthOptions { height: 1, ..base.clone() },
        SynthOptions { width: 8193, ..base.clone() },
        SynthOptions { views: 0, ..base.clone() },
        SynthOptions { views: 10_000, ..base.clone() },
        SynthOptions { points: usize::MAX, ..base.clone() },
        SynthOptions { effects: vec![Effect::Matte, Effect::Glossy], ..base.clone() },
        SynthOptions { effects: vec![Effect::Fisheye, Effect::Distortion], ..base },
    ];
    for o in bad {
        let error = synth::write(&dir, &o, &|_| ()).unwrap_err();
        assert!(matches!(error, Error::Range { .. } | Error::Conflict(..)), "{error}");
        assert!(!dir.exists());
    }
}

#[test]
fn the_smallest_scene_is_written_and_progress_counts_photos() {
    let last = AtomicU64::new(0);
    let dir = tempfile::tempdir().unwrap();
    let o = SynthOptions { views: 1, width: 16, height: 16, points: 50, ..SynthOptions::default() };
    let report = synth::write(&dir.path().join("a/b"), &o, &|n| {
        last.fetch_max(n, Ordering::Relaxed);
    });
    let report = report.unwrap();
    assert_eq!((report.photos, report.test_photos, report.points), (1, 1, 50));
    assert_eq!(last.into_inner(), 1);
}
