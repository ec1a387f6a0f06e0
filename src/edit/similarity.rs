//! Similarities: rotations, reflections, translations, and uniform scaling.

use super::Error;
use crate::wording::shown;
use glam::{DMat3, DQuat, DVec3, DVec4};

/// Largest difference of a matrix from a similarity, as a share of its scale: files have six digits or more.
const TOLERANCE: f64 = 1e-4;

/// Largest deviation of the first three numbers of a matrix's fourth row from 0: rounding of the program that wrote it.
const NOISE: f64 = 1e-9;

/// The map x -> scale * rotation * x + translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Orthonormal; its determinant is -1 for a reflection.
    pub rotation: DMat3,
    /// Above 0.
    pub scale: f64,
    /// In world units.
    pub translation: DVec3,
}

impl Similarity {
    /// The identity.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, scale: 1.0, translation: DVec3::ZERO };

    /// A translation, in world units.
    pub fn shift(translation: DVec3) -> Self {
        Self { translation, ..Self::IDENTITY }
    }

    /// A scaling about the origin, by a finite number above 0.
    ///
    /// # Errors
    /// [`Error::Numbers`] for another number.
    pub fn scaling(scale: f64) -> Result<Self, Error> {
        if scale.is_finite() && scale > 0.0 {
            return Ok(Self { scale, ..Self::IDENTITY });
        }
        Err(Error::Numbers(format!("{scale} is not a valid scale: give a finite number above 0")))
    }

    /// A right-handed rotation about an axis through the origin, in degrees.
    ///
    /// # Errors
    /// [`Error::Numbers`] for an axis without a direction, or degrees that are not finite.
    pub fn turn(axis: DVec3, degrees: f64) -> Result<Self, Error> {
        let axis = unit(axis).filter(|_| degrees.is_finite());
        let axis =
            axis.ok_or_else(|| Error::Numbers("a rotation needs an axis other than 0, and finite degrees".into()))?;
        // Quarter turns have no error of rounding.
        let (sin, cos) = match degrees.rem_euclid(360.0) {
            0.0 => (0.0, 1.0),
            90.0 => (1.0, 0.0),
            180.0 => (0.0, -1.0),
            270.0 => (-1.0, 0.0),
            other => other.to_radians().sin_cos(),
        };
        let cross = DMat3::from_cols(axis.cross(DVec3::X), axis.cross(DVec3::Y), axis.cross(DVec3::Z));
        let outer = DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        let rotation = DMat3::IDENTITY * cos + cross * sin + outer * (1.0 - cos);
        Ok(Self { rotation, ..Self::IDENTITY })
    }

    /// The rotation of a quaternion (w, x, y, z) of any length but 0.
    ///
    /// # Errors
    /// [`Error::Numbers`] for zero, or numbers that are not finite.
    pub fn quaternion([w, x, y, z]: [f64; 4]) -> Result<Self, Error> {
        let given = DVec4::new(x, y, z, w);
        // Divided first, as by `unit`.
        let found = (given / given.abs().max_element()).try_normalize();
        let refused = || Error::Numbers("a quaternion w,x,y,z has finite numbers, not all of them 0".into());
        Ok(Self { rotation: DMat3::from_quat(DQuat::from_vec4(found.ok_or_else(refused)?)), ..Self::IDENTITY })
    }

    /// The similarity of a matrix of 3 x 4 or 4 x 4 numbers, row by row; the fourth row is 0, 0, 0, 1, but for rounding.
    /// Six digits suffice: a remaining shear is removed.
    ///
    /// # Errors
    /// [`Error::Numbers`] for another count, a number that is not finite, or another fourth row; [`Error::NotSimilar`].
    pub fn of_matrix(numbers: &[f64]) -> Result<Self, Error> {
        let count = numbers.len();
        if count != 12 && count != 16 {
            return Err(Error::Numbers(format!(
                "a matrix has 12 or 16 numbers, row by row: 3 or 4 rows of 4; these are {count}"
            )));
        }
        if let Some(bad) = numbers.iter().find(|x| !x.is_finite()) {
            return Err(Error::Numbers(format!("{bad} is not a valid matrix entry: give finite numbers")));
        }
        let mut last = numbers.iter().skip(12).zip([(0.0, NOISE), (0.0, NOISE), (0.0, NOISE), (1.0, TOLERANCE)]);
        if last.any(|(number, (due, most))| (number - due).abs() > most) {
            return Err(Error::Numbers("the fourth row of a matrix is 0, 0, 0, 1: give it row by row".into()));
        }
        // Coordinates are homogeneous.
        let weight = numbers.get(15).copied().unwrap_or(1.0);
        let row = |i: usize| DVec3::new(numbers[4 * i], numbers[4 * i + 1], numbers[4 * i + 2]) / weight;
        let linear = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let translation = DVec3::new(numbers[3], numbers[7], numbers[11]) / weight;
        let lengths = [linear.x_axis.length(), linear.y_axis.length(), linear.z_axis.length()];
        let scale = (lengths.iter().map(|l| l * l).sum::<f64>() / 3.0).sqrt();
        if !(scale.is_finite() && scale > 0.0) {
            return Err(Error::NotSimilar(lengths));
        }
        let rough = linear * (1.0 / scale);
        let off = rough.transpose() * rough - DMat3::IDENTITY;
        if off.to_cols_array().iter().any(|x| x.abs() > TOLERANCE) {
            return Err(Error::NotSimilar(lengths));
        }
        Ok(Self { rotation: orthonormal(rough), scale, translation })
    }

