//! Values of operations: points, turns, axes, matrices.

use crate::cli::values::{axis, finite, numbers};
use crate::edit::{NEEDLE, Region, Similarity, Unwanted, between};
use crate::scene::orbit::UP;
use glam::DVec3;

/// A finite number above 0.
pub(super) fn positive(text: &str) -> Option<f64> {
    finite(text).filter(|x| *x > 0.0)
}

pub(super) fn cube(text: &str) -> Result<Region, String> {
    let [a, b, c, d, e, f] = numbers(text).ok_or("write least x,y,z and greatest x,y,z, such as -1,-1,-1,1,1,1")?;
    Region::cube(DVec3::new(a, b, c), DVec3::new(d, e, f)).map_err(|e| e.to_string())
}

pub(super) fn ball(text: &str) -> Result<Region, String> {
    let [x, y, z, radius] = numbers(text).ok_or("write a centre and a radius, such as 0,0,0,1.5")?;
    Region::ball(DVec3::new(x, y, z), radius).map_err(|e| e.to_string())
}

pub(super) fn shift(text: &str) -> Result<Similarity, String> {
    let by = numbers(text).ok_or("write x,y,z, such as 0,1.5,-2")?;
    Ok(Similarity::shift(DVec3::from_array(by)))
}

pub(super) fn factor(text: &str) -> Result<Similarity, String> {
    let by = text.parse().map_err(|_| "write a number above 0, such as 0.1".to_owned())?;
    Similarity::scaling(by).map_err(|e| e.to_string())
}

/// `y:90`, `1,1,0:45` or the quaternion `w,x,y,z`.
pub(super) fn turn(text: &str) -> Result<Similarity, String> {
    let form = "write an axis and degrees, such as y:90 or 1,1,0:45, or a quaternion w,x,y,z";
    let turn = match text.split_once(':') {
        Some((about, degrees)) => {
            let about = axis(about).or_else(|| numbers(about).map(DVec3::from_array)).ok_or(form)?;
            Similarity::turn(about, finite(degrees).ok_or(form)?)
        }
        None => Similarity::quaternion(numbers(text).ok_or(form)?),
    };
    turn.map_err(|e| e.to_string())
}

/// Parses a new up axis, `z`, or `y:z` for a model whose y is up, into the rotation to it.
pub(super) fn up(text: &str) -> Result<Similarity, String> {
    let form = "write x, y, z, -x, -y or -z, or such an axis that is up now, a colon and the new one, such as y:z";
    let (from, to) = match text.split_once(':') {
        Some((from, to)) => (axis(from).ok_or(form)?, to),
        None => (UP, text),
    };
    between(from, axis(to).ok_or(form)?).map_err(|e| e.to_string())
}

pub(super) fn unwanted(text: &str) -> Result<Unwanted, String> {
    match text.split_once(':') {
        None if text == "invisible" => Ok(Unwanted::Invisible),
        None if text == "needles" => Ok(Unwanted::Needles(NEEDLE)),
        Some(("needles", ratio)) => {
            let ratio = finite(ratio).filter(|ratio| *ratio >= 1.0);
            ratio.map(Unwanted::Needles).ok_or_else(|| "write a ratio of 1 or more, such as needles:100".into())
        }
        _ => Err("write floaters, invisible, needles or needles:RATIO".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_or_refused() {
        assert!(cube("-1,-1,-1,1,1,1").is_ok() && ball(" 0, 0,0,1e-3").is_ok() && shift("-1,2,3e2").is_ok());
        assert_eq!(turn("x:90"), turn("1,0,0:90"));
        assert_eq!(turn("-x:90"), turn("x:-90"));
        assert_eq!(turn("1,0,0,0"), Ok(Similarity::IDENTITY));
        assert_eq!(up("-y"), Ok(Similarity::IDENTITY));
        assert_eq!(up("z").unwrap().point(DVec3::NEG_Y), DVec3::Z);
        assert_eq!(up("y:-z").unwrap().point(DVec3::Y), DVec3::NEG_Z);
        assert_eq!(unwanted("needles:30"), Ok(Unwanted::Needles(30.0)));
        for bad in ["", "1,2,3", "1,1,1,0,0,0", "0,0,0,1,1,nan", "0,0,0,1,1,inf"] {
            assert!(cube(bad).is_err(), "{bad}");
        }
        for bad in ["0,0,0,0", "0,0,0,-1", "0,0,0", "a,b,c,d"] {
            assert!(ball(bad).is_err(), "{bad}");
        }
        for bad in ["90", "w:90", "x:", "x:nan", "0,0,0:5", "0,0,0,0", "1,2:3"] {
            assert!(turn(bad).is_err(), "{bad}");
        }
        for bad in ["0", "-1", "nan", "inf", "1e400", ""] {
            assert!(factor(bad).is_err(), "{bad}");
        }
        assert!(
            up("w").is_err() && up("x:y:z").is_err() && unwanted("needles:0.5").is_err() && unwanted("dirt").is_err()
        );
    }
}
