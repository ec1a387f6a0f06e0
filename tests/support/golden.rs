//! Readers for the golden cases of `tests/golden` and of the shared data: a minimum of PLY, COLMAP text and raw float32
//! for tests that must not trust the engine's own readers.

use super::{shared_as_well, source};

use std::{
    fs,
    path::{Path, PathBuf},
};

use glam::{DMat3, DQuat, DVec2, DVec3};
use qirf_vk::{gaussians::Gaussians, reference::Settings, render, scene::camera::Camera};

/// A golden case: the model, its views and the folder of expected arrays.
pub struct Case {
    pub name: String,
    pub model: Gaussians,
    pub views: Vec<Camera>,
    pub settings: Settings,
    folder: PathBuf,
}

impl Case {
    /// The small cases of the source tree.
    pub fn here() -> Vec<Self> {
        folders(&here()).map(Self::read).collect()
    }

    /// These, and the other cases of the shared data if present.
    pub fn all() -> Vec<Self> {
        let known = |path: &PathBuf| path.file_name().is_some_and(|name| here().join(name).is_dir());
        let shared = shared_as_well("golden").into_iter().flat_map(|root| folders(&root).collect::<Vec<_>>());
        Self::here().into_iter().chain(shared.filter(|path| !known(path)).map(Self::read)).collect()
    }

    fn read(folder: PathBuf) -> Self {
        let text = fs::read_to_string(folder.join("manifest.json")).expect("manifest.json");
        let manifest: serde_json::Value = serde_json::from_str(&text).expect("manifest.json is JSON");
        let background = std::array::from_fn(|c| manifest["background"][c].as_f64().expect("background"));
        let settings = Settings {
            background,
            antialias: manifest["antialias"].as_bool().expect("antialias"),
            sh_degree: manifest["degree"].as_u64().expect("degree") as usize,
            ..Settings::default()
        };
        Self {
            name: folder.file_name().expect("name").to_string_lossy().into_owned(),
            model: read_ply(&folder.join("model.ply")),
            views: read_cameras(&folder.join("sparse/0")),
            settings,
            folder,
        }
    }

    /// The settings in the device's form.
    pub fn device_settings(&self) -> render::Settings {
        let dilation = Some(self.settings.dilation as f32);
        let style = render::Style { antialias: self.settings.antialias, dilation, ..render::Style::default() };
        style.over(self.settings.background.map(|v| v as f32))
    }

    /// The expected array `name`, flat.
    pub fn expected(&self, name: &str) -> Vec<f64> {
        floats(&fs::read(self.folder.join(format!("expected/{name}.f32"))).expect(name))
    }

    /// The part of the expected array `name` that belongs to view `v`.
    pub fn expected_view(&self, name: &str, v: usize) -> Vec<f64> {
        let all = self.expected(name);
        let part = all.len() / self.views.len();
        all[v * part..(v + 1) * part].to_vec()
    }
}

/// The golden files of the source tree.
fn here() -> PathBuf {
    source("tests/golden")
}

/// Folders of cases, by name.
fn folders(root: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir(root).expect("golden cases").map(|entry| entry.expect("entry").path());
    let mut folders: Vec<_> = entries.filter(|path| path.join("manifest.json").is_file()).collect();
    folders.sort();
    assert!(!folders.is_empty(), "no golden case in {}", root.display());
    folders.into_iter()
}

/// Little-endian float32, widened.
pub fn floats(bytes: &[u8]) -> Vec<f64> {
    bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
}

/// A standard 3DGS PLY, binary little-endian, float properties only.
pub fn read_ply(path: &Path) -> Gaussians {
    let bytes = fs::read(path).expect("ply");
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).expect("end_header") + end.len();
    let header = std::str::from_utf8(&bytes[..body]).expect("ASCII header");
    let names: Vec<&str> = header.lines().filter_map(|line| line.strip_prefix("property float ")).collect();
    let column = |name: &str| names.iter().position(|n| *n == name).expect(name);
    let values: Vec<f32> = floats(&bytes[body..]).into_iter().map(|v| v as f32).collect();
    let rest = names.iter().filter(|n| n.starts_with("f_rest_")).count() / 3; // per channel
    let degree = (rest + 1).isqrt() - 1;

    let mut model = Gaussians { sh: vec![Vec::new(); degree + 1], ..Gaussians::default() };
    for row in values.chunks_exact(names.len()) {
        let at = |prefix: &str, k: usize| row[column(&format!("{prefix}{k}"))];
        model.means.push(["x", "y", "z"].map(|n| row[column(n)]));
        model.log_scales.push([0, 1, 2].map(|k| at("scale_", k)));
        model.rotations.push([0, 1, 2, 3].map(|k| at("rot_", k)));
        model.opacity_logits.push(row[column("opacity")]);
        model.sh[0].extend([0, 1, 2].map(|c| at("f_dc_", c)));
        for l in 1..=degree {
            for k in l * l..(l + 1) * (l + 1) {
                model.sh[l].extend([0, 1, 2].map(|c| at("f_rest_", c * rest + k - 1)));
            }
        }
    }
    model
}