    /// The similarity of a text with the numbers of [`Similarity::of_matrix`], plain or as a JSON list; `#` begins a comment.
    ///
    /// # Errors
    /// [`Error::Numbers`] names a word that is not a number.
    pub fn of_text(text: &str) -> Result<Self, Error> {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default());
        let words = lines.flat_map(|line| line.split(|c: char| c.is_whitespace() || "[],;".contains(c)));
        let words = words.filter(|word| !word.is_empty());
        let forms = "write 3 or 4 rows of 4 numbers, as plain text (# begins a comment) or as a JSON list of rows";
        let number = |word: &str| {
            let what = || Error::Numbers(format!("'{}' is not a number; {forms}", shown(word, 20)));
            word.parse().map_err(|_| what())
        };
        Self::of_matrix(&words.map(number).collect::<Result<Vec<f64>, _>>()?)
    }

    /// Maps a point in world units.
    pub fn point(&self, x: DVec3) -> DVec3 {
        self.rotation * x * self.scale + self.translation
    }

    /// The map that applies this one and then `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: next.rotation * self.rotation,
            scale: next.scale * self.scale,
            translation: next.point(self.translation),
        }
    }
}

/// The direction of a vector; `None` for zero, and for numbers that are not finite. All are divided by the largest component
/// first: the squares of very large and very small numbers leave the range of float64.
fn unit(vector: DVec3) -> Option<DVec3> {
    (vector / vector.abs().max_element()).try_normalize()
}

/// The orthonormal matrix nearest to one that is nearly so (Newton's iteration for the polar factor).
fn orthonormal(matrix: DMat3) -> DMat3 {
    (0..4).fold(matrix, |m, _| (m + m.inverse().transpose()) * 0.5)
}

