//! The path of the cameras, where it makes poses or the views between them doubtful.

use crate::scene::camera::Camera;
use glam::DVec3;

/// Fewest cameras whose places say anything: a few always lie near a plane.
const FEWEST: usize = 6;
/// Extent of the cameras over their median distance to the points below which they hardly moved.
const MOVED: f64 = 0.02;
/// Largest distance from a straight line, as a share of the path's length along it, of a straight path.
const STRAIGHT: f64 = 0.02;
/// Largest distance from a plane, as a share of the path's length, of a flat path.
const FLAT: f64 = 0.01;

/// The doubt about cameras that only turned, and the remedy.
const TURNED: &str = "the camera hardly moved: walk around the scene instead of turning on the spot";
/// The doubt about cameras that stand on one straight line.
const LINE: &str = "the cameras stand on one straight line: the scene is seen from one side; walk around it";
/// The doubt about cameras that lie in one plane.
const PLANE: &str =
    "the cameras lie in one plane: views from above and below it will be poor; take some photos from higher and lower";

/// The doubt that the cameras' places call for. `extent` is the cameras', and `median` their median distance to the points,
/// if there are points.
pub(super) fn doubt<'a>(
    cameras: impl Iterator<Item = &'a Camera>,
    extent: f64,
    median: Option<f64>,
) -> Option<&'static str> {
    if median.is_some_and(|median| extent < MOVED * median) {
        return Some(TURNED);
    }
    let centres: Vec<DVec3> = cameras.map(Camera::centre).collect();
    if centres.len() < FEWEST {
        return None;
    }
    let mean = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let longest = |offsets: &[DVec3]| {
        offsets.iter().copied().fold(DVec3::ZERO, |a, b| if b.length_squared() > a.length_squared() { b } else { a })
    };
    // The farthest from the middle gives the path's direction; the farthest from that line, its plane.
    let offsets: Vec<DVec3> = centres.iter().map(|c| *c - mean).collect();
    let along = longest(&offsets);
    let direction = along.try_normalize()?;
    let aside: Vec<DVec3> = offsets.iter().map(|o| *o - direction * o.dot(direction)).collect();
    let across = longest(&aside);
    if across.length() < STRAIGHT * along.length() {
        return Some(LINE);
    }
    let normal = direction.cross(across).try_normalize()?;
    let height = offsets.iter().map(|o| o.dot(normal).abs()).fold(0.0, f64::max);
    (height < FLAT * along.length()).then_some(PLANE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras at places, which look at the origin.
    fn at(place: impl Fn(f64) -> DVec3, n: usize) -> Vec<Camera> {
        let eye = |i: usize| place(i as f64 / n as f64);
        (0..n).map(|i| Camera::look_at(eye(i), DVec3::ZERO, DVec3::NEG_Y, 0.8, 40, 30)).collect()
    }

    fn of(cameras: &[Camera], median: f64) -> Option<&'static str> {
        doubt(cameras.iter(), crate::scene::camera::extent(cameras.iter()), Some(median))
    }

    /// A walk around the origin whose height sways by a share of its radius; tilted, so that no axis is the world's.
    fn ring(sway: f64) -> impl Fn(f64) -> DVec3 {
        move |t| {
            let (sin, cos) = (6.2 * t).sin_cos();
            let (tilted, height) = (DVec3::new(0.6, 0.8, 0.0), sway * (40.0 * t).sin());
            5.0 * (cos * tilted + sin * DVec3::Z + height * DVec3::new(-0.8, 0.6, 0.0))
        }
    }

    #[test]
    fn paths_are_told_apart() {
        assert_eq!(of(&at(ring(0.1), 30), 5.0), None, "a walk by hand");
        assert_eq!(of(&at(ring(0.001), 30), 5.0), Some(PLANE), "a turntable");
        assert_eq!(of(&at(ring(0.0), 5), 5.0), None, "five cameras say nothing");
        let line = |bend: f64| move |t: f64| DVec3::new(4.0 * t - 2.0, bend * (7.0 * t).sin(), -6.0);
        assert_eq!(of(&at(line(0.001), 20), 6.0), Some(LINE), "a rail");
        assert_eq!(of(&at(line(0.5), 20), 6.0), Some(PLANE), "a wave in a plane");
        let spot = |t: f64| DVec3::new(0.0, 0.0, -6.0) + 0.01 * DVec3::new((9.0 * t).sin(), (7.0 * t).cos(), t);
        assert_eq!(of(&at(spot, 20), 6.0), Some(TURNED), "a turn on the spot");
        assert_eq!(of(&at(|_| DVec3::NEG_Z, 20), f64::INFINITY), Some(TURNED));
        assert_eq!(doubt(at(|_| DVec3::NEG_Z, 20).iter(), 0.0, None), None, "equal places without points");
    }
}
