//! Walks: smooth paths of a camera through given ones.

use super::Error;
use super::camera::Camera;
use super::read_text;
use super::readers::pose;
use glam::{DMat3, DQuat, DVec2, DVec3};
use serde_json::Value;
use std::path::Path;

/// Least step between two keys, in mean distances: keys at one place turn at once.
const LEAST: f64 = 1e-6;
/// Numbers of a camera: place, turn, focal lengths, principal point.
const NUMBERS: usize = 11;

/// `frames` cameras on a smooth path through `keys`, from the first to the last, at an even pace of moves and turns. Pictures have the
/// size of the first.
///
/// Between keys it is a cubic spline (Catmull and Rom's, with knots by distance and angle) of place, unit quaternion and lens.
pub fn walk(keys: &[Camera], frames: u32) -> Vec<Camera> {
    let Some(first) = keys.first() else { return Vec::new() };
    let mut rows: Vec<[f64; NUMBERS]> =
        keys.iter().map(|key| numbers(&key.resized(first.width, first.height))).collect();
    for k in 1..rows.len() {
        // Of the two quaternions of a turn, the one near the last key's.
        let against = (3..7).map(|n| rows[k][n] * rows[k - 1][n]).sum::<f64>() < 0.0;
        if against {
            (3..7).for_each(|n| rows[k][n] = -rows[k][n]);
        }
    }
    let knots = knots(&rows);
    let end = knots.last().copied().unwrap_or_default();
    let frame = |i: u32| {
        let at = if frames > 1 { end * f64::from(i) / f64::from(frames - 1) } else { 0.0 };
        camera(&spline(&rows, &knots, at), first)
    };
    (0..frames).map(frame).collect()
}

/// The camera's centre, its turn as a quaternion, and its lens.
fn numbers(camera: &Camera) -> [f64; NUMBERS] {
    let mut numbers = [0.0; NUMBERS];
    numbers[..3].copy_from_slice(&camera.centre().to_array());
    numbers[3..7].copy_from_slice(&DQuat::from_mat3(&camera.rotation).normalize().to_array());
    numbers[7..9].copy_from_slice(&camera.focal.to_array());
    numbers[9..].copy_from_slice(&camera.principal.to_array());
    numbers
}

fn camera(row: &[f64; NUMBERS], like: &Camera) -> Camera {
    let turn = DQuat::from_slice(&row[3..]);
    let turn = if turn.length_squared() > 0.0 { turn.normalize() } else { DQuat::IDENTITY };
    let rotation = DMat3::from_quat(turn);
    let centre = DVec3::from_slice(row);
    Camera {
        rotation,
        translation: -(rotation * centre),
        focal: DVec2::from_slice(&row[7..]),
        principal: DVec2::from_slice(&row[9..]),
        width: like.width,
        height: like.height,
        whole: None,
    }
}

/// Position of each key along the path: the sum of translations, relative to the mean one, and rotations in radians.
fn knots(rows: &[[f64; NUMBERS]]) -> Vec<f64> {
    let moved = |a: &[f64; NUMBERS], b: &[f64; NUMBERS]| (0..3).map(|n| (a[n] - b[n]).powi(2)).sum::<f64>().sqrt();
    let moves: Vec<f64> = rows.windows(2).map(|w| moved(&w[0], &w[1])).collect();
    let mean = moves.iter().sum::<f64>() / moves.len().max(1) as f64;
    let mut at = 0.0;
    let mut knots = vec![0.0];
    for (pair, moved) in rows.windows(2).zip(moves) {
        let cosine = (3..7).map(|n| pair[0][n] * pair[1][n]).sum::<f64>().clamp(-1.0, 1.0);
        let turned = 2.0 * cosine.acos();
        at += (if mean > 0.0 { moved / mean } else { 0.0 } + turned).max(LEAST);
        knots.push(at);
    }
    knots
}

