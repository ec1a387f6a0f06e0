//! One good file of every input format, and which reader it is for (`reading.rs`).

use super::gltf::{self, Layout};
use super::make::{self, Encoding};
use super::mutate::{Rng, mutate};
use super::writers::{Model, picture, row, transforms};
use image::ImageEncoder;
use qirf_vk::gaussians::Attributes;
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::mean::Mean;
use qirf_vk::train::poses::STORED;
use qirf_vk::train::state::TrainState;
use std::fs;

/// Reader of a damaged file.
#[derive(Clone, Copy, Debug)]
pub enum Reader {
    /// A model from bytes; the name's extension counts.
    Model,
    /// The plain bytes of an SPZ file, which are gzipped after the damage.
    Gzipped,
    /// A file of the SOG folder.
    SogPart,
    /// A `.gltf` or its buffer, in one folder.
    GltfPart,
    /// A file of a scene's folder.
    Scene,
    /// The same for a PNG whose checksums are corrected after the damage.
    ScenePng,
    /// The georeference.json beside `model.ply`.
    Georeference,
    /// The rigs of photos.
    Rigs,
    /// A depth map.
    Depth,
    /// The cameras of a path.
    Path,
    /// The matrix of an edit.
    Matrix,
    Config,
    Checkpoint,
}

/// A file to damage, and the folder of good files around it.
pub struct Input {
    /// Its name in reports.
    pub name: String,
    pub reader: Reader,
    /// Relative path of the damaged file.
    pub file: String,
    pub bytes: Vec<u8>,
    /// The good files beside it.
    pub beside: Vec<(String, Vec<u8>)>,
}

/// Every format and variant that matters to the readers.
pub fn inputs() -> Vec<Input> {
    let mut all = models();
    all.extend(parts());
    all.extend(colmap());
    all.extend(json());
    all.extend(photos());
    all.extend(depth_maps());
    all.push(lone("keys.json", Reader::Path, KEYS.into()));
    all.push(lone("camera_path.json", Reader::Path, CAMERA_PATH.into()));
    all.push(lone("matrix.txt", Reader::Matrix, b"0 -2 0 1.5\n2 0 0 -3e1\n0 0 2 0.25\n0 0 0 1\n".to_vec()));
    all.push(lone("config.toml", Reader::Config, config()));
    all.push(lone("checkpoint.safetensors", Reader::Checkpoint, checkpoint()));
    all
}

/// The bytes of an input with the damage of this case, which may mix in bytes of another input.
pub fn damaged(case: u64, input: &Input, inputs: &[Input]) -> Vec<u8> {
    let mut rng = Rng::new(case);
    let other = &inputs[rng.below(inputs.len())];
    mutate(&mut rng, &input.bytes, &other.bytes)
}

fn lone(file: &str, reader: Reader, bytes: Vec<u8>) -> Input {
    Input { name: file.into(), reader, file: file.into(), bytes, beside: Vec::new() }
}

/// Models in one file each.
pub fn models() -> Vec<Input> {
    let model = make::model(6, 2);
    let mut all = vec![
        ("little.ply", make::ply(&model, Encoding::Little, false)),
        ("big.ply", make::ply(&model, Encoding::Big, true)),
        ("ascii.ply", make::ply(&model, Encoding::Ascii, false)),
        ("compressed.ply", make::compressed_ply(6, 0x1234_5678, true)),
        ("a.splat", make::splat(&model)),
        ("one.sog", make::sog(50, 1)),
        ("two.sog", make::sog(50, 2)),
        ("gzip.spz", make::spz(6, 3, 3, true)),
        ("halves.ply", make::half_ply(6)),
        ("planar.glb", gltf::glb(&model, Layout::Planar)),
        ("interleaved.glb", gltf::glb(&model, Layout::Interleaved)),
        ("sparse.glb", gltf::glb(&model, Layout::Sparse)),
        ("quantised.glb", gltf::glb(&model, Layout::Quantised)),
        ("spz.glb", gltf::glb_of_spz(&make::spz(6, 2, 1, true), 6, false)),
        ("draft.glb", gltf::glb_of_spz(&make::spz(6, 3, 1, true), 6, true)),
        ("data.gltf", gltf::gltf(&model, Layout::Planar, None).0),
        ("a.usda", make::usda(4)),
        ("a.usdz", make::usdz(4)),
    ];
    all.extend(
        [(1, "1.spz"), (2, "2.spz"), (3, "3.spz"), (4, "4.spz")].map(|(v, name)| (name, make::spz(6, v, 2, false))),
    );
    all.extend([(0, "0.ksplat"), (1, "1.ksplat"), (2, "2.ksplat")].map(|(l, name)| (name, make::ksplat(6, l, 2))));
    all.into_iter().map(|(name, bytes)| lone(name, Reader::Model, bytes)).collect()
}

