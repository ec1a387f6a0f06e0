//! A similarity of all Gaussians of a model.

use super::{Error, Similarity};
use crate::gaussians::Gaussians;
use rayon::prelude::*;

/// Applies a similarity about the world's origin to a model; in float64, rounded once.
pub(super) fn transform(model: &mut Gaussians, by: &Similarity) -> Result<(), Error> {
    model.transform(by.rotation, by.scale, by.translation);
    let finite = |values: &[f32; 3]| values.iter().all(|x| x.is_finite());
    let lost = model.means.par_iter().zip(&model.log_scales).filter(|(mean, scales)| !(finite(mean) && finite(scales)));
    match lost.count() {
        0 => Ok(()),
        count => Err(Error::Overflow { count, of: model.len() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::Edit;
    use crate::random::Random;
    use glam::{DMat3, DQuat, DVec3};

    /// The covariance of Gaussian 0.
    fn covariance(model: &Gaussians) -> DMat3 {
        let [w, x, y, z] = model.rotations[0].map(f64::from);
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scales = DVec3::from_array(model.log_scales[0].map(|s| f64::from(s).exp()));
        axes * DMat3::from_diagonal(scales * scales) * axes.transpose()
    }

    /// The twin: A covariance A^T with the whole matrix A of the map, including reflections.
    #[test]
    fn ellipsoids_move_as_their_matrices_do() {
        let mut random = Random(3);
        for case in 0..30 {
            let mut model = Gaussians::zeroed(1, 0);
            model.means[0] = [0, 1, 2].map(|_| random.within(-2.0, 2.0) as f32);
            model.log_scales[0] = [0, 1, 2].map(|_| random.within(-2.0, 1.0) as f32);
            model.rotations[0] = [0; 4].map(|_| random.within(-1.0, 1.0) as f32);
            let axis = DVec3::from_array([0; 3].map(|_| random.within(-1.0, 1.0)));
            let mut by = Similarity::turn(axis, random.within(-180.0, 180.0)).unwrap();
            by.scale = random.within(0.2, 5.0);
            by.translation = axis * 7.0;
            if case % 3 == 0 {
                by.rotation *= DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
            }
            let (before, mean) = (covariance(&model), DVec3::from_array(model.means[0].map(f64::from)));
            let length: f32 = model.rotations[0].iter().map(|q| q * q).sum();
            Edit::Transform(by).apply(&mut model).unwrap();
            let matrix = by.rotation * by.scale;
            let off = covariance(&model) - matrix * before * matrix.transpose();
            let most = before.to_cols_array().iter().fold(0.0_f64, |m, x| m.max(x.abs())) * by.scale * by.scale;
            assert!(off.to_cols_array().iter().all(|x| x.abs() < 3e-6 * most), "{off}");
            let moved = DVec3::from_array(model.means[0].map(f64::from));
            assert!((moved - (matrix * mean + by.translation)).length() < 1e-5);
            let after: f32 = model.rotations[0].iter().map(|q| q * q).sum();
            assert!((after / length - 1.0).abs() < 1e-5, "quaternions keep their length");
        }
    }

    #[test]
    fn identity_changes_no_bit_and_overflow_is_an_error() {
        let mut model = Gaussians::zeroed(3, 2);
        model.means = vec![[1e-30, 0.1, 3e38]; 3];
        let same = model.clone();
        Edit::Transform(Similarity::IDENTITY).apply(&mut model).unwrap();
        assert_eq!(model, same);
        let huge = Similarity::scaling(10.0).unwrap();
        assert_eq!(Edit::Transform(huge).apply(&mut model), Err(Error::Overflow { count: 3, of: 3 }));
    }
}