/// The path at a place between the first knot and the last.
fn spline(rows: &[[f64; NUMBERS]], knots: &[f64], at: f64) -> [f64; NUMBERS] {
    if rows.len() < 2 {
        return rows[0];
    }
    let k = knots.partition_point(|knot| *knot <= at).clamp(1, rows.len() - 1) - 1;
    let length = knots[k + 1] - knots[k];
    let s = ((at - knots[k]) / length).clamp(0.0, 1.0);
    let slope = |i: usize, n: usize| {
        let (low, high) = (i.saturating_sub(1), (i + 1).min(rows.len() - 1));
        (rows[high][n] - rows[low][n]) / (knots[high] - knots[low])
    };
    let (ss, sss) = (s * s, s * s * s);
    std::array::from_fn(|n| {
        (2.0 * sss - 3.0 * ss + 1.0) * rows[k][n]
            + (sss - 2.0 * ss + s) * length * slope(k, n)
            + (3.0 * ss - 2.0 * sss) * rows[k + 1][n]
            + (sss - ss) * length * slope(k + 1, n)
    })
}

/// The size and lens of cameras whose file does not say.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// True if that size was asked for, whatever the file says.
    pub asked: bool,
    /// Vertical field of view in radians.
    pub fov: f64,
    /// Up in the world.
    pub up: DVec3,
}

/// A path's file.
#[derive(Clone, Debug)]
pub struct PathFile {
    /// Its cameras.
    pub cameras: Vec<Camera>,
    /// True if they are all frames, and not keys of a path.
    pub every: bool,
    /// Frames per second, if the file says.
    pub fps: Option<f64>,
}

/// Reads a path: `{"keys": [{"eye": [x, y, z], "target": [x, y, z], "up": [x, y, z], "fov": degrees}, ...]}`, of which up and fov may
/// be absent; or nerfstudio's, `{"camera_path": [{"camera_to_world": [16 numbers], "fov": degrees}, ...], "fps": 24}`.
///
/// # Errors
/// [`Error::Io`]; [`Error::Malformed`] names the camera.
pub fn read(path: &Path, frame: &Frame) -> Result<PathFile, Error> {
    let text = read_text(path)?;
    let whole = |what: String| Error::malformed(path, "file", what);
    let document: Value = serde_json::from_str(&text).map_err(|e| whole(format!("is not JSON: {e}")))?;
    let every = document["camera_path"].is_array();
    let kind = &document["camera_type"];
    if kind.as_str().is_some_and(|kind| !kind.eq_ignore_ascii_case("perspective")) {
        return Err(whole(format!(
            "its camera_type is {kind}; perspective is read, and --panorama draws all directions"
        )));
    }
    let side =
        |name: &str| document[name].as_u64().and_then(|n| u32::try_from(n).ok()).filter(|n| (1..1 << 16).contains(n));
    let own = side("render_width").zip(side("render_height")).filter(|_| !frame.asked);
    let frame = &Frame { size: own.unwrap_or(frame.size), ..*frame };
    let (name, read): (_, Reader) = if every { ("camera_path", posed) } else { ("keys", looking) };
    let cameras = document[name].as_array().filter(|list| !list.is_empty());
    let cameras = cameras
        .ok_or_else(|| whole("it holds no cameras: neither `keys` nor `camera_path` is a list of cameras".into()))?;
    let one = |(i, camera)| read(camera, frame).map_err(|what| Error::malformed(path, format!("{name}[{i}]"), what));
    let fps = document["fps"].as_f64().filter(|fps| (0.1..=1000.0).contains(fps));
    Ok(PathFile { cameras: cameras.iter().enumerate().map(one).collect::<Result<_, _>>()?, every, fps })
}

/// A reader of one camera.
type Reader = fn(&Value, &Frame) -> Result<Camera, String>;

