//! Writers of small scenes, as input for the readers.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

use qirf_vk::scene::lens::LensModel;

/// Id, quaternion, translation, camera id, name, number of 2D points.
pub type Image = (u32, [f64; 4], [f64; 3], u32, String, usize);

/// Position, colour, error, track of image ids.
pub type Point = ([f64; 3], [u8; 3], f64, Vec<u32>);

/// A COLMAP model in memory.
#[derive(Clone, Debug)]
pub struct Model {
    /// Id, model, width, height, parameters.
    pub cameras: Vec<(u32, LensModel, u64, u64, Vec<f64>)>,
    pub images: Vec<Image>,
    pub points: Vec<Point>,
}

/// Plausible parameters of a model for an image of 640 x 480 pixels.
pub fn parameters(model: LensModel) -> Vec<f64> {
    match model {
        LensModel::SimplePinhole => vec![500.0, 320.0, 240.0],
        LensModel::Pinhole => vec![500.0, 510.0, 321.5, 238.25],
        LensModel::SimpleRadial => vec![500.0, 320.0, 240.0, -0.08],
        LensModel::Radial => vec![500.0, 318.0, 243.0, 0.06, -0.08],
        LensModel::OpenCv => vec![500.0, 505.0, 322.0, 238.0, 0.058, -0.0805, -0.00098, 0.000155],
        LensModel::OpenCvFisheye => vec![300.0, 301.0, 322.0, 238.0, 0.05, -0.01, 0.004, -0.001],
        LensModel::FullOpenCv => {
            vec![500.0, 505.0, 322.0, 238.0, 0.2, -0.1, 0.001, -0.002, 0.03, 0.15, -0.05, 0.01]
        }
        LensModel::Fov => vec![450.0, 455.0, 322.0, 238.0, 0.7],
        LensModel::RadTanThinPrismFisheye => vec![
            300.0, 301.0, 322.0, 238.0, 0.03, -0.005, 0.001, -0.0005, 0.0001, -0.00002, 0.001, 0.0002, 0.0008, -0.0006,
            0.0003, 0.0002,
        ],
        LensModel::SimpleDivision => vec![450.0, 320.0, 240.0, -0.2],
        LensModel::Division => vec![450.0, 455.0, 322.0, 238.0, -0.15],
        LensModel::SimpleFisheye => vec![300.0, 320.0, 240.0],
        LensModel::Fisheye => vec![300.0, 301.0, 322.0, 238.0],
        LensModel::Eucm => vec![300.0, 301.0, 322.0, 238.0, 0.6, 1.1],
        LensModel::Equirectangular => vec![640.0, 480.0],
        LensModel::SimpleRadialFisheye => vec![300.0, 320.0, 240.0, 0.03],
        LensModel::RadialFisheye => vec![300.0, 320.0, 240.0, 0.03, -0.005],
        LensModel::ThinPrismFisheye => {
            vec![300.0, 301.0, 322.0, 238.0, 0.03, -0.005, 0.001, -0.0005, 0.001, 0.0002, 0.0008, -0.0006]
        }
    }
}

impl Model {
    /// All camera models, ten views (named so that ids and names are in different orders), forty points.
    pub fn sample() -> Self {
        let cameras: Vec<_> = LensModel::ALL
            .into_iter()
            .enumerate()
            .map(|(i, m)| (7 + 3 * i as u32, m, 640, 480, parameters(m)))
            .collect();
        let images = (0..10_u32)
            .map(|i| {
                let t = f64::from(i);
                let q = [1.0 + 0.1 * t, 0.2, -0.03 * t, 0.1];
                let name = format!("shelf {}/view{:02}.jpg", i % 2, 99 - i);
                (100 + i, q, [0.1 * t, -0.2, 3.0 + t / 7.0], cameras[i as usize].0, name, i as usize % 4)
            })
            .collect();
        let points = (0..40_u32)
            .map(|i| {
                let t = f64::from(i);
                let track = (0..i % 5).map(|k| 100 + (3 * k + i) % 10).collect();
                ([t.sin(), t.cos(), 0.1 * t], [i as u8, 2 * i as u8, 255 - i as u8], 0.25 + t / 3.0, track)
            })
            .collect();
        Self { cameras, images, points }
    }

