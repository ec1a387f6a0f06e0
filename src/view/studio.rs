//! Draws wishes for models that do not change.

use super::easel::{Drawn, Easel, Sitter};
use super::protocol::{Picture, Wish};
use super::subject::{Model, Subject};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::pipeline::Error;
use crate::render::Settings;

/// One Gaussian in this many is drawn in a reduced picture: those of the largest product of opacity and area.
const REDUCED: usize = 4;
/// Smallest model that is worth reducing.
const LEAST_REDUCED: usize = 20_000;
/// Milliseconds of a whole moving picture beyond which moving pictures are reduced.
const SLOW_MS: f32 = 45.0;
/// Milliseconds that a whole picture is estimated at, below which moving pictures are whole again.
const FAST_MS: f32 = 40.0;

/// A model on the device.
struct Shown {
    /// Draws it in its own style.
    easel: Easel,
    whole: Resident,
    /// Its most visible quarter, for moving pictures on slow devices.
    reduced: Option<Resident>,
    /// True if moving pictures are reduced: slow devices take a time for each Gaussian, hardly for each pixel.
    reduce: bool,
}

/// The device's side of the viewer.
pub struct Studio<'a> {
    subject: &'a Subject,
    shown: Vec<Shown>,
}

/// The Gaussians of the largest product of opacity and area, one in [`REDUCED`], in their order.
fn most_visible(model: &Gaussians) -> Gaussians {
    let size = |i: usize| {
        let mut scales = model.log_scales[i];
        scales.sort_by(f32::total_cmp);
        let opacity = -(-model.opacity_logits[i]).exp().ln_1p();
        scales[1] + scales[2] + opacity
    };
    let mut order: Vec<usize> = (0..model.len()).collect();
    let kept = model.len().div_ceil(REDUCED);
    if kept < order.len() {
        order.select_nth_unstable_by(kept, |a, b| size(*b).total_cmp(&size(*a)).then(a.cmp(b)));
    }
    order.truncate(kept);
    order.sort_unstable();
    model.select(&order)
}

impl<'a> Studio<'a> {
    /// A studio with all models of the subject on the device.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn new(device: &Device, subject: &'a Subject) -> Result<Self, Error> {
        let near = subject.near();
        let shown = |shown: &Model| -> Result<Shown, Error> {
            let usual = shown.style.over(subject.background);
            let settings = Settings { near: usual.near.min(near), ..usual };
            let mut model = shown.gaussians.clone();
            // As `render` does: bands that change no colour by a step of eight bits are not drawn.
            model.sh.truncate(model.degree_in_effect() + 1);
            let whole = Resident::upload(device, &model)?;
            let reduced = (model.len() >= LEAST_REDUCED).then(|| most_visible(&model));
            let reduced = reduced.map(|m| Resident::upload(device, &m)).transpose()?;
            Ok(Shown { easel: Easel::new(device, settings, model.len())?, whole, reduced, reduce: false })
        };
        let shown = subject.models.iter().map(shown).collect::<Result<_, _>>()?;
        Ok(Self { subject, shown })
    }

    /// Draws a wish.
    ///
    /// # Errors
    /// [`Error::Usage`] for wishes that cannot be fulfilled; device errors.
    pub fn draw(&mut self, wish: &Wish) -> Result<Drawn, Error> {
        let other = (0..self.shown.len()).find(|m| *m != wish.model).filter(|_| wish.picture == Picture::Error);
        let other =
            other.map(|m| &mut self.shown[m]).map(|o| o.easel.colours(self.subject, &o.whole, wish)).transpose()?;
        let (Some(Shown { easel, whole, reduced, reduce }), Some(model)) =
            (self.shown.get_mut(wish.model), self.subject.models.get(wish.model))
        else {
            return Err(Error::Usage(format!("there is no model {}", wish.model)));
        };
        let reduced = reduced.as_ref().filter(|_| *reduce && !wish.still);
        let facts = model.facts.as_ref();
        let sitter = Sitter { whole, reduced, other: other.as_deref(), facts, fixed: true, iteration: 0 };
        let drawn = easel.draw(self.subject, sitter, wish)?;
        if !wish.still && wish.picture == Picture::Colour {
            let ms = drawn.header.draw_ms;
            *reduce = if drawn.header.reduced { ms * REDUCED as f32 > FAST_MS } else { ms > SLOW_MS };
        }
        Ok(drawn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_visible_quarter_is_large_and_opaque() {
        let mut model = Gaussians::zeroed(100, 0);
        for i in 0..100 {
            model.means[i] = [i as f32, 0.0, 0.0];
            model.log_scales[i] = [-9.0, if i % 2 == 0 { 0.0 } else { -2.0 }, -1.0];
            model.opacity_logits[i] = if i % 4 < 2 { 2.0 } else { -5.0 };
        }
        let kept: Vec<f32> = most_visible(&model).means.iter().map(|m| m[0]).collect();
        assert_eq!(kept, (0..25).map(|i| (4 * i) as f32).collect::<Vec<_>>());
        assert_eq!(most_visible(&Gaussians::zeroed(1, 0)).len(), 1);
    }
}