/// A camera that looks from a point to another.
fn looking(key: &Value, frame: &Frame) -> Result<Camera, String> {
    let known = ["eye", "target", "up", "fov"];
    if let Some(name) = key.as_object().and_then(|key| key.keys().find(|name| !known.contains(&name.as_str()))) {
        return Err(format!("{name} is unknown; a key has eye, target, up and fov"));
    }
    let point = |name: &str| point_of(&key[name]);
    let eye = point("eye").ok_or("eye: write [x, y, z]")?;
    let target = point("target").ok_or("target: write [x, y, z]")?;
    let up = if key["up"].is_null() { frame.up } else { point("up").ok_or("up: write [x, y, z]")? };
    if eye == target {
        return Err("eye and target are the same point".into());
    }
    if up == DVec3::ZERO {
        return Err("up: write a direction, not 0, 0, 0".into());
    }
    Ok(Camera::look_at(eye, target, up, fov(key, frame)?, frame.size.0, frame.size.1))
}

/// A camera of nerfstudio: camera to world, x right, y up, looking along -z.
fn posed(key: &Value, frame: &Frame) -> Result<Camera, String> {
    let rows = pose::rows(&key["camera_to_world"]).ok_or("camera_to_world: write 16 numbers, row by row")?;
    // Editors round their matrices to a few decimals.
    let pose = pose::from_opengl_skewed(&rows, 0.04);
    let (rotation, translation) =
        pose.ok_or("camera_to_world: its axes are not orthogonal and right-handed, or not all its numbers are finite")?;
    let plain = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov(key, frame)?, frame.size.0, frame.size.1);
    Ok(Camera { rotation, translation, ..plain })
}

fn fov(key: &Value, frame: &Frame) -> Result<f64, String> {
    match &key["fov"] {
        Value::Null => Ok(frame.fov),
        fov => {
            let degrees = fov.as_f64().filter(|f| (1.0..=170.0).contains(f));
            degrees.map(f64::to_radians).ok_or_else(|| "fov: write degrees from 1 to 170".into())
        }
    }
}

