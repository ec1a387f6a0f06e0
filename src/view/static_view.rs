//! Draws requests with models that do not change.

use super::painter::{Drawn, PaintInput, Painter};
use super::protocol::{Picture, Request};
use super::subject::{Model, Subject};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::render::Settings;

/// A reduced picture draws one in this many Gaussians: those with the largest product of opacity and area.
const REDUCED: usize = 4;
/// Smallest model that is worth reducing.
const LEAST_REDUCED: usize = 20_000;
/// Drawing time, in milliseconds, of a whole moving picture above which moving pictures are reduced.
const SLOW_MS: f32 = 45.0;
/// Estimated drawing time, in milliseconds, of a whole picture below which moving pictures are whole again.
const FAST_MS: f32 = 40.0;

struct ViewerModel {
    /// Draws the model in its own style.
    painter: Painter,
    whole: Resident,
    /// Its most visible quarter, for moving pictures on slow devices.
    reduced: Option<Resident>,
    /// True if moving pictures are reduced: on slow devices the time depends on the number of Gaussians, hardly on
    /// pixels.
    reduce: bool,
}

/// The device's side of the viewer.
pub struct StaticView<'a> {
    subject: &'a Subject,
    shown: Vec<ViewerModel>,
}

/// One in [`REDUCED`] of the Gaussians, those with the largest product of opacity and area, in their order.
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

impl<'a> StaticView<'a> {
    /// A static view with all models of the subject on the device.
    pub fn new(device: &Device, subject: &'a Subject) -> Result<Self, Error> {
        let shown = |shown: &Model| -> Result<ViewerModel, Error> {
            let usual = shown.style.over(subject.background);
            let settings = Settings { near: subject.near(usual.near), ..usual };
            let mut model = shown.gaussians.clone();
            // As in `render`: bands that change no colour by a step of eight bits are not drawn.
            model.sh.truncate(model.degree_in_effect() + 1);
            let whole = Resident::upload(device, &model)?;
            let reduced = (model.len() >= LEAST_REDUCED).then(|| most_visible(&model));
            let reduced = reduced.map(|m| Resident::upload(device, &m)).transpose()?;
            Ok(ViewerModel { painter: Painter::new(device, settings, model.len())?, whole, reduced, reduce: false })
        };
        let shown = subject.models.iter().map(shown).collect::<Result<_, _>>()?;
        Ok(Self { subject, shown })
    }

    /// Draws a request.
    ///
    /// # Errors
    /// [`Error::Usage`] for requests that cannot be fulfilled; device errors.
    pub fn draw(&mut self, request: &Request) -> Result<Drawn, Error> {
        let other = (0..self.shown.len()).find(|m| *m != request.model).filter(|_| request.picture == Picture::Error);
        let other = other
            .map(|m| &mut self.shown[m])
            .map(|o| o.painter.colours(self.subject, &o.whole, request))
            .transpose()?;
        let (Some(ViewerModel { painter, whole, reduced, reduce }), Some(model)) =
            (self.shown.get_mut(request.model), self.subject.models.get(request.model))
        else {
            return Err(Error::Usage(format!("there is no model {}", request.model)));
        };
        let reduced = reduced.as_ref().filter(|_| *reduce && !request.still);
        let facts = model.facts.as_ref();
        let input = PaintInput { whole, reduced, other: other.as_deref(), facts, fixed: true, iteration: 0 };
        let drawn = painter.draw(self.subject, input, request)?;
        if !request.still && request.picture == Picture::Colour {
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
