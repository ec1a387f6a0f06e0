//! Pictures of models that the device cannot hold at once: each picture takes the Gaussians that it may show, and is
//! drawn in parts of whole tiles if even these are too many. The pixels are those of the whole model and picture, bit
//! for bit.

use super::frame::Uses;
use super::frustum;
use super::renderer::{Image, Renderer};
use super::settings::Settings;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{Device, Error, Result, staging_bytes};
use crate::scene::camera::Camera;

/// Pairs of a Gaussian and a tile that estimates assume per Gaussian. More are allowed as far as memory permits.
const PAIRS: usize = 8;

/// A model to draw.
#[derive(Clone, Copy)]
pub enum Source<'a> {
    /// A model that is completely on the device.
    Device(&'a Resident),
    /// A model on the host; the device gets the Gaussians that a picture shows.
    Host(&'a Gaussians),
}

impl<'a> From<&'a Resident> for Source<'a> {
    fn from(model: &'a Resident) -> Self {
        Self::Device(model)
    }
}

impl Source<'_> {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        match self {
            Self::Device(model) => model.len,
            Self::Host(model) => model.len(),
        }
    }

    /// Returns true if there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A part of a picture, and the Gaussians that it may show.
pub struct Part<'a> {
    /// The part.
    pub camera: Camera,
    /// Indices of its Gaussians, rising.
    pub members: &'a [u32],
    /// These Gaussians on the device.
    pub model: &'a Resident,
}

/// Outcome of a part.
#[derive(Debug)]
pub enum Outcome {
    /// The part was drawn.
    Done,
    /// The part exceeds the device's resources, for this reason; nothing has changed.
    TooMany(Error),
}

impl Outcome {
    /// Treats a lack of resources as a part that is too large, and returns any other error.
    ///
    /// # Errors
    /// Errors other than a lack of resources.
    pub fn of<T>(made: Result<T>) -> Result<std::result::Result<T, Self>> {
        match made {
            Ok(made) => Ok(Ok(made)),
            Err(error) if error.is_resources() => Ok(Err(Self::TooMany(error))),
            Err(error) => Err(error),
        }
    }
}

/// Memory of a device besides the Gaussians of a picture and their renderer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beside {
    /// Bytes per Gaussian.
    pub each: u64,
    /// Bytes per Gaussian in the widest array, included in `each`.
    pub row: u64,
    /// Bytes that serve other purposes.
    pub taken: u64,
}

/// The largest number of Gaussians of this SH degree that a device can hold and draw in pictures of `size`; 0 if not
/// even one fits.
pub fn capacity(device: &Device, degree: usize, size: [u32; 2], uses: Uses, beside: Beside) -> usize {
    let fits = |n: usize| {
        let pairs = u32::try_from(n.saturating_mul(PAIRS)).unwrap_or(u32::MAX);
        let model = Resident::bytes(n, degree) + beside.each * n as u64;
        let needed = beside.taken + model + staging_bytes(model) + Renderer::bytes(device, n, size, pairs, uses);
        widest(n, degree, uses, beside) <= device.info().max_buffer_bytes && needed <= device.memory_limit()
    };
    largest(u32::MAX as usize, fits)
}

/// The largest number up to `limit` that fits, provided that every smaller number fits too; 0 if none does.
pub fn largest(limit: usize, fits: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, limit);
    while low < high {
        let middle = low + (high - low).div_ceil(2);
        if fits(middle) {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    low
}

/// Whether the device can bind a picture of `size`, and each array of `n` Gaussians of this SH degree, of their
/// renderer and of `beside`.
pub fn binds(device: &Device, n: usize, degree: usize, size: [u32; 2], uses: Uses, beside: Beside) -> bool {
    let (limit, pixels) = (device.info().max_buffer_bytes, u64::from(size[0]) * u64::from(size[1]));
    widest(n, degree, uses, beside) <= limit && picture_bytes(pixels) <= limit
}

fn picture_bytes(pixels: u64) -> u64 {
    pixels * size_of::<[f32; 4]>() as u64
}

/// Bytes of the largest array with a row for each of `n` Gaussians.
fn widest(n: usize, degree: usize, uses: Uses, beside: Beside) -> u64 {
    let model = Attributes::widths(degree).into_array().into_iter().max().unwrap_or(0) * size_of::<f32>();
    n as u64 * beside.row.max(model.max(uses.row_bytes()) as u64)
}

/// Draws a model on the host part by part.
pub struct Parts<'a> {
    model: &'a Gaussians,
    most: usize,
    /// Parts drawn so far.
    pub drawn: u64,
}

impl<'a> Parts<'a> {
    /// Parts of at most `most` Gaussians of `model`.
    pub fn new(model: &'a Gaussians, most: usize) -> Self {
        Self { model, most, drawn: 0 }
    }

