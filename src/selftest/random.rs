//! Embedded random models: the same numbers on every machine.

use crate::gaussians::Gaussians;
use crate::random::Random;

/// Recipe of a random model.
pub(super) struct Kind {
    pub count: usize,
    pub seed: u64,
    /// Range of each log-scale.
    pub log_scale: [f64; 2],
    /// Added to the log-scale of each axis.
    pub axes: [f64; 3],
    /// Range of the opacity logit.
    pub logit: [f64; 2],
    pub degree: usize,
    /// Range of SH coefficients of degree 0; others are a third of it around zero.
    pub colour: [f64; 2],
}

impl Kind {
    /// Gaussians in a cube of side 4 around the origin.
    pub fn model(&self) -> Gaussians {
        let mut r = Random(self.seed);
        let mut model = Gaussians { sh: vec![Vec::new(); self.degree + 1], ..Gaussians::default() };
        for _ in 0..self.count {
            model.means.push([0; 3].map(|_| r.within(-2.0, 2.0) as f32));
            model.log_scales.push(self.axes.map(|a| (r.within(self.log_scale[0], self.log_scale[1]) + a) as f32));
            model.rotations.push([0; 4].map(|_| r.within(-1.0, 1.0) as f32));
            model.opacity_logits.push(r.within(self.logit[0], self.logit[1]) as f32);
            let spread = (self.colour[1] - self.colour[0]) / 6.0;
            for (l, band) in model.sh.iter_mut().enumerate() {
                let [low, high] = if l == 0 { self.colour } else { [-spread, spread] };
                band.extend((0..Gaussians::band_width(l)).map(|_| r.within(low, high) as f32));
            }
        }
        model
    }
}
