//! Backward of the projection: from a Gaussian's moments to the gradients by its stored parameters.
//!
//! Notation as in `project`. With Q the conic and S = sum h d d^T, dL/dcovariance2D is the symmetric matrix
//!   G = 1/2 Q S Q   [+ 1/2 (sum h) (Q0 - Q) with anti-aliasing],
//! the second term because the factor is rho = sqrt(det0 / det), alpha is proportional to rho, so dL/d ln rho = sum h, and
//! ln rho = 1/2 (ln det0 - ln det) with d ln det X / dX = X^-1; Q0 is the inverse without blur, and the term is absent where
//! det0/det sits on its floor, which also keeps Q0 = adj / det0 in range.
//! Then e = dL/dT = 2 G T (rows e0, e1), and since t0 = fx/z (V_0 - ux V_2), t1 = fy/z (V_1 - uy V_2):
//!   dL/dV_0 = fx/z e0,  dL/dV_1 = fy/z e1,  dL/dV_2 = -(fx/z ux e0 + fy/z uy e1),
//!   dL/dux = -fx/z e0 . V_2,  dL/duy = -fy/z e1 . V_2,  dL/dz at fixed ux, uy = -(e0 . t0 + e1 . t1) / z.
//! A clamped ux is a constant: x gets nothing through it, while z keeps the last term.

use glam::{DMat3, DVec2, DVec3};

use super::{
    Params, Settings,
    project::{self, Geometry},
    rasterise_backward::Moments,
    sh,
};
use crate::scene::camera::Camera;

/// Adds Gaussian `i`'s gradients to `out` (same shape as `params`); returns the gradient by its mean in pixels.
///
/// A Gaussian that the forward pass culls gets nothing.
pub fn project_backward(
    params: &Params,
    i: usize,
    camera: &Camera,
    settings: &Settings,
    moments: &Moments,
    out: &mut Params,
) -> DVec2 {
    let Ok(geometry) = project::geometry(params, i, camera, settings) else {
        return DVec2::ZERO;
    };
    let dl_dmean2d = moments.mean(geometry.projected.conic);
    let g = covariance_gradient(&geometry, settings, moments);
    let (dl_dposition, dl_daxes) = ewa_backward(&geometry, camera, dl_dmean2d, g);
    let (dl_dlog_scale, dl_dquaternion) = axes_backward(&geometry, dl_daxes);
    let dl_ddirection = colour_backward(params, i, settings, &geometry, moments.colour, out);

    let mut dl_dmean = camera.rotation.transpose() * dl_dposition;
    if settings.direction_gradient {
        dl_dmean += sh::through_normalisation(geometry.direction, geometry.distance, dl_ddirection);
    }
    add(&mut out.means[i], dl_dmean.to_array());
    add(&mut out.log_scales[i], dl_dlog_scale.to_array());
    add(&mut out.rotations[i], dl_dquaternion);
    // ln opacity = ln sigmoid + ln rho, and d ln sigmoid / d logit = 1 - sigmoid: nothing is divided by the opacity.
    out.opacity_logits[i] += moments.zeroth * project::sigmoid(-params.opacity_logits[i]);
    dl_dmean2d
}

/// G = dL/dcovariance2D as a symmetric matrix: xx, xy (each of the two), yy.
fn covariance_gradient(geometry: &Geometry, settings: &Settings, moments: &Moments) -> [f64; 3] {
    let q = geometry.projected.conic;
    let s = moments.second;
    // Q S, then half of (Q S) Q.
    let qs = [
        [q[0] * s[0] + q[1] * s[1], q[0] * s[1] + q[1] * s[2]],
        [q[1] * s[0] + q[2] * s[1], q[1] * s[1] + q[2] * s[2]],
    ];
    let mut g = [
        0.5 * (qs[0][0] * q[0] + qs[0][1] * q[1]),
        0.5 * (qs[0][0] * q[1] + qs[0][1] * q[2]),
        0.5 * (qs[1][0] * q[1] + qs[1][1] * q[2]),
    ];
    if settings.antialias && geometry.factor_free {
        let [t0, t1] = geometry.rows;
        let q0 = [t1.length_squared(), -t0.dot(t1), t0.length_squared()].map(|v| v / geometry.det0);
        for k in 0..3 {
            g[k] += 0.5 * moments.zeroth * (q0[k] - q[k]);
        }
    }
    g
}

