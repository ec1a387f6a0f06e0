//! Depth as a loss: a pixel whose Gaussians have shares w and depths z along the axis, and opacity A = sum of w, against a measured
//! depth d has |sum w z - d A| / d, which is also |sum w (z - d)| / d.

/// The loss of a pixel from `red` = sum w z + (1 - A) `background`, and its gradient by red and by the opacity; zeros where
/// nothing was measured.
pub fn pixel([red, alpha]: [f64; 2], background: f64, measured: f64) -> (f64, [f64; 2]) {
    if !(measured > 0.0 && measured.is_finite()) {
        return (0.0, [0.0; 2]);
    }
    let off = (red - (1.0 - alpha) * background) / measured - alpha;
    let sign = if off == 0.0 { 0.0 } else { off.signum() };
    (off.abs(), [sign / measured, sign * (background / measured - 1.0)])
}

/// The measured depth at a pixel of the part from `corner` on of a picture of the size `whole`, from a map of the whole one.
pub fn measured(map: &[f32], size: [u32; 2], (pixel, corner, whole): ([u32; 2], [u32; 2], [u32; 2])) -> f64 {
    let at = |axis: usize| {
        let middle = (f64::from(pixel[axis] + corner[axis]) + 0.5) / f64::from(whole[axis]);
        ((middle * f64::from(size[axis]) + 1e-9) as usize).min(size[axis] as usize - 1)
    };
    f64::from(map[at(1) * size[0] as usize + at(0)])
}
