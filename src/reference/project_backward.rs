//! Backward pass of the projection: from a Gaussian's sums to the gradients by its stored parameters.
//!
//! Notation as in `project`. With Q the conic and S = sum h d d^T, dL/dcovariance2D is the symmetric matrix
//!   G = 1/2 Q S Q   [+ 1/2 (sum h) (Q0 - Q) with anti-aliasing].
//! The second term comes from the factor rho = sqrt(det0 / det): alpha is proportional to it, so dL/d ln rho = sum h, and
//! ln rho = 1/2 (ln det0 - ln det) with d ln det X / dX = X^-1. Q0 is the inverse without dilation. The term is absent where
//! det0/det is at its floor, which also keeps Q0 = adj / det0 in range.
//!
//! dL/dT = 2 G T, but Q T of a needle cancels: its error grows with the square of the needle's length in pixels. With Q = K^T K,
//! K = (kx ky; 0 kz) = (sqrt(yy/det), -xy/yy sqrt(yy/det); 0, 1/sqrt(yy)), and W = K T, whose columns are no longer than 1,
//!   dL/dT = K^T E,  E = (K S K^T) W   [+ d (sum h) K Q0 T],   since Q0 - Q = Q (d I) Q0,
//!   W_0 = kx (t1 x (t0 x t1) + d t0) / yy,  W_1 = kz t1,  Q0 T = (t1 x n; n x t0) / det0 with n = t0 x t1.
//! For column k, dL/d ln s_k = E_k . W_k; a rotation w of the axes in their own frame has dL/dw = sum over rows of
//! (s E) x (W / s),
//! and the quaternion's gradient is 2 q (0, dL/dw). Since t0 = fx/z (V_0 - ux V_2), t1 = fy/z (V_1 - uy V_2):
//!   dL/dux = -fx/z e0 . V_2,  dL/duy = -fy/z e1 . V_2,  dL/dz at fixed ux, uy = -(sum of dL/d ln s_k) / z,  e = K^T E.
//! A clamped ux is a constant: x gets no gradient through it, while z keeps the last term.

use glam::{DVec2, DVec3};

use super::{
    Params, Settings,
    project::{self, Geometry},
    rasterise_backward::SlotSums,
};
use crate::gaussians::sh;
use crate::scene::camera::Camera;

/// Adds Gaussian `i`'s gradients to `out` (same shape as `params`); returns the gradient by its mean in pixels.
///
/// A Gaussian that the forward pass culls gets no gradient.
pub fn project_backward(
    params: &Params,
    i: usize,
    camera: &Camera,
    settings: &Settings,
    sums: &SlotSums,
    out: &mut Params,
) -> DVec2 {
    let Ok(geometry) = project::geometry(params, i, camera, settings) else {
        return DVec2::ZERO;
    };
    let dl_dmean2d = sums.mean(geometry.projected.conic);
    let whitened = whiten(&geometry, settings, sums);
    let (dl_dlog_scale, dl_dquaternion) = axes_backward(&geometry, &whitened);
    let dl_dposition = ewa_backward(&geometry, camera, dl_dmean2d, &whitened, dl_dlog_scale);
    let dl_ddirection = colour_backward(params, i, settings, &geometry, sums.colour, out);

    let mut dl_dmean = camera.rotation.transpose() * dl_dposition;
    if settings.direction_gradient {
        dl_dmean += sh::through_normalisation(geometry.direction, geometry.distance, dl_ddirection);
    }
    add(&mut out.means[i], dl_dmean.to_array());
    add(&mut out.log_scales[i], dl_dlog_scale.to_array());
    add(&mut out.rotations[i], dl_dquaternion);
    // ln opacity = ln sigmoid + ln rho, and d ln sigmoid / d logit = 1 - sigmoid: nothing is divided by the opacity.
    out.opacity_logits[i] += sums.zeroth * project::sigmoid(-params.opacity_logits[i]);
    dl_dmean2d
}

/// K, and the rows of W and E.
struct Whitened {
    k: [f64; 3],
    w: [DVec3; 2],
    e: [DVec3; 2],
}

fn whiten(geometry: &Geometry, settings: &Settings, sums: &SlotSums) -> Whitened {
    let [t0, t1] = geometry.rows;
    let [xx, xy, yy] = geometry.projected.covariance;
    let dilation = settings.dilation;
    let det = geometry.det0 + dilation * (xx - dilation + yy - dilation) + dilation * dilation;
    let kx = (yy / det).sqrt();
    let [ky, kz] = [-(xy / yy) * kx, yy.sqrt().recip()];
    let normal = t0.cross(t1);
    let w = [kx * (t1.cross(normal) + dilation * t0) / yy, kz * t1];
    // K S, then (K S) K^T.
    let s = sums.second;
    let ks = [kx * s[0] + ky * s[1], kx * s[1] + ky * s[2], kz * s[1], kz * s[2]];
    let second = [kx * ks[0] + ky * ks[1], kz * ks[1], kz * ks[3]];
    let mut e = [second[0] * w[0] + second[1] * w[1], second[1] * w[0] + second[2] * w[1]];
    if settings.antialias && geometry.factor_free {
        let inverse = [t1.cross(normal) / geometry.det0, normal.cross(t0) / geometry.det0];
        e[0] += dilation * sums.zeroth * (kx * inverse[0] + ky * inverse[1]);
        e[1] += dilation * sums.zeroth * kz * inverse[1];
    }
    Whitened { k: [kx, ky, kz], w, e }
}

/// Gradient by the camera-space position.
fn ewa_backward(
    geometry: &Geometry,
    camera: &Camera,
    dl_dmean2d: DVec2,
    whitened: &Whitened,
    dl_dlog_scale: DVec3,
) -> DVec3 {
    let Whitened { k: [kx, ky, kz], e, .. } = whitened;
    let z = geometry.position.z;
    let along = e.map(|row| row.dot(geometry.depth_row));
    // By x/z and y/z: always through the image position; through the Jacobian only where it is not clamped.
    let free = DVec2::new(f64::from(u8::from(geometry.free[0])), f64::from(u8::from(geometry.free[1])));
    let through_jacobian = -DVec2::new(kx * along[0], ky * along[0] + kz * along[1]) / z;
    let dl_dslope = camera.focal * (dl_dmean2d + free * through_jacobian);
    let slope = geometry.position.truncate() / z;
    let dl_dz = -(slope.dot(dl_dslope) + dl_dlog_scale.element_sum()) / z;
    (dl_dslope / z).extend(dl_dz)
}

/// Gradients by the log scales and the stored quaternion.
fn axes_backward(geometry: &Geometry, whitened: &Whitened) -> (DVec3, [f64; 4]) {
    let (w, e, s) = (whitened.w, whitened.e, geometry.scale);
    let log_scale = e[0] * w[0] + e[1] * w[1];
    let least = s.max(DVec3::splat(f64::MIN_POSITIVE)); // an axis of zero length has no gradient by its rotation
    let spin = (e[0] * s).cross(w[0] / least) + (e[1] * s).cross(w[1] / least);
    let [real, x, y, z] = geometry.quaternion;
    let imaginary = DVec3::new(x, y, z);
    let by_unit = (real * spin + imaginary.cross(spin)).to_array();
    let quaternion = [-imaginary.dot(spin), by_unit[0], by_unit[1], by_unit[2]];
    (log_scale, quaternion.map(|g| 2.0 * g / geometry.quaternion_length))
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
