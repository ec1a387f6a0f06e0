//! A second float64 twin of the overlap, exact to about 1e-9 for scales floored at a thousandth. `reference::overlap`
//! uses the device's own method, Householder QR; this one uses modified Gram-Schmidt, applied twice, and shares no code
//! with either, so that an error of the method would show. It also supports dilation.

use glam::{DMat3, DQuat, DVec3};

/// One Gaussian in float64.
#[derive(Clone, Copy, Debug)]
pub struct Twin {
    pub mean: DVec3,
    pub scale: DVec3,
    pub rotation: DMat3,
}

impl Twin {
    /// A twin of stored values; scales are floored at `floor` of the largest, and before that dilated.
    pub fn new(mean: [f32; 3], log_scale: [f32; 3], q: [f32; 4], floor: f64, dilation: f64) -> Self {
        let q = q.map(f64::from);
        let rotation = DMat3::from_quat(DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize());
        let scale = DVec3::from(log_scale.map(|s| f64::from(s).exp().hypot(dilation)));
        let scale = scale.max(DVec3::splat(floor * scale.max_element()));
        Self { mean: DVec3::from(mean.map(f64::from)), scale, rotation }
    }

    /// Modified Gram-Schmidt, applied twice, of the stacked 6 x 3 matrix of scaled axes in the frame of `self`.
    pub fn overlap(&self, other: &Self) -> f64 {
        let unit = self.scale.max_element().max(other.scale.max_element());
        let (a, b) = (self.scale / unit, other.scale / unit);
        let relative = other.rotation.transpose() * self.rotation;
        let mut columns: [[f64; 6]; 3] = std::array::from_fn(|k| {
            let low = relative.col(k) * b;
            let mut column = [0.0, 0.0, 0.0, low.x, low.y, low.z];
            column[k] = a[k];
            column
        });
        let y = self.rotation.transpose() * ((self.mean - other.mean) / unit);
        let mut order = [0, 1, 2];
        order.sort_by(|i, j| a[*j].total_cmp(&a[*i]));
        let dot = |u: &[f64; 6], v: &[f64; 6]| -> f64 { u.iter().zip(v).map(|(a, b)| a * b).sum() };
        let (mut z, mut log_norms) = ([0.0; 3], 0.0);
        let mut done: Vec<[f64; 6]> = Vec::new();
        for (n, k) in order.into_iter().enumerate() {
            let mut right = y[k];
            for _ in 0..2 {
                for (p, q) in done.iter().enumerate() {
                    let r = dot(&columns[k], q);
                    columns[k].iter_mut().zip(q).for_each(|(c, q)| *c -= r * q);
                    right -= r * z[p];
                }
            }
            let norm = dot(&columns[k], &columns[k]).sqrt();
            z[n] = right / norm;
            log_norms += norm.ln();
            done.push(columns[k].map(|c| c / norm));
        }
        let logs = 0.5 * (a.to_array().iter().chain(&b.to_array()).map(|s| s.ln()).sum::<f64>());
        (1.5 * 2_f64.ln() + logs - log_norms - 0.5 * z.iter().map(|z| z * z).sum::<f64>()).exp().min(1.0)
    }
}
