//! Other people's readers and writers, if `tools/readers` has fetched them.

use std::path::{Path, PathBuf};
use std::process::Command;

use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, RenderMode};
use serde_json::Value;
use tempfile::TempDir;

use super::writers::{angle, matched};
use crate::support::files::make;
use crate::support::{skip, source};

/// A file of the fetched readers; `None` if it is missing, and the test is skipped.
fn reader(file: &str) -> Option<PathBuf> {
    let path = source("target/readers").join(file);
    if path.exists() {
        return Some(path);
    }
    skip("no readers of other people (tools/readers)");
    None
}

/// The output of a program, which must succeed.
fn printed(command: &mut Command) -> String {
    let output = command.output().expect("the program starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}{said}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8(output.stdout).unwrap()
}

/// A folder with a model whose values every format can hold.
fn folder(n: usize, degree: usize, name: &str) -> (TempDir, PathBuf, Gaussians) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let mut model = make::model(n, degree);
    model.sh.iter_mut().skip(1).flatten().for_each(|c| *c *= 0.5);
    formats::write(&path, &model, RenderMode::Plain).unwrap();
    (folder, path, model)
}

const VALIDATE: &str = "const { readFileSync } = require('fs'); require(process.argv[1]).validateBytes(new Uint8Array(readFileSync(process.argv[2])))\
    .then((report) => console.log(JSON.stringify(report.issues)))";

#[test]
fn khronos_validator_finds_nothing_wrong_with_our_gltf() {
    let Some(validator) = reader("node_modules/gltf-validator") else { return };
    for (degree, name) in [(0, "m.glb"), (3, "m.glb"), (3, "m.gltf")] {
        let (_folder, path, _) = folder(50, degree, name);
        let issues: Value =
            serde_json::from_str(&printed(Command::new("node").args(["-e", VALIDATE]).arg(&validator).arg(&path)))
                .unwrap();
        // This version does not know extensions' attributes; it checks everything that they share with others.
        let known = |m: &&Value| {
            let ours = m["pointer"].as_str().is_some_and(|p| p.contains("/attributes/KHR_gaussian_splatting:"));
            m["code"] == "UNSUPPORTED_EXTENSION" || m["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" && ours
        };
        let other: Vec<_> = issues["messages"].as_array().unwrap().iter().filter(|m| !known(m)).collect();
        assert!(other.is_empty() && issues["numWarnings"] == 0, "{issues:#}");
    }
}

const OPEN: &str = "
import json, sys
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetDefaultPrim()
def plain(value):
    if hasattr(value, 'GetReal'): return [value.GetReal(), *value.GetImaginary()]
    return [plain(v) for v in value] if hasattr(value, '__len__') else value
names = ['positions', 'orientations', 'scales', 'opacities', 'radiance:sphericalHarmonicsCoefficients', 'radiance:sphericalHarmonicsDegree']
print(json.dumps({'type': prim.GetTypeName(), **{n: plain(prim.GetAttribute(n).Get()) for n in names}}))
";

#[test]
fn openusd_finds_our_values() {
    let Some(python) = reader("usd/bin/python") else { return };
    for name in ["m.usda", "m.usdz"] {
        let (_folder, path, model) = folder(40, 2, name);
        let stage: Value = serde_json::from_str(&printed(Command::new(&python).args(["-c", OPEN]).arg(&path))).unwrap();
        assert_eq!(
            (&stage["type"], &stage["radiance:sphericalHarmonicsDegree"]),
            (&"ParticleField3DGaussianSplat".into(), &2.into())
        );
        let rows = |key: &str| -> Vec<Vec<f64>> { serde_json::from_value(stage[key].clone()).unwrap() };
        let (positions, orientations, scales) = (rows("positions"), rows("orientations"), rows("scales"));
        let sh = rows("radiance:sphericalHarmonicsCoefficients");
        assert_eq!((positions.len(), orientations.len(), scales.len(), sh.len()), (40, 40, 40, 40 * 9));
        for i in 0..40 {
            // Right-up-back: y and z are negated.
            let [x, y, z] = model.means[i];
            assert_eq!(positions[i], [x, -y, -z].map(f64::from));
            assert!((scales[i][1].ln() - f64::from(model.log_scales[i][1])).abs() < 1e-6);
            let [w, x, y, z] = model.rotations[i];
            let q = [0, 1, 2, 3].map(|k: usize| orientations[i][k] as f32);
            assert!(angle(q, [w, x, -y, -z]) < 1e-6);
            // Band 2, m = 0 keeps its sign.
            assert_eq!(sh[9 * i + 6][1], f64::from(model.sh[2][15 * i + 7]));
        }
    }
}

/// Asserts that two models are equal up to rounding and, if `flipped`, up to half a turn about x.
fn assert_same(a: &Gaussians, b: &Gaussians, flipped: bool, steps: f32, what: &str) {
    assert_eq!((a.len(), a.degree()), (b.len(), b.degree()), "{what}");
    let sign = if flipped { -1.0 } else { 1.0 };
    let mut b = b.clone();
    b.means.iter_mut().for_each(|m| *m = [m[0], sign * m[1], sign * m[2]]);
    b.rotations.iter_mut().for_each(|q| *q = [q[0], q[1], sign * q[2], sign * q[3]]);
    let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
    for (i, j) in matched(a, &b) {
        for k in 0..3 {
            assert!((a.means[i][k] - b.means[j][k]).abs() <= 1e-5 + steps, "{what}: mean {i}");
            assert!((a.log_scales[i][k] - b.log_scales[j][k]).abs() <= 1e-5 + 10.0 * steps, "{what}: scale {i}");
            assert!((a.sh[0][3 * i + k] - b.sh[0][3 * j + k]).abs() <= 1e-5 + 5.0 * steps, "{what}: colour {i}");
        }
        assert!(
            (sigmoid(a.opacity_logits[i]) - sigmoid(b.opacity_logits[j])).abs() <= 1e-5 + steps,
            "{what}: opacity {i}"
        );
        // An ellipsoid is unchanged by half a turn about one of its own axes.
        let [w, x, y, z] = b.rotations[j];
        let alike = [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]];
        let turned = alike.map(|q| angle(a.rotations[i], q)).into_iter().fold(f64::INFINITY, f64::min);
        assert!(turned <= 1e-4 + f64::from(3.0 * steps), "{what}: rotation {i}: {turned}");
        for l in 1..=a.degree() {
            let width = Gaussians::band_width(l);
            for k in 0..width {
                let (x, y) = (a.sh[l][i * width + k], b.sh[l][j * width + k]);
                let (x, y) = if flipped { (x.abs(), y.abs()) } else { (x, y) };
                assert!((x - y).abs() <= 1e-5 + 30.0 * steps, "{what}: band {l} of {i}: {x} {y}");
            }
        }
    }
}