/// Gradients by the camera-space position and by M = R diag(s).
fn ewa_backward(geometry: &Geometry, camera: &Camera, dl_dmean2d: DVec2, g: [f64; 3]) -> (DVec3, DMat3) {
    let [t0, t1] = geometry.rows;
    let (e0, e1) = (2.0 * (g[0] * t0 + g[1] * t1), 2.0 * (g[1] * t0 + g[2] * t1));
    let z = geometry.position.z;
    let zoom = camera.focal / z;
    let (f0, f1) = (zoom.x * e0, zoom.y * e1);
    let dl_dv2 = -(geometry.slope.x * f0 + geometry.slope.y * f1);
    let dl_dv = DMat3::from_cols(f0, f1, dl_dv2).transpose();

    // By x/z and y/z: through the image position always, through the Jacobian where it is not clamped.
    let free = DVec2::new(f64::from(u8::from(geometry.free[0])), f64::from(u8::from(geometry.free[1])));
    let through_jacobian = -DVec2::new(f0.dot(geometry.depth_row), f1.dot(geometry.depth_row));
    let dl_dslope = camera.focal * dl_dmean2d + free * through_jacobian;
    let slope = geometry.position.truncate() / z;
    let dl_dz = -(slope.dot(dl_dslope) + e0.dot(t0) + e1.dot(t1)) / z;
    ((dl_dslope / z).extend(dl_dz), camera.rotation.transpose() * dl_dv)
}

/// Gradients by the log scales and the stored quaternion, from those by M's columns m_k = s_k r_k.
fn axes_backward(geometry: &Geometry, dl_daxes: DMat3) -> (DVec3, [f64; 4]) {
    let log_scale = DVec3::new(
        geometry.axes.x_axis.dot(dl_daxes.x_axis),
        geometry.axes.y_axis.dot(dl_daxes.y_axis),
        geometry.axes.z_axis.dot(dl_daxes.z_axis),
    );
    let d = dl_daxes * DMat3::from_diagonal(geometry.scale); // by the rotation matrix; d.col(j)[i] is row i, column j
    let (c0, c1, c2) = (d.x_axis, d.y_axis, d.z_axis);
    let unit = geometry.quaternion;
    let [w, x, y, z] = unit;
    let by_unit = [
        2.0 * (x * (c1.z - c2.y) + y * (c2.x - c0.z) + z * (c0.y - c1.x)),
        2.0 * (w * (c1.z - c2.y) + y * (c1.x + c0.y) + z * (c2.x + c0.z)) - 4.0 * x * (c1.y + c2.z),
        2.0 * (w * (c2.x - c0.z) + x * (c1.x + c0.y) + z * (c2.y + c1.z)) - 4.0 * y * (c0.x + c2.z),
        2.0 * (w * (c0.y - c1.x) + x * (c2.x + c0.z) + y * (c2.y + c1.z)) - 4.0 * z * (c0.x + c1.y),
    ];
    let radial: f64 = (0..4).map(|k| unit[k] * by_unit[k]).sum();
    let stored = std::array::from_fn(|k| (by_unit[k] - unit[k] * radial) / geometry.quaternion_length);
    (log_scale, stored)
}

/// Adds the gradients by all SH coefficients; returns the one by the view direction.
fn colour_backward(
    params: &Params,
    i: usize,
    settings: &Settings,
    geometry: &Geometry,
    dl_dcolour: DVec3,
    out: &mut Params,
) -> DVec3 {
    let open = DVec3::from(geometry.raw_colour.to_array().map(|v| f64::from(u8::from(v > 0.0))));
    let dl_draw = dl_dcolour * open;
    let basis = sh::basis(geometry.direction);
    let by_direction = sh::basis_gradient(geometry.direction);
    let mut dl_ddirection = DVec3::ZERO;
    for l in 0..project::bands(params, settings.sh_degree) {
        for m in 0..=2 * l {
            let at = (i * (2 * l + 1) + m) * 3;
            let k = l * l + m;
            dl_ddirection += by_direction[k] * dl_draw.dot(DVec3::from_slice(&params.sh[l][at..at + 3]));
            for c in 0..3 {
                out.sh[l][at + c] += basis[k] * dl_draw[c];
            }
        }
    }
    dl_ddirection
}

fn add<const N: usize>(into: &mut [f64; N], from: [f64; N]) {
    into.iter_mut().zip(from).for_each(|(a, b)| *a += b);
}