/// Models of several files, and inside others.
fn parts() -> Vec<Input> {
    let model = make::model(6, 2);
    let mut all = Vec::new();
    all.push(Input { name: "inside gzip.spz".into(), ..lone("gzip.spz", Reader::Gzipped, make::spz(6, 3, 2, false)) });
    let (json, binary) = gltf::gltf(&model, Layout::Planar, Some("m.bin"));
    let parts = [("m.gltf", json), ("m.bin", binary)];
    all.extend(["m.gltf", "m.bin"].map(|damaged| among("gltf", damaged, Reader::GltfPart, &parts)));
    for version in [1, 2] {
        let files = make::sog_files(50, version);
        for damaged in ["meta.json", "means_u.webp", "shN_centroids.webp"] {
            all.push(among(&format!("sog {version}"), damaged, Reader::SogPart, &files));
        }
    }
    let files = make::sog_files(50, 2).into_iter().map(|(name, bytes)| (format!("0_0/{name}"), bytes));
    let levels = [("lod-meta.json".to_owned(), make::LEVELS.into())];
    all.push(among("sog levels", "lod-meta.json", Reader::SogPart, &files.chain(levels).collect::<Vec<_>>()));
    let place = br#"{"schema": 1, "origin": [0, 0, 1], "models": {"model.ply": [500000.5, 4e6, 30]}}"#.to_vec();
    let files = [("georeference.json", place), ("model.ply", make::ply(&model, Encoding::Little, false))];
    all.push(among("origin", "georeference.json", Reader::Georeference, &files));
    all
}

/// The file called `damaged` of a folder of files.
fn among<N: AsRef<str>>(kind: &str, damaged: &str, reader: Reader, files: &[(N, Vec<u8>)]) -> Input {
    let is_it = |name: &N| name.as_ref() == damaged;
    let bytes = files.iter().find(|(name, _)| is_it(name)).expect("it is among them").1.clone();
    let beside = files.iter().filter(|(name, _)| !is_it(name)).map(|(n, b)| (n.as_ref().to_owned(), b.clone()));
    Input { name: format!("{kind}: {damaged}"), reader, file: damaged.into(), bytes, beside: beside.collect() }
}

const KEYS: &str = r#"{"keys": [{"eye": [0, 0.5, -4], "target": [0, 0, 0]},
    {"eye": [4, 0, 1e-3], "target": [0, 0, 0], "up": [0, -1, 0], "fov": 50.5}]}"#;
const CAMERA_PATH: &str = r#"{"camera_type": "perspective", "render_width": 320, "render_height": 200, "camera_path": [
    {"camera_to_world": [1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1], "fov": 40},
    {"camera_to_world": [[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, -3], [0, 0, 0, 1]]}]}"#;

fn colmap() -> Vec<Input> {
    let model = Model::sample();
    let (binary, text) = (model.binary(), model.text());
    let names = ["cameras", "images", "points3D"];
    let binary = names.map(|n| among("colmap", &format!("{n}.bin"), Reader::Scene, &binary));
    let text = names.map(|n| among("colmap", &format!("{n}.txt"), Reader::Scene, &text));
    binary.into_iter().chain(text).collect()
}

const CLOUD: &str = "property float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n\
                     property uchar blue\nend_header\n";