    pub fn binary(&self) -> [(&'static str, Vec<u8>); 3] {
        let mut cameras = (self.cameras.len() as u64).to_le_bytes().to_vec();
        for (id, model, width, height, parameters) in &self.cameras {
            cameras.extend(id.to_le_bytes());
            cameras.extend(model.id().to_le_bytes());
            cameras.extend(width.to_le_bytes());
            cameras.extend(height.to_le_bytes());
            cameras.extend(parameters.iter().flat_map(|p| p.to_le_bytes()));
        }
        let mut images = (self.images.len() as u64).to_le_bytes().to_vec();
        for (id, q, t, camera, name, keypoints) in &self.images {
            images.extend(id.to_le_bytes());
            images.extend(q.iter().chain(t).flat_map(|v| v.to_le_bytes()));
            images.extend(camera.to_le_bytes());
            images.extend(name.as_bytes());
            images.push(0);
            images.extend((*keypoints as u64).to_le_bytes());
            for k in 0..*keypoints {
                images.extend((k as f64).to_le_bytes());
                images.extend(1.5_f64.to_le_bytes());
                images.extend((-1_i64).to_le_bytes());
            }
        }
        let mut points = (self.points.len() as u64).to_le_bytes().to_vec();
        for (i, (position, colour, error, track)) in self.points.iter().enumerate() {
            points.extend((i as u64 + 1).to_le_bytes());
            points.extend(position.iter().flat_map(|v| v.to_le_bytes()));
            points.extend(colour);
            points.extend(error.to_le_bytes());
            points.extend((track.len() as u64).to_le_bytes());
            for image in track {
                points.extend(image.to_le_bytes());
                points.extend(0_u32.to_le_bytes());
            }
        }
        [("cameras.bin", cameras), ("images.bin", images), ("points3D.bin", points)]
    }

    pub fn text(&self) -> [(&'static str, Vec<u8>); 3] {
        let join = |values: &[f64]| values.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(" ");
        let mut cameras = "# Camera list\n".to_owned();
        for (id, model, width, height, parameters) in &self.cameras {
            writeln!(cameras, "{id} {} {width} {height} {}", model.name(), join(parameters)).unwrap();
        }
        let mut images = "# Image list, two lines each\n".to_owned();
        for (id, q, t, camera, name, keypoints) in &self.images {
            writeln!(images, "{id} {} {} {camera} {name}", join(q), join(t)).unwrap();
            writeln!(images, "{}", vec!["1.0 1.5 -1"; *keypoints].join(" ")).unwrap();
        }
        let mut points = "# Points\n".to_owned();
        for (i, (position, [r, g, b], error, track)) in self.points.iter().enumerate() {
            let track: String = track.iter().fold(String::new(), |all, image| all + &format!(" {image} 0"));
            writeln!(points, "{} {} {r} {g} {b} {error:?}{track}", i + 1, join(position)).unwrap();
        }
        let all = [("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", points)];
        all.map(|(name, text)| (name, text.into_bytes()))
    }
}

/// Writes files below a folder, making folders as needed.
pub fn write<'a>(root: &Path, files: impl IntoIterator<Item = (&'a str, Vec<u8>)>) {
    for (name, bytes) in files {
        let path = root.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

/// A folder of these files alone.
pub fn written<'a>(files: impl IntoIterator<Item = (&'a str, Vec<u8>)>) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), files);
    folder
}

/// A picture whose red increases to the right, and green downwards.
pub fn picture(path: &Path, width: u32, height: u32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |x, y| image::Rgb([(255 * x / width) as u8, (255 * y / height) as u8, 90]);
    image::RgbImage::from_fn(width, height, pixel).save(path).unwrap();
}

/// A pinhole model of `names` in a row along x, 64 x 48 pixels, identity rotation.
pub fn row(names: &[&str]) -> Model {
    let images = names
        .iter()
        .enumerate()
        .map(|(i, name)| (i as u32 + 1, [1.0, 0.0, 0.0, 0.0], [-(i as f64), 0.0, 0.0], 1, (*name).to_owned(), 0));
    Model {
        cameras: vec![(1, LensModel::Pinhole, 64, 48, vec![50.0, 51.0, 32.0, 24.0])],
        images: images.collect(),
        points: vec![([0.0, 0.0, 5.0], [1, 2, 3], 0.5, (1..=names.len() as u32).collect())],
    }
}

/// A transforms.json with the given top-level fields and one frame per name, cameras 2 apart along x.
pub fn transforms(top: &str, names: &[&str]) -> Vec<u8> {
    let frames: Vec<String> = names
        .iter()
        .enumerate()
        .map(|(i, name)| {
            let x = 2 * i;
            format!(r#"{{"file_path": "{name}", "transform_matrix": [[1,0,0,{x}],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}}"#)
        })
        .collect();
    format!("{{{top}, \"frames\": [{}]}}", frames.join(",\n")).into_bytes()
}
