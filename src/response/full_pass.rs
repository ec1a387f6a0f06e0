//! Responses and scores from one pass over all views.

use super::sums::{Rows, Sums};
use super::{CHANNELS, Gather, ResidentResponses, ResidentScores, Responses, Score};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Error, Recording, Result};
use crate::render::{
    Backward, Beside, LEAST_PAIRS, Outcome, Parts, Purpose, Settings, Source, TrainingRenderer, capacity,
};
use crate::scene::camera::{self, Camera};

/// Views whose responses and scores are added on the device, in float32. The sums of such chunks are added on the host,
/// in float64 and in their order: all machines that share the chunks of a pass get the same sums.
pub const CHUNK: usize = 16;

/// The results of a pass over all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Response channels, which need the backward pass.
    pub channels: bool,
    /// Scores, which need the picture alone.
    pub scores: bool,
    /// True if scores compare pictures with photos, where these exist.
    pub residual: bool,
}

impl Wanted {
    /// Response channels alone.
    pub const CHANNELS: Self = Self { channels: true, scores: false, residual: false };
    /// Scores alone, without photos.
    pub const SCORES: Self = Self { channels: false, scores: true, ..Self::CHANNELS };
    /// Response channels and scores.
    pub const BOTH: Self = Self { scores: true, ..Self::CHANNELS };

    /// Bytes of device memory for the results of `gaussians` Gaussians.
    pub fn bytes(self, gaussians: usize) -> u64 {
        let of = |wanted: bool, bytes: fn(usize) -> u64| if wanted { bytes(gaussians) } else { 0 };
        of(self.channels, ResidentResponses::bytes) + of(self.scores, ResidentScores::bytes)
    }

    /// Memory of a device besides the Gaussians and their renderer; `taken` bytes of it serve other purposes.
    pub fn beside(self, taken: u64) -> Beside {
        let row = |wanted: bool, bytes: usize| if wanted { bytes as u64 } else { 0 };
        let channels = row(self.channels, CHANNELS * size_of::<f32>());
        Beside { each: self.bytes(1), row: channels.max(row(self.scores, size_of::<Score>())), taken }
    }

    /// The purpose of the renderer for such a pass.
    pub fn purpose(self) -> Purpose {
        if self.channels { Purpose::Training } else { Purpose::Scores }
    }

    /// Whether a pass needs gradients of pictures, and therefore whole pictures.
    pub fn gradients(self) -> bool {
        self.channels || self.residual
    }

    /// Pixels of the gradient for pictures of at most `size`; a single unread one if no gradient is needed.
    pub fn gradient_pixels(self, size: [u32; 2]) -> usize {
        if self.gradients() { size[0] as usize * size[1] as usize } else { 1 }
    }
}

/// The function whose gradient by the picture is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// The loss; the fourth component is the residual.
    Loss,
    /// Half the sum of the squared differences to the photo, so that the gradient is the difference.
    Squares,
}

/// The views of a pass.
pub struct Views<'a, F> {
    /// Their cameras.
    pub cameras: &'a [Camera],
    /// Receives the number of views done, before each view and after the last; its error ends the pass.
    pub follow: F,
    /// The number of views that the means are taken over, if these are a chunk of at most [`CHUNK`] of them; the
    /// results are then this chunk's part of the sums, see [`Responses::sum`].
    pub of: Option<usize>,
}

/// The results of a pass, in device memory.
struct Gathered {
    responses: Option<ResidentResponses>,
    scores: Option<ResidentScores>,
}

impl Gathered {
    fn zeros(device: &Device, gaussians: usize, wanted: Wanted) -> Result<Self> {
        Ok(Self {
            responses: wanted.channels.then(|| ResidentResponses::zeros(device, gaussians)).transpose()?,
            scores: wanted.scores.then(|| ResidentScores::zeros(device, gaussians)).transpose()?,
        })
    }

    fn upload(device: &Device, rows: &Rows, wanted: Wanted) -> Result<Self> {
        Ok(Self {
            responses: wanted.channels.then(|| ResidentResponses::upload(device, &rows.channels)).transpose()?,
            scores: wanted.scores.then(|| ResidentScores::upload(device, &rows.scores)).transpose()?,
        })
    }

    fn read(&self, device: &Device, gather: Gather) -> Result<Rows> {
        let channels = self.responses.as_ref().map(|r| r.read(device, gather)).transpose()?.unwrap_or_default();
        let scores = self.scores.as_ref().map(|s| s.values.read(device)).transpose()?.unwrap_or_default();
        Ok(Rows { channels, scores })
    }
}

/// A pass over views.
struct Pass<'a, G> {
    image_gradient: &'a Buffer<[f32; 4]>,
    wanted: Wanted,
    gather: Gather,
    gradient: G,
}