/// COLMAP text: one PINHOLE camera per image, both in the order of their ids.
fn read_cameras(folder: &Path) -> Vec<Camera> {
    let numbers = |line: &str| line.split_whitespace().filter_map(|w| w.parse().ok()).collect::<Vec<f64>>();
    let cameras = fs::read_to_string(folder.join("cameras.txt")).expect("cameras.txt");
    let images = fs::read_to_string(folder.join("images.txt")).expect("images.txt");
    cameras
        .lines()
        .zip(images.lines().step_by(2))
        .map(|(camera, image)| {
            let (c, i) = (numbers(camera), numbers(image));
            Camera {
                rotation: DMat3::from_quat(DQuat::from_xyzw(i[2], i[3], i[4], i[1]).normalize()),
                translation: DVec3::from_slice(&i[5..8]),
                focal: DVec2::from_slice(&c[3..5]),
                principal: DVec2::from_slice(&c[5..7]),
                width: c[1] as u32,
                height: c[2] as u32,
                whole: None,
            }
        })
        .collect()
}

/// Another engine's picture and gradients.
pub struct Fixture {
    pub model: Gaussians,
    pub camera: Camera,
    arrays: Vec<(String, Vec<f64>)>,
}

impl Fixture {
    /// By name: four Gaussians of the source tree, and sixteen of the shared data if present.
    pub fn all() -> Vec<(&'static str, Self)> {
        let tiny = Self::read(&here().join("another-engine/tiny_case.safetensors"));
        let basic = shared_as_well("fixtures/gsplat-cuda-gradients/basic_case.safetensors");
        [("tiny", tiny)].into_iter().chain(basic.map(|path| ("basic", Self::read(&path)))).collect()
    }

    fn read(path: &Path) -> Self {
        let bytes = fs::read(path).expect("fixture");
        let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
        let shape = file.tensor("out_img").expect("out_img").shape().to_vec();
        let arrays: Vec<(String, Vec<f64>)> =
            file.iter().map(|(key, tensor)| (key.to_owned(), floats(tensor.data()))).collect();
        let mut fixture =
            Self { model: Gaussians::default(), camera: Self::camera(shape[1] as u32, shape[0] as u32), arrays };
        let narrow = |key: &str| fixture.get(key).iter().map(|x| *x as f32).collect::<Vec<_>>();
        let rows3 = |key: &str| narrow(key).chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect::<Vec<_>>();
        let coefficients = narrow("coeffs");
        let band = |l: usize| {
            coefficients.chunks_exact(48).flat_map(|c| c[l * l * 3..(l + 1) * (l + 1) * 3].to_vec()).collect()
        };
        fixture.model = Gaussians {
            means: rows3("means"),
            log_scales: rows3("scales"),
            rotations: narrow("quats").chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect(),
            opacity_logits: narrow("opacities"),
            sh: (0..4).map(band).collect(),
        };
        fixture
    }

    fn camera(width: u32, height: u32) -> Camera {
        let size = DVec2::new(f64::from(width), f64::from(height));
        Camera {
            rotation: DMat3::IDENTITY,
            translation: -DVec3::new(0.123, 0.456, -8.0),
            focal: DVec2::splat(0.5 * size.x),
            principal: 0.5 * size,
            width,
            height,
            whole: None,
        }
    }

    /// The array `key`, flat.
    pub fn get(&self, key: &str) -> &[f64] {
        &self.arrays.iter().find(|(name, _)| name == key).expect(key).1
    }
}

/// Value and gradient of the loss for a photo and a picture that are close, far apart and equal (`loss.py`).
#[derive(serde::Deserialize)]
#[serde(from = "Channels")]
pub struct Loss {
    pub size: [u32; 2],
    pub ssim_weight: f64,
    pub rendered: Vec<[f64; 3]>,
    pub truth: Vec<[u8; 3]>,
    pub l1: f64,
    pub ssim: f64,
    pub value: f64,
    pub gradient: Vec<[f64; 3]>,
}

/// The file's own layout, channel by channel.
#[derive(serde::Deserialize)]
struct Channels {
    width: u32,
    height: u32,
    ssim_weight: f64,
    rendered: [Vec<f64>; 3],
    truth: [Vec<u8>; 3],
    l1: f64,
    ssim: f64,
    loss: f64,
    gradient: [Vec<f64>; 3],
}

impl From<Channels> for Loss {
    fn from(c: Channels) -> Self {
        fn pixels<T: Copy>(channels: &[Vec<T>; 3]) -> Vec<[T; 3]> {
            (0..channels[0].len()).map(|p| [0, 1, 2].map(|c| channels[c][p])).collect()
        }
        Self {
            size: [c.width, c.height],
            ssim_weight: c.ssim_weight,
            rendered: pixels(&c.rendered),
            truth: pixels(&c.truth),
            l1: c.l1,
            ssim: c.ssim,
            value: c.loss,
            gradient: pixels(&c.gradient),
        }
    }
}

impl Loss {
    pub fn read() -> Self {
        let text = fs::read_to_string(here().join("loss.json")).expect("loss.json");
        serde_json::from_str(&text).expect("the golden loss")
    }
}
