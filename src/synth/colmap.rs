//! The COLMAP text model: `cameras.txt`, `images.txt`, `points3D.txt`.

use std::{fmt::Write as _, fs, path::Path};

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::{
    Error,
    lens::Lens,
    path::{Device, View},
};
use crate::scene::lens::LensModel;

/// A point with its colour and the photos that see it.
pub(super) struct Point {
    pub position: DVec3,
    /// 0..=255.
    pub colour: [u8; 3],
    /// View and pixel of each observation.
    pub seen: Vec<(usize, DVec2)>,
}

/// Rotation from the plaza's world (z up) to the files' (y down, as in most COLMAP models and as viewers of Gaussians
/// expect).
fn file_world() -> DMat3 {
    DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y)
}

/// Writes the three files into an existing folder.
pub(super) fn write(folder: &Path, devices: &[Device], views: &[View], points: &[Point]) -> Result<(), Error> {
    let save = |name: &str, text: String| {
        let path = folder.join(name);
        fs::write(&path, text).map_err(Error::io(&path))
    };
    save("cameras.txt", cameras(devices))?;
    let (images, points) = images_and_points(views, points);
    save("images.txt", images)?;
    save("points3D.txt", points)
}

// Writing to a `String` cannot fail: the results of `write!` are dropped below.

fn cameras(devices: &[Device]) -> String {
    let mut text = String::from(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",
    );
    for (i, d) in devices.iter().enumerate() {
        let (model, parameters) = match d.lens {
            Lens::Panorama => (LensModel::Equirectangular, vec![f64::from(d.width), f64::from(d.height)]),
            Lens::Front(model, k) => {
                let plane = [&d.focal.to_array()[..model.focal_lengths()], &d.principal.to_array()].concat();
                (model, plane.into_iter().chain(k).take(model.parameters()).collect())
            }
        };
        let _ = write!(text, "{} {} {} {}", i + 1, model.name(), d.width, d.height);
        for value in parameters {
            let _ = write!(text, " {value}");
        }
        text.push('\n');
    }
    text
}

fn images_and_points(views: &[View], points: &[Point]) -> (String, String) {
    let mut lists = vec![String::new(); views.len()];
    let mut counts = vec![0usize; views.len()];
    let mut text = String::from(
        "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n",
    );
    let world = file_world();
    for (i, point) in points.iter().enumerate() {
        let (p, [r, g, b]) = (world * point.position, point.colour);
        let _ = write!(text, "{} {:.6} {:.6} {:.6} {r} {g} {b} 0", i + 1, p.x, p.y, p.z);
        for &(view, pixel) in &point.seen {
            let _ = write!(text, " {} {}", view + 1, counts[view]);
            let gap = if counts[view] == 0 { "" } else { " " };
            let _ = write!(lists[view], "{gap}{:.3} {:.3} {}", pixel.x, pixel.y, i + 1);
            counts[view] += 1;
        }
        text.push('\n');
    }
    let mut images = String::from(
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, POINT3D_ID)\n",
    );
    for (i, (view, list)) in views.iter().zip(lists).enumerate() {
        let q = DQuat::from_mat3(&(view.camera.rotation * world.transpose())).normalize();
        let t = view.camera.translation;
        let _ = write!(images, "{} {} {} {} {} {} {} {}", i + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z);
        let _ = writeln!(images, " {} {}\n{list}", view.device + 1, view.name);
    }
    (images, text)
}