impl<G> Pass<'_, G> {
    /// Adds the results of view number `v` of a model, drawn with `camera`.
    fn view<E: From<Error>>(
        &mut self,
        renderer: &mut TrainingRenderer,
        gathered: &Gathered,
        model: &Resident,
        v: usize,
        camera: &Camera,
    ) -> std::result::Result<Outcome, E>
    where
        G: FnMut(&mut Recording, usize, &Buffer<[f32; 4]>, Term) -> std::result::Result<(), E>,
    {
        let Self { image_gradient, wanted, gather, gradient } = self;
        let backward = Backward { residual: true, ..Backward::default() };
        if let Err(too_many) = Outcome::of(renderer.make_room(model, camera))? {
            return Ok(too_many);
        }
        loop {
            let mut recording = Recording::new();
            renderer.reset_overflow(&mut recording);
            renderer.record(&mut recording, model, camera);
            if let Some(responses) = &gathered.responses {
                gradient(&mut recording, v, renderer.image(), Term::Loss)?;
                renderer.record_backward(&mut recording, model, camera, image_gradient, backward);
                responses.record(&mut recording, renderer, model, camera, *gather);
            }
            if let Some(scores) = &gathered.scores {
                if wanted.residual {
                    gradient(&mut recording, v, renderer.image(), Term::Squares)?;
                }
                scores.record(&mut recording, renderer, model, camera, wanted.residual.then_some(*image_gradient));
            }
            let (_, pairs) = renderer.run(recording)?;
            // A view whose pairs did not fit has changed nothing.
            match Outcome::of(renderer.make_room_for_pairs(pairs))? {
                Ok(false) => return Ok(Outcome::Done),
                Ok(true) => {}
                Err(too_many) => return Ok(too_many),
            }
        }
    }

    /// Adds the results of all views, and tells `follow` their number before each and at the end.
    fn views<E: From<Error>>(
        mut self,
        renderer: &mut TrainingRenderer,
        model: Source<'_>,
        cameras: &[Camera],
        follow: &mut impl FnMut(usize) -> std::result::Result<(), E>,
    ) -> std::result::Result<Sums, E>
    where
        G: FnMut(&mut Recording, usize, &Buffer<[f32; 4]>, Term) -> std::result::Result<(), E>,
    {
        let device = &renderer.device().clone();
        let views: Vec<(usize, &Camera)> = cameras.iter().enumerate().collect();
        let mut sums = Sums::zeros(model.len(), self.wanted);
        match model {
            Source::Device(model) => {
                for chunk in views.chunks(CHUNK) {
                    let gathered = Gathered::zeros(device, model.len, self.wanted)?;
                    for &(v, camera) in chunk {
                        follow(v)?;
                        if let Outcome::TooMany(error) = self.view(renderer, &gathered, model, v, camera)? {
                            return Err(error.into());
                        }
                    }
                    sums.add(&gathered.read(device, self.gather)?);
                }
            }
            Source::Host(model) => {
                let mut parts = Parts::new(model, most(renderer, model, cameras, self.wanted));
                for chunk in views.chunks(CHUNK) {
                    let mut rows = Rows::zeros(model.len(), self.wanted);
                    for &(v, camera) in chunk {
                        follow(v)?;
                        parts.for_each(renderer, camera, self.wanted.gradients(), &mut |renderer, part| {
                            let gathered =
                                match Outcome::of(Gathered::upload(device, &rows.of(part.members), self.wanted))? {
                                    Ok(gathered) => gathered,
                                    Err(too_many) => return Ok(too_many),
                                };
                            let outcome = self.view(renderer, &gathered, part.model, v, &part.camera)?;
                            if matches!(outcome, Outcome::Done) {
                                rows.set(part.members, &gathered.read(device, self.gather)?);
                            }
                            Ok::<_, E>(outcome)
                        })?;
                    }
                    sums.add(&rows);
                }
            }
        }
        follow(cameras.len())?;
        Ok(sums)
    }
}

/// A renderer for [`full_pass`] over pictures of at most `size`, with an initial capacity of `pairs` (tile, Gaussian)
/// pairs. For a model on the host it grows to the largest part.
pub fn renderer(
    device: &Device,
    settings: Settings,
    model: Source<'_>,
    size: [u32; 2],
    pairs: u32,
    wanted: Wanted,
) -> Result<TrainingRenderer> {
    let (gaussians, size, pairs) = match model {
        Source::Device(model) => (model.len, size, pairs),
        Source::Host(_) => {
            let most = device.info().max_buffer_bytes / size_of::<[f32; 4]>() as u64;
            (1, [1, 1], u32::try_from(most).unwrap_or(u32::MAX).min(LEAST_PAIRS))
        }
    };
    match wanted.purpose() {
        Purpose::Training => TrainingRenderer::new(device, settings, gaussians, size, pairs),
        _ => TrainingRenderer::for_scores(device, settings, gaussians, size, pairs),
    }
}

/// The mean response over all views, one by one, and scores, as `wanted`; deterministic.
///
/// For a view and its picture, `gradient` records the gradient of a term into `image_gradient`, which has room for the
/// largest view. Squares are requested only if a residual is wanted. The model does not change. Of a model on the host,
/// each view's visible part is sent to the device; the results are the same, bit for bit. Parts of pictures then serve
/// only for scores without a residual. The renderer comes from [`renderer`] for the same `wanted`, or from a trainer.
pub fn full_pass<'m, E: From<Error>>(
    renderer: &mut TrainingRenderer,
    model: impl Into<Source<'m>>,
    Views { cameras, mut follow, of }: Views<'_, impl FnMut(usize) -> std::result::Result<(), E>>,
    image_gradient: &Buffer<[f32; 4]>,
    wanted: Wanted,
    gradient: impl FnMut(&mut Recording, usize, &Buffer<[f32; 4]>, Term) -> std::result::Result<(), E>,
) -> std::result::Result<Responses, E> {
    let gather = Gather::Mean { views: of.unwrap_or(cameras.len()) as u32 };
    renderer.make_room_for_responses()?;
    let pass = Pass { image_gradient, wanted, gather, gradient };
    let summed = pass.views(renderer, model.into(), cameras, &mut follow);
    renderer.free_responses();
    let Rows { channels, scores } = summed?.rounded();
    let dilation = renderer.settings().dilation;
    Ok(Responses { channels, scores, cameras: cameras.to_vec(), dilation })
}

/// The largest number of Gaussians in a part of a view.
fn most(renderer: &TrainingRenderer, model: &Gaussians, cameras: &[Camera], wanted: Wanted) -> usize {
    let device = renderer.device();
    let beside = wanted.beside(device.memory_used().0);
    capacity(device, model.degree(), camera::largest(cameras), renderer.uses(), beside)
}