fn json() -> Vec<Input> {
    let ngp = r#""camera_angle_x": 0.7, "camera_angle_y": 0.6, "fl_x": 50.5, "fl_y": 50.1, "k1": 0.01, "k2": -0.02,
        "p1": 0.001, "p2": 0, "cx": 31.5, "cy": 24.2, "w": 64, "h": 48, "aabb_scale": 4, "scale": 0.33"#;
    let nerfstudio = r#""camera_model": "OPENCV_FISHEYE", "fl_x": 50.5, "w": 64, "h": 48, "k1": 0.01, "k4": 0.001,
        "ply_file_path": "points.ply", "train_filenames": ["a.png", "b.png"], "test_filenames": ["c.png"],
        "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]"#;
    let blender = r#""camera_angle_x": 0.69, "w": 64, "h": 48"#;
    let head = |format: &str| format!("ply\nformat {format} 1.0\nelement vertex 3\n{CLOUD}").into_bytes();
    let ascii = [head("ascii"), b"1 2 3 4 5 6\n1 2 3 4 5 6\n-1e3 2 3 4 5 6\n".to_vec()].concat();
    let binary = [head("binary_little_endian"), b"0123456789abcde".repeat(3)].concat();
    let names = ["a.png", "b.png", "c.png"];
    let rigs = br#"[{"cameras": [{"image_prefix": "left/", "ref_sensor": true}, {"image_prefix": "right/",
        "cam_from_rig_rotation": [1, 0, 0, 0.5], "cam_from_rig_translation": [0.1, 0, 0]}]}]"#;
    let panorama = r#""camera_model": "EQUIRECTANGULAR", "w": 64, "h": 32, "fl_x": 32.0"#;
    let panorama = [("transforms.json", transforms(panorama, &names[..1])), ("a.png", photo("a.png"))];
    let with = |cloud: &[u8]| vec![("transforms.json", transforms(nerfstudio, &names)), ("points.ply", cloud.to_vec())];
    vec![
        among(
            "blender",
            "transforms_train.json",
            Reader::Scene,
            &[
                ("transforms_train.json", transforms(blender, &["train/r_0", "train/r_1"])),
                ("transforms_test.json", transforms(blender, &["test/r_0"])),
            ],
        ),
        among("instant-ngp", "transforms.json", Reader::Scene, &[("transforms.json", transforms(ngp, &names))]),
        among("panorama", "transforms.json", Reader::Scene, &panorama),
        lone("rig_config.json", Reader::Rigs, rigs.to_vec()),
        among("nerfstudio", "transforms.json", Reader::Scene, &with(&ascii)),
        among("nerfstudio ascii", "points.ply", Reader::Scene, &with(&ascii)),
        among("nerfstudio binary", "points.ply", Reader::Scene, &with(&binary)),
    ]
}

/// A photo in the format of its name.
fn photo(name: &str) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    if path.extension().is_some_and(|e| e == "exr") {
        image::load_from_memory(&photo("a.png")).unwrap().into_rgb32f().save(&path).unwrap();
    } else {
        picture(&path, 64, 48);
    }
    fs::read(path).unwrap()
}

fn photos() -> Vec<Input> {
    let mut grey = Vec::new();
    let deep: Vec<u8> = (0..64 * 48 * 2).map(|i| (i % 251) as u8).collect();
    let encoder = image::codecs::png::PngEncoder::new(&mut grey);
    encoder.write_image(&deep, 64, 48, image::ExtendedColorType::La8).unwrap();
    let scene = |kind: &str, name: &str, reader: Reader, bytes: Vec<u8>| {
        let good = ("images/good.png".to_owned(), photo("good.png"));
        let mut files: Vec<(String, Vec<u8>)> =
            row(&[name, "good.png"]).binary().into_iter().map(|(n, b)| (n.to_owned(), b)).collect();
        files.extend([good, (format!("images/{name}"), bytes)]);
        among(kind, &format!("images/{name}"), reader, &files)
    };
    let mut all = vec![
        scene("photo", "a.jpg", Reader::Scene, photo("a.jpg")),
        scene("photo", "a.png", Reader::Scene, photo("a.png")),
        scene("photo", "a.webp", Reader::Scene, photo("a.webp")),
        scene("photo", "a.tif", Reader::Scene, photo("a.tif")),
        scene("photo", "a.exr", Reader::Scene, photo("a.exr")),
        scene("checksums right", "a.png", Reader::ScenePng, photo("a.png")),
        scene("grey and alpha", "a.png", Reader::ScenePng, grey),
    ];
    let mut masked = scene("mask", "a.png", Reader::Scene, photo("a.png"));
    masked.beside.push((masked.file.clone(), masked.bytes.clone()));
    masked.file = "masks/a.png".into();
    all.push(masked);
    all
}