    /// Calls `body` for each part of a picture, from top to bottom and from left to right, so that the parts' tiles
    /// come in the picture's own order; a part that is too large for the device is split in two. With `whole`, the
    /// picture is the only part allowed.
    ///
    /// # Errors
    /// Errors of `body`; a single tile that is too much for the device.
    pub fn for_each<R: AsMut<Renderer>, E: From<Error>>(
        &mut self,
        renderer: &mut R,
        camera: &Camera,
        whole: bool,
        body: &mut dyn FnMut(&mut R, &Part<'_>) -> std::result::Result<Outcome, E>,
    ) -> std::result::Result<(), E> {
        let all: Vec<u32> = (0..self.model.len() as u32).collect();
        let mut open = vec![(camera.clone(), all)];
        while let Some((camera, candidates)) = open.pop() {
            let of = renderer.as_mut();
            let members = frustum::visible(self.model, &candidates, &camera, of.settings());
            drop(candidates);
            let halves = if whole { None } else { halves(&camera, of.tile()) };
            if halves.is_none() || self.fits(of, &camera, members.len()) {
                let picked: Vec<usize> = members.iter().map(|i| *i as usize).collect();
                let outcome = match Outcome::of(Resident::upload(of.device(), &self.model.select(&picked)))? {
                    Err(too_many) => too_many,
                    Ok(model) => {
                        let part = Part { camera: camera.clone(), members: &members, model: &model };
                        body(renderer, &part)?
                    }
                };
                match (outcome, &halves) {
                    (Outcome::Done, _) => {
                        self.drawn += 1;
                        continue;
                    }
                    (Outcome::TooMany(error), None) => return Err(error.into()),
                    (Outcome::TooMany(_), Some(_)) => {}
                }
            }
            let [first, second] = halves.expect("what cannot be halved was drawn");
            open.push((second, members.clone()));
            open.push((first, members));
        }
        Ok(())
    }

    /// Whether the device can hold a picture of this many Gaussians, as far as this is known before it is drawn.
    fn fits(&self, renderer: &Renderer, camera: &Camera, gaussians: usize) -> bool {
        gaussians <= self.most && picture_bytes(camera.pixels()) <= renderer.device().info().max_buffer_bytes
    }

    /// Draws a picture.
    pub fn render(&mut self, renderer: &mut Renderer, camera: &Camera) -> Result<Image> {
        let (width, height) = (camera.width, camera.height);
        let mut image = Image { width, height, pixels: vec![[0.0; 4]; width as usize * height as usize] };
        let outer = camera.whole().corner;
        self.for_each(renderer, camera, false, &mut |renderer, part| {
            if let Err(too_many) = Outcome::of(renderer.make_room(part.model, &part.camera))? {
                return Ok(too_many);
            }
            loop {
                let (_, pairs) = renderer.draw_counted(part.model, &part.camera)?;
                match Outcome::of(renderer.make_room_for_pairs(pairs))? {
                    Ok(false) => break,
                    Ok(true) => {}
                    Err(too_many) => return Ok(too_many),
                }
            }
            let drawn = renderer.read_image(&part.camera)?;
            let corner = part.camera.whole().corner;
            let (left, top) = ((corner[0] - outer[0]) as usize, (corner[1] - outer[1]) as usize);
            for (row, pixels) in drawn.pixels.chunks_exact(drawn.width as usize).enumerate() {
                let at = (top + row) * width as usize + left;
                image.pixels[at..at + pixels.len()].copy_from_slice(pixels);
            }
            Ok::<_, Error>(Outcome::Done)
        })?;
        Ok(image)
    }
}

/// Two halves of a picture, each of whole tiles: upper and lower rows of tiles, or, for a single row, left and right
/// tiles; `None` for a single tile.
fn halves(camera: &Camera, tile: u32) -> Option<[Camera; 2]> {
    let Camera { width, height, .. } = *camera;
    let middle = |length: u32| (length > tile).then(|| length.div_ceil(tile) / 2 * tile);
    if let Some(y) = middle(height) {
        return Some([camera.part([0, 0], [width, y]), camera.part([0, y], [width, height - y])]);
    }
    let x = middle(width)?;
    Some([camera.part([0, 0], [x, height]), camera.part([x, 0], [width - x, height])])
}

/// Draws pictures of a model on the device or on the host.
pub struct Painter {
    renderer: Renderer,
    most: usize,
}

impl Painter {
    /// A painter of models on the device with up to `gaussians` Gaussians, in pictures of at most `size`.
    pub fn new(device: &Device, settings: Settings, gaussians: usize, size: [u32; 2]) -> Result<Self> {
        Ok(Self { renderer: Renderer::new(device, settings, gaussians, size[0], size[1])?, most: gaussians })
    }

    /// A painter of a model, in pictures of at most `size`.
    pub fn of(device: &Device, settings: Settings, model: Source<'_>, size: [u32; 2]) -> Result<Self> {
        match model {
            Source::Device(model) => Self::new(device, settings, model.len, size),
            Source::Host(model) => {
                let uses = Uses { style: settings.style, ..Uses::default() };
                let beside = Beside { taken: device.memory_used().0, ..Beside::default() };
                let most = capacity(device, model.degree(), size, uses, beside);
                // The renderer grows to the largest part drawn.
                Ok(Self { most, ..Self::new(device, settings, 1, [1, 1])? })
            }
        }
    }

    /// A painter whose renderer is one [`Renderer::with_medians`].
    #[must_use]
    pub fn with_medians(self) -> Self {
        Self { renderer: self.renderer.with_medians(), ..self }
    }

    /// Draws a picture.
    pub fn render(&mut self, model: Source<'_>, camera: &Camera) -> Result<Image> {
        match model {
            Source::Device(model) => self.renderer.render(model, camera),
            Source::Host(model) => Parts::new(model, self.most).render(&mut self.renderer, camera),
        }
    }

    /// The renderer, for models on the device.
    pub fn renderer(&mut self) -> &mut Renderer {
        &mut self.renderer
    }
}

#[cfg(test)]
mod tests {
    use super::largest;

    #[test]
    fn the_largest_that_fits() {
        for right in 0..=20 {
            assert_eq!(largest(20, |n| n <= right), right);
        }
        assert_eq!((largest(0, |_| true), largest(0, |_| false)), (0, 0));
    }
}
