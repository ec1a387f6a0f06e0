//! Damaged files: every reader returns a scene or an error for truncated files and flipped bits, and never panics.

use std::fs;
use std::path::Path;

use proptest::prelude::*;

use crate::support::files::reading;
use crate::support::files::writers::{Model, picture, row, transforms, write, written};

/// Cuts a file and flips bits of what is left.
fn damage(path: &Path, keep: f64, flips: &[(f64, u8)]) {
    let mut bytes = fs::read(path).unwrap();
    bytes.truncate((bytes.len() as f64 * keep).ceil() as usize);
    for (at, bit) in flips {
        let at = (bytes.len() as f64 * at) as usize;
        if let Some(byte) = bytes.get_mut(at) {
            *byte ^= 1 << bit;
        }
    }
    fs::write(path, bytes).unwrap();
}

const PLY: &str = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                   property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";

fn cuts() -> impl Strategy<Value = (f64, Vec<(f64, u8)>)> {
    let keep = prop_oneof![Just(1.0), 0.0..1.0];
    (keep, prop::collection::vec((0.0..1.0, 0..8_u8), 0..6))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn colmap_binary((keep, flips) in cuts(), file in 0..3_usize) {
        let files = Model::sample().binary();
        let name = files[file].0;
        let folder = written(files);
        damage(&folder.path().join(name), keep, &flips);
        reading::scene(folder.path());
    }

    #[test]
    fn colmap_text((keep, flips) in cuts(), file in 0..3_usize) {
        let files = Model::sample().text();
        let name = files[file].0;
        let folder = written(files);
        damage(&folder.path().join(name), keep, &flips);
        reading::scene(folder.path());
    }

    #[test]
    fn transforms_json((keep, flips) in cuts()) {
        let top = r#""fl_x": 50.5, "k1": 0.01, "w": 64, "h": 48, "camera_model": "OPENCV", "test_filenames": ["a.png"]"#;
        let folder = written([("transforms.json", transforms(top, &["a.png", "b.png", "c.png"]))]);
        damage(&folder.path().join("transforms.json"), keep, &flips);
        reading::scene(folder.path());
    }

    #[test]
    fn point_cloud((keep, flips) in cuts(), ascii in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let top = r#""fl_x": 50.5, "w": 64, "h": 48, "ply_file_path": "points.ply""#;
        let ply = if ascii {
            format!("{}1 2 3 4 5 6\n1 2 3 4 5 6\n-1e3 2 3 4 5 6\n", PLY.replace("binary_little_endian", "ascii"))
        } else {
            format!("{PLY}{}", "0123456789abcde".repeat(3))
        };
        write(folder.path(), [("transforms.json", transforms(top, &["a.png"])), ("points.ply", ply.into_bytes())]);
        damage(&folder.path().join("points.ply"), keep, &flips);
        reading::scene(folder.path());
    }

    #[test]
    fn photos((keep, flips) in cuts(), kind in 0..3_usize) {
        let name = ["a.jpg", "a.png", "a.webp"][kind];
        let folder = written(row(&[name]).binary());
        let path = folder.path().join("images").join(name);
        picture(&path, 64, 48);
        damage(&path, keep, &flips);
        reading::scene(folder.path());
    }
}
