//! COLMAP text in the form of the synthetic scenes.

use super::quantile;
use glam::{DQuat, DVec2, DVec3};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::Path;

/// A COLMAP text model with its own reader, so that a fault of the writer cannot hide in a shared one.
pub struct Model {
    pub cameras: BTreeMap<u32, (String, DVec2, Vec<f64>)>,
    pub images: BTreeMap<u32, Shot>,
    pub points: BTreeMap<u64, Mark>,
}

pub struct Shot {
    pub rotation: DQuat,
    pub translation: DVec3,
    pub camera: u32,
    pub name: String,
    pub marks: Vec<(DVec2, u64)>,
}

pub struct Mark {
    pub place: DVec3,
    pub colour: [f64; 3],
    pub track: Vec<(u32, usize)>,
}

impl Model {
    pub fn read(dir: &Path) -> Self {
        let lines = |name: &str| -> Vec<String> {
            let text = fs::read_to_string(dir.join("sparse/0").join(name)).unwrap();
            text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect()
        };
        let numbers = |words: &[&str]| -> Vec<f64> { words.iter().map(|w| w.parse().unwrap()).collect() };
        let mut model = Self { cameras: BTreeMap::new(), images: BTreeMap::new(), points: BTreeMap::new() };
        for line in lines("cameras.txt") {
            let w: Vec<_> = line.split(' ').collect();
            let n = numbers(&w[2..]);
            model.cameras.insert(w[0].parse().unwrap(), (w[1].to_owned(), DVec2::new(n[0], n[1]), n[2..].to_vec()));
        }
        for pair in lines("images.txt").chunks(2) {
            let w: Vec<_> = pair[0].split(' ').collect();
            let n = numbers(&w[1..8]);
            let marks = numbers(&pair[1].split_whitespace().collect::<Vec<_>>());
            let shot = Shot {
                rotation: DQuat::from_xyzw(n[1], n[2], n[3], n[0]),
                translation: DVec3::new(n[4], n[5], n[6]),
                camera: w[8].parse().unwrap(),
                name: w[9].to_owned(),
                marks: marks.chunks(3).map(|m| (DVec2::new(m[0], m[1]), m[2] as u64)).collect(),
            };
            model.images.insert(w[0].parse().unwrap(), shot);
        }
        for line in lines("points3D.txt") {
            let n = numbers(&line.split(' ').collect::<Vec<_>>());
            let track = n[8..].chunks(2).map(|t| (t[0] as u32, t[1] as usize)).collect();
            let mark = Mark { place: DVec3::new(n[1], n[2], n[3]), colour: [n[4], n[5], n[6]], track };
            model.points.insert(n[0] as u64, mark);
        }
        model
    }

    pub fn project(&self, shot: &Shot, p: DVec3) -> DVec2 {
        let q = shot.rotation * p + shot.translation;
        let (model, size, k) = &self.cameras[&shot.camera];
        if model == "EQUIRECTANGULAR" {
            assert_eq!(k[..], size.to_array());
            let (theta, phi) = (q.x.atan2(q.z), (-q.y).atan2(q.x.hypot(q.z)));
            return DVec2::new((theta / TAU + 0.5) * k[0], (0.5 - phi / PI) * k[1]);
        }
        assert!(q.z > 0.0, "an observed point lies behind its camera");
        let u = q.truncate() / q.z;
        let r2 = u.length_squared();
        let bent = match model.as_str() {
            "PINHOLE" => u,
            "OPENCV" => {
                let radial = 1.0 + k[4] * r2 + k[5] * r2 * r2;
                DVec2::new(
                    u.x * radial + 2.0 * k[6] * u.x * u.y + k[7] * (r2 + 2.0 * u.x * u.x),
                    u.y * radial + 2.0 * k[7] * u.x * u.y + k[6] * (r2 + 2.0 * u.y * u.y),
                )
            }
            "OPENCV_FISHEYE" => {
                let theta = r2.sqrt().atan();
                let t2 = theta * theta;
                let bent = theta * (1.0 + t2 * (k[4] + t2 * (k[5] + t2 * (k[6] + t2 * k[7]))));
                u * (bent / r2.sqrt())
            }
            other => panic!("unexpected camera model {other}"),
        };
        bent * DVec2::new(k[0], k[1]) + DVec2::new(k[2], k[3])
    }

    /// Distance in focal lengths of each camera that sees a point: the size of its pixel there.
    pub fn footprints(&self, mark: &Mark) -> Vec<f64> {
        let size = |(image, _): &(u32, usize)| {
            let shot = &self.images[image];
            (shot.rotation * mark.place + shot.translation).length() / self.cameras[&shot.camera].2[0]
        };
        mark.track.iter().map(size).collect()
    }

    /// Median over points of the ratio of the coarsest to the finest footprint.
    pub fn footprint_ratio(&self) -> f64 {
        let many = self.points.values().filter(|m| m.track.len() >= 3).map(|m| {
            let mut sizes = self.footprints(m);
            sizes.sort_by(f64::total_cmp);
            sizes[sizes.len() - 1] / sizes[0]
        });
        quantile(many.collect(), 0.5)
    }

    /// For each point, the root mean square over views and channels of the difference between photo and point, in
    /// 1/255.
    pub fn deviations(&self, dir: &Path) -> Vec<f64> {
        let open = |s: &Shot| image::open(dir.join("images").join(&s.name)).unwrap().to_rgb8();
        let photos: BTreeMap<_, _> = self.images.iter().map(|(i, s)| (*i, open(s))).collect();
        let mut all = Vec::new();
        for mark in self.points.values().filter(|m| m.track.len() >= 4) {
            let mut sum = 0.0;
            for (image, index) in &mark.track {
                let (photo, at) = (&photos[image], self.images[image].marks[*index].0 - 0.5);
                let (x, y) = (at.x.floor(), at.y.floor());
                for c in 0..3 {
                    let pixel = |dx: f64, dy: f64| f64::from(photo.get_pixel((x + dx) as u32, (y + dy) as u32)[c]);
                    let (fx, fy) = (at.x - x, at.y - y);
                    let above = pixel(0.0, 0.0) * (1.0 - fx) + pixel(1.0, 0.0) * fx;
                    let below = pixel(0.0, 1.0) * (1.0 - fx) + pixel(1.0, 1.0) * fx;
                    sum += (above * (1.0 - fy) + below * fy - mark.colour[c]).powi(2);
                }
            }
            all.push((sum / (3 * mark.track.len()) as f64).sqrt());
        }
        all
    }
}