/// The shortest rotation from one axis to another; opposite axes are rotated about z, or about x for z itself.
///
/// # Errors
/// [`Error::Numbers`] if one has no direction.
pub fn between(from: DVec3, to: DVec3) -> Result<Similarity, Error> {
    let (Some(a), Some(b)) = (unit(from), unit(to)) else {
        return Err(Error::Numbers("an axis of length 0 has no direction".into()));
    };
    let axis = a.cross(b);
    if axis.length() > 1e-9 {
        let degrees = axis.length().atan2(a.dot(b)).to_degrees();
        // The axes of the world are turned without an error of rounding.
        return Similarity::turn(axis, if a.dot(b) == 0.0 { 90.0 } else { degrees });
    }
    if a.dot(b) > 0.0 {
        return Ok(Similarity::IDENTITY);
    }
    let upright = if a.z.abs() > 0.9 { DVec3::X } else { DVec3::Z };
    Similarity::turn(upright.reject_from(a), 180.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: DVec3, b: DVec3) {
        assert!((a - b).length() < 1e-12, "{a} {b}");
    }

    #[test]
    fn turns_follow_the_right_hand_and_are_exact_by_quarters() {
        let quarter = Similarity::turn(DVec3::Z, 90.0).unwrap();
        assert_eq!(quarter.point(DVec3::X), DVec3::Y);
        assert_eq!(Similarity::turn(DVec3::Y, -90.0).unwrap().point(DVec3::X), DVec3::Z);
        let axis = DVec3::new(1.0, 2.0, -0.5);
        let turn = Similarity::turn(axis, 37.0).unwrap();
        near(turn.point(axis), axis);
        let half = 18.5_f64.to_radians();
        let unit = axis.normalize() * half.sin();
        let same = Similarity::quaternion([2.0 * half.cos(), 2.0 * unit.x, 2.0 * unit.y, 2.0 * unit.z]).unwrap();
        near(same.point(DVec3::new(3.0, -1.0, 0.2)), turn.point(DVec3::new(3.0, -1.0, 0.2)));
        // Their lengths do not matter, also where the squares are 0 or infinite.
        let quaternion = |size: f64| Similarity::quaternion([1.0, 2.0, 3.0, 4.0].map(|q| q * size)).unwrap();
        for size in [1e-300, 1e-170, 1e-13, 1e155, 1e300] {
            near(quaternion(size).point(DVec3::ONE), quaternion(1.0).point(DVec3::ONE));
            near(Similarity::turn(axis * size, 37.0).unwrap().point(DVec3::ONE), turn.point(DVec3::ONE));
        }
    }

    #[test]
    fn two_maps_are_one() {
        let first = Similarity { scale: 2.0, translation: DVec3::X, ..Similarity::turn(DVec3::Y, 50.0).unwrap() };
        let next = Similarity { scale: 0.3, translation: DVec3::Y, ..Similarity::turn(DVec3::ONE, -70.0).unwrap() };
        let point = DVec3::new(0.5, -2.0, 3.0);
        near(first.then(&next).point(point), next.point(first.point(point)));
        assert_eq!(first.then(&Similarity::IDENTITY), first);
    }

    #[test]
    fn up_goes_to_up_and_back() {
        let axes = [DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
        for from in axes {
            for to in axes {
                let turn = between(from, to).unwrap();
                assert_eq!(turn.point(from), to, "{from} to {to}");
                assert_eq!(turn.rotation.determinant(), 1.0);
            }
        }
        near(
            between(DVec3::new(1.0, 1.0, 0.0), DVec3::Z).unwrap().point(DVec3::new(1.0, 1.0, 0.0)),
            DVec3::Z * 2_f64.sqrt(),
        );
    }

    #[test]
    fn matrices_are_read_or_refused() {
        let turn = Similarity::turn(DVec3::new(1.0, -2.0, 0.3), 77.0).unwrap();
        let rows = |m: DMat3, t: [f64; 3]| -> Vec<f64> {
            (0..3).flat_map(|i| [m.row(i).x, m.row(i).y, m.row(i).z, t[i]]).collect()
        };
        let rounded: Vec<f64> =
            rows(turn.rotation * 2.5, [1.0, 2.0, 3.0]).iter().map(|x| (x * 1e6).round() / 1e6).collect();
        let read = Similarity::of_matrix(&rounded).unwrap();
        assert!((read.scale - 2.5).abs() < 1e-6 && read.translation == DVec3::new(1.0, 2.0, 3.0));
        let off = read.rotation.transpose() * read.rotation - DMat3::IDENTITY;
        assert!(off.to_cols_array().iter().all(|x| x.abs() < 1e-14));
        let mirror = Similarity::of_matrix(&rows(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)), [0.0; 3])).unwrap();
        assert_eq!([mirror, read].map(|map| map.rotation.determinant().signum()), [-1.0, 1.0]);
        let stretched = rows(DMat3::from_diagonal(DVec3::new(1.0, 1.0, 1.01)), [0.0; 3]);
        assert!(matches!(Similarity::of_matrix(&stretched), Err(Error::NotSimilar(_))));
        assert!(matches!(Similarity::of_matrix(&[0.0; 12]), Err(Error::NotSimilar(_))));
        let small = rows(DMat3::from_diagonal(DVec3::new(1e-7, 1e-7, 1.5e-7)), [0.0; 3]);
        let said = Similarity::of_matrix(&small).unwrap_err().to_string();
        assert!(said.contains("1.00000e-7, 1.00000e-7 and 1.50000e-7"), "{said}");
        let with_last = |last: [f64; 4]| [rounded.as_slice(), &last].concat();
        let inverted = Similarity::of_matrix(&with_last([1e-17, 0.0, -1e-17, 1.0 + 1e-15])).unwrap();
        near(inverted.point(DVec3::ONE), read.point(DVec3::ONE));
        let beyond = [[0.0, 0.0, 0.0, 2.0], [1e-8, 0.0, 0.0, 1.0]].map(with_last);
        for bad in [vec![1.0; 15], vec![f64::NAN; 12]].iter().chain(&beyond) {
            assert!(matches!(Similarity::of_matrix(bad), Err(Error::Numbers(_))), "{bad:?}");
        }
        let text = "[[0, -1, 0, 1],\n[1 0;0,2e0],[0,0,1,-3]]";
        assert_eq!(Similarity::of_text(text).unwrap().point(DVec3::X), DVec3::new(1.0, 3.0, -3.0));
        let commented = "# from a scan\n0 -1 0 1\n1 0 0 2 # second\n\n 0 0 1 -3\n";
        assert_eq!(Similarity::of_text(commented), Similarity::of_text(text));
        for (text, word) in [("1 2 three", "'three'"), ("{\"matrix\": [[1, 0]]}", "'{")] {
            let said = Similarity::of_text(text).unwrap_err().to_string();
            assert!(said.contains(word) && said.contains("a JSON list of rows"), "{said}");
        }
        assert!(Similarity::scaling(0.0).is_err() && Similarity::scaling(f64::INFINITY).is_err());
        assert!(Similarity::quaternion([f64::NAN, 1.0, 0.0, 0.0]).is_err());
        assert!(Similarity::quaternion([0.0; 4]).is_err() && Similarity::turn(DVec3::ZERO, 5.0).is_err());
    }
}
