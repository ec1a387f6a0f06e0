//! Scores of each Gaussian, for one view.

use glam::DVec3;

use super::{Params, Rendered, Settings, rasterise::walk, render};
use crate::scene::camera::Camera;

/// Scores of a Gaussian in a view; see [`crate::response::Score`] for each of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Sum of w = T alpha, its largest, the pixels that blend the Gaussian, the sum of opacity x T.
    pub weights: [f64; 4],
    /// Sums of w^2, of |phi|^2, and of phi . residual.
    pub changes: [f64; 3],
    /// Sum of w b, b the colour behind.
    pub behind: [f64; 3],
}

/// Scores of a view, n. `residual` is the picture minus its photo, by pixel.
pub fn score(params: &Params, camera: &Camera, settings: &Settings, residual: &[[f64; 3]]) -> Vec<Score> {
    let Rendered { projected, tiles, composite } = render(params, camera, settings);
    let mut scores = vec![Score::default(); params.len()];
    for t in 0..tiles.offsets.len() - 1 {
        let list = tiles.list(t);
        let (columns, rows) = tiles.pixels(t, camera.width, camera.height);
        for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
            let at = (y * camera.width + x) as usize;
            let (mut behind, residual) = (DVec3::from(composite.image[at]), DVec3::from(residual[at]));
            walk(list, &projected, (x, y), settings, |k, p, s, transmittance| {
                let score = &mut scores[list[k] as usize];
                let w = transmittance * s.alpha;
                behind -= w * p.colour;
                let seen_behind = behind * (s.alpha / (1.0 - s.alpha));
                let phi = w * p.colour - seen_behind;
                let [contribution, peak, hits, significance] = &mut score.weights;
                *contribution += w;
                *peak = peak.max(w);
                *hits += 1.0;
                *significance += p.opacity * transmittance;
                for (sum, term) in score.changes.iter_mut().zip([w * w, phi.length_squared(), phi.dot(residual)]) {
                    *sum += term;
                }
                for (sum, term) in score.behind.iter_mut().zip(seen_behind.to_array()) {
                    *sum += term;
                }
            });
        }
    }
    scores
}