fn point_of(value: &Value) -> Option<DVec3> {
    let numbers: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
    Some(DVec3::from_array(numbers?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, z: f64) -> Camera {
        Camera::look_at(DVec3::new(x, 0.0, z), DVec3::ZERO, DVec3::NEG_Y, 0.7, 64, 48)
    }

    #[test]
    fn a_walk_passes_its_keys_smoothly() {
        let keys = [at(0.0, -4.0), at(1.0, -4.0), at(2.5, -3.0), at(4.0, 0.0)];
        let path = walk(&keys, 301);
        assert_eq!(path.len(), 301);
        for key in &keys {
            let nearest = path.iter().map(|c| c.centre().distance(key.centre())).fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.03, "{nearest}");
        }
        assert!(path[0].centre().distance(keys[0].centre()) < 1e-12);
        assert!(path[300].centre().distance(keys[3].centre()) < 1e-9);
        let steps: Vec<DVec3> = path.windows(2).map(|w| w[1].centre() - w[0].centre()).collect();
        let longest = steps.iter().map(|s| s.length()).fold(0.0, f64::max);
        for pair in steps.windows(2) {
            assert!((pair[1] - pair[0]).length() < 0.05 * longest, "no jerk: {pair:?}");
        }
        for camera in &path {
            let seen = camera.rotation * DVec3::ZERO + camera.translation;
            assert!(seen.z > 0.0 && (seen.x / seen.z).abs() < 0.1, "it keeps looking at the middle: {seen}");
            assert!((camera.rotation.determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn strange_keys_are_walked_too() {
        assert!(walk(&[], 5).is_empty());
        assert_eq!(walk(&[at(0.0, -4.0)], 3).len(), 3);
        let twice = [at(0.0, -4.0), at(0.0, -4.0), at(0.0, 4.0)];
        assert!(walk(&twice, 50).iter().all(|c| c.translation.is_finite() && c.rotation.is_finite()));
        assert_eq!(walk(&twice, 1)[0].centre(), walk(&twice, 50)[0].centre());
    }

    #[test]
    fn files_of_both_kinds_are_read_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.json");
        let frame = Frame { size: (64, 48), asked: false, fov: 0.7, up: DVec3::NEG_Y };
        let read = |text: &str| {
            std::fs::write(&file, text).unwrap();
            super::read(&file, &frame)
        };
        let keys = read(
            r#"{"keys": [{"eye": [0, 0, -4], "target": [0, 0, 0]}, {"eye": [4, 0, 0], "target": [0, 0, 0], "fov": 60}]}"#,
        );
        let PathFile { cameras: keys, every, fps } = keys.unwrap();
        assert!(!every && fps.is_none());
        assert!((keys[0].rotation - at(0.0, -4.0).rotation).to_cols_array().iter().all(|x| x.abs() < 1e-12));
        assert!(keys[1].focal.x < keys[0].focal.x);
        // Nerfstudio's identity looks along -z with y up.
        let posed = read(
            r#"{"camera_path": [{"camera_to_world": [1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1], "fov": 40}], "fps": 24}"#,
        );
        let PathFile { cameras: posed, every, fps } = posed.unwrap();
        assert!(every && fps == Some(24.0));
        assert_eq!(posed[0].centre(), DVec3::new(1.0, 2.0, 3.0));
        let seen = posed[0].rotation * DVec3::new(1.0, 3.0, 1.0) + posed[0].translation;
        assert_eq!(seen, DVec3::new(0.0, -1.0, 2.0));
        // A turn of 30 degrees about y, rounded to two decimals.
        let rounded = read(
            r#"{"camera_path": [{"camera_to_world": [0.87,0,0.5,0, 0,1,0,0, -0.5,0,0.87,0, 0,0,0,1]}, {"camera_to_world": [0.87,0.25,0.43,0, 0,0.87,-0.5,0, -0.5,0.43,0.75,0, 0,0,0,1]}]}"#,
        );
        let near = |camera: &Camera| (camera.rotation.determinant() - 1.0).abs() < 1e-12;
        assert!(rounded.unwrap().cameras.iter().all(near));
        let pose = r#"[{"camera_to_world": [1,0,0,1, 0,1,0,2, 0,0,1,3, 0,0,0,1]}]"#;
        let sized = |frame: &Frame| {
            let text = format!(r#"{{"render_width": 320, "render_height": 200, "camera_path": {pose}}}"#);
            std::fs::write(&file, format!("\u{feff}{text}")).unwrap();
            super::read(&file, frame).unwrap().cameras[0].clone()
        };
        assert_eq!((sized(&frame).width, sized(&frame).height), (320, 200));
        assert_eq!(sized(&Frame { asked: true, ..frame }).width, 64);
        for (bad, says) in [
            ("", "is not JSON"),
            ("{}", "neither"),
            (r#"{"keys": []}"#, "neither"),
            (r#"{"keys": [{"eye": [0, 0], "target": [0, 0, 0]}]}"#, "keys[0]"),
            (r#"{"keys": [{"eye": [0, 0, 0], "target": [0, 0, 0]}]}"#, "the same point"),
            (r#"{"keys": [{"eye": [0, 0, 1], "target": [0, 0, 0], "fov": 200}]}"#, "fov"),
            (r#"{"keys": [{"eye": [0, 0, 1], "target": [0, 0, 0], "fovv": 20}]}"#, "fovv is unknown"),
            (r#"{"keys": [{"eye": [0, 0, 1], "target": [0, 0, 0], "up": [0, 0, 0]}]}"#, "up: write a direction"),
            (r#"{"camera_path": [{"camera_to_world": [0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]}]}"#, "camera_path[0]"),
            (r#"{"camera_type": "equirectangular", "camera_path": [0]}"#, "--panorama"),
            (r#"{"camera_path": [{"camera_to_world": [1,1,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]}"#, "orthogonal"),
            (r#"{"camera_path": [{"camera_to_world": [-1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]}"#, "right-handed"),
        ] {
            let error = read(bad).unwrap_err().to_string();
            assert!(error.contains(says) && error.contains("path.json"), "{bad}: {error}");
        }
    }
}