fn splat_transform(program: &Path, from: &Path, to: &Path) {
    // A GPU would only be used for SOG; there, one iteration of its palettes is enough to be read.
    let mut command = Command::new("node");
    command.arg(program).arg("-w");
    if to.extension().is_some_and(|e| e == "sog" || e == "json") {
        command.args(["-g", "cpu", "-i", "1"]);
    }
    printed(command.args([from, to]));
}

#[test]
fn splat_transform_reads_our_files_as_we_do() {
    let Some(program) = reader("node_modules/@playcanvas/splat-transform/bin/cli.mjs") else { return };
    for name in ["m.spz", "m.sog", "m.compressed.ply"] {
        let (folder, path, _) = folder(300, 2, name);
        let copy = folder.path().join("copy.ply");
        splat_transform(&program, &path, &copy);
        let (ours, theirs) = (formats::read(&path).unwrap().gaussians, formats::read(&copy).unwrap().gaussians);
        // It writes the axes of an SPZ into a PLY unchanged; the official library turns them, as we do.
        assert_same(&ours, &theirs, name == "m.spz", 0.0, name);
    }
}

#[test]
fn we_read_what_splat_transform_writes() {
    let Some(program) = reader("node_modules/@playcanvas/splat-transform/bin/cli.mjs") else { return };
    let (folder, path, model) = folder(300, 2, "m.ply");
    for (name, steps) in [("o.glb", 0.0), ("o.spz", 0.01), ("o.compressed.ply", 0.01)] {
        let out = folder.path().join(name);
        splat_transform(&program, &path, &out);
        let read = formats::read(&out).unwrap();
        assert!(!read.repairs.any() && read.doubt.is_none());
        assert_same(&model, &read.gaussians, name == "o.spz", steps, name);
    }
    // Its SOG has codebooks of scales and colours, and a palette of higher bands: the degree, and where Gaussians are.
    for name in ["o.sog", "sog/meta.json", "levels/lod-meta.json"] {
        let out = folder.path().join(name);
        std::fs::create_dir_all(out.parent().unwrap()).unwrap();
        splat_transform(&program, &path, &out);
        let read = formats::read(&out).unwrap();
        assert!(!read.repairs.any() && read.doubt.is_none(), "{name}");
        let read = read.gaussians;
        assert_eq!((read.len(), read.degree()), (300, 2), "{name}");
        for (i, j) in matched(&model, &read) {
            for k in 0..3 {
                assert!((model.means[i][k] - read.means[j][k]).abs() < 1e-3, "{name}: mean {i}");
                assert!((model.log_scales[i][k] - read.log_scales[j][k]).abs() < 0.1, "{name}: scale {i}");
                assert!((model.sh[0][3 * i + k] - read.sh[0][3 * j + k]).abs() < 0.1, "{name}: colour {i}");
            }
        }
    }
}

#[test]
fn splat_transform_reads_each_level_of_our_streamed_sog() {
    let Some(program) = reader("node_modules/.bin/splat-transform") else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    let mut model = make::model(9000, 1);
    model.means.iter_mut().for_each(|m| m[1] *= 6.0);
    let levels =
        [model.clone(), model.select(&(0..3000).collect::<Vec<_>>()), model.select(&(0..1000).collect::<Vec<_>>())];
    formats::write_levels(&path, &levels, (RenderMode::Plain, [0.0; 3])).unwrap();
    for (number, level) in levels.iter().enumerate() {
        let out = folder.path().join(format!("{number}.ply"));
        printed(Command::new(&program).args(["-q", "-w", "-L", &number.to_string()]).arg(&path).arg(&out));
        assert_eq!(formats::read(&out).unwrap().gaussians.len(), level.len(), "level {number}");
    }
}