fn depth_maps() -> Vec<Input> {
    let folder = tempfile::tempdir().unwrap();
    let encoded = |name: &str, picture: image::DynamicImage| {
        let path = folder.path().join(name);
        picture.save(&path).unwrap();
        fs::read(path).unwrap()
    };
    let steps = image::ImageBuffer::from_fn(12, 9, |x, y| image::Luma([(1000 + 10 * x + y) as u16]));
    let floats = image::ImageBuffer::from_fn(12, 9, |x, y| image::Rgb([1.0 + x as f32 + 0.1 * y as f32; 3]));
    let npy = |kind: &str, shape: &str, values: Vec<u8>| {
        let head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
        let len = (head.len() + 11).next_multiple_of(64) - 10;
        let start = [b"\x93NUMPY\x01\x00".as_slice(), &(len as u16).to_le_bytes()].concat();
        [start, format!("{head:<width$}\n", width = len - 1).into_bytes(), values].concat()
    };
    let values = || (0..12 * 9).map(|i| 1.5 + f64::from(i));
    vec![
        lone(
            "floats.npy",
            Reader::Depth,
            npy("<f4", "(9, 12)", values().flat_map(|v| (v as f32).to_le_bytes()).collect()),
        ),
        lone("doubles.npy", Reader::Depth, npy(">f8", "(9, 12, 1)", values().flat_map(f64::to_be_bytes).collect())),
        lone(
            "steps.npy",
            Reader::Depth,
            npy("<u2", "(1, 9, 12)", values().flat_map(|v| (v as u16).to_le_bytes()).collect()),
        ),
        lone(
            "torch.npy",
            Reader::Depth,
            npy("<f4", "(1, 1, 9, 12)", values().flat_map(|v| (v as f32).to_le_bytes()).collect()),
        ),
        lone(
            "a.jpg.geometric.bin",
            Reader::Depth,
            [b"12&9&1&".to_vec(), values().flat_map(|v| (v as f32).to_le_bytes()).collect()].concat(),
        ),
        lone("depth.png", Reader::Depth, encoded("a.png", image::DynamicImage::ImageLuma16(steps))),
        lone("depth.exr", Reader::Depth, encoded("a.exr", image::DynamicImage::ImageRgb32F(floats))),
    ]
}

fn config() -> Vec<u8> {
    // Every table and kind of value.
    r#"scene = "capture"
images = "images_4"
resolution = "/4"
seed = 1
eval_every = 8
sh_degree = 3
init = { model = "model.ply" }
init_count = 5000
background = [0.0, 0.5, 1.0]
antialias = true
exposure = false
max_gaussians = 4000000
checkpoint_every = 5000

[schedule]
iterations = 2000
position_rate = 0.00016
position_rate_end = 0.0000016
densify_until = 0.5
densify_every = 100
opacity_reset_every = 3000
degree_every = 0.033

[prune]
at = [0.4, 0.5]
responses = "average"
average_from = 0.4
l2 = 2.0

[prune.compression]
selector = "css"
budget = "hybrid"
detail = 0.05
merge = true
keep = { share = 0.28 }

[prune.compression.basis]
overlap = "normalised"
dilate = 0.0
solver = "low-rank"
epsilon = 0.0001
tau = 0.99
eta = 1.0
partition = { adaptive = { mean = 48, least = 8, most = 128 } }

[effects]
exposure = "off"
"#
    .into()
}

fn checkpoint() -> Vec<u8> {
    let model = make::model(5, 1);
    let snapshot = Snapshot {
        state: TrainState::default(),
        iteration: 7,
        skipped_rows: 0,
        tail: 0,
        moments: Attributes::widths(1).map(|width| vec![0.5; 2 * 5 * width]),
        growth: vec![0.25; 10],
        responses: (vec![1.0; 40], vec![3; 5]),
        exposures: (vec![1.0; 24], vec![0.0; 48]),
        poses: vec![0.01; 2 * STORED],
        arrays: [("scores".to_owned(), vec![1.0; 5]), ("scores.moments".to_owned(), vec![0.0; 10])].into(),
        mean: Some(Mean { model: make::model(5, 1), iterates: 3 }),
        notes: [("config".to_owned(), "seed = 1".to_owned())].into(),
        model,
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    snapshot.write(&path).unwrap();
    fs::read(path).unwrap()
}
