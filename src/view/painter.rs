//! Draws one request with a model on the device, for any owner of that model.

use super::paint;
use super::protocol::{Encoding, Figure, Header, MOST_PIXELS, Picture, Request, RequestCamera};
use super::subject::{Capture, Subject};
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::job::Error;
use crate::job::diagnostics::Diagnostics;
use crate::pipeline::evaluate::{hide, rgb, truth, weights};
use crate::render::{Image, Renderer, Settings};
use crate::scene::Photo;
use crate::scene::camera::Camera;
use std::time::Instant;

/// The inputs of a picture.
#[derive(Clone, Copy)]
pub struct PaintInput<'a> {
    pub whole: &'a Resident,
    /// Its most visible part, which replaces it in this picture of colours.
    pub reduced: Option<&'a Resident>,
    /// Red, green, blue of the other model's picture, the reference of an error picture at a free camera.
    pub other: Option<&'a [f32]>,
    /// Diagnostics of its prune.
    pub facts: Option<&'a Diagnostics>,
    /// True if the model does not change, so that it is coloured only once.
    pub fixed: bool,
    /// Iteration of the run; 0 without one.
    pub iteration: u32,
}

/// A finished picture.
pub struct Drawn {
    /// The header sent before the picture.
    pub header: Header,
    pub image: Image,
}

/// A renderer, with state kept from request to request.
pub struct Painter {
    device: Device,
    renderer: Renderer,
    /// The background that the model was trained on, or is shown on.
    background: [f32; 3],
    /// The photo compared with last.
    photo: Option<(usize, Photo)>,
    /// The unchanging model in its last false colours.
    painted: Option<(Picture, Resident)>,
}

impl Painter {
    /// A painter for models of up to `gaussians` Gaussians; it grows with pictures and models.
    pub fn new(device: &Device, settings: Settings, gaussians: usize) -> Result<Self, Error> {
        let renderer = Renderer::new(device, settings, gaussians, 64, 64)?;
        Ok(Self { device: device.clone(), renderer, background: settings.background, photo: None, painted: None })
    }

    /// Draws a request.
    ///
    /// # Errors
    /// [`Error::Usage`] for requests that cannot be fulfilled; device errors.
    pub fn draw(&mut self, subject: &Subject, input: PaintInput<'_>, request: &Request) -> Result<Drawn, Error> {
        let camera = camera(request, subject.capture.as_ref())?;
        let begun = Instant::now();
        self.renderer.set_background(match request.picture {
            Picture::Colour => request.background.unwrap_or(self.background),
            Picture::Error => self.background,
            _ => [0.0; 3],
        });
        let reduced = input.reduced.filter(|_| request.picture == Picture::Colour);
        let model = reduced.unwrap_or(input.whole);
        let mut figure = Figure::None;
        let image = match request.picture {
            Picture::Colour if request.degree < model.degree => {
                self.renderer.render(&paint::of_degree(&self.device, model, request.degree)?, &camera)?
            }
            Picture::Colour => self.renderer.render(model, &camera)?,
            Picture::Alpha => paint::alpha_picture(self.renderer.render(model, &camera)?),
            Picture::Depth => {
                let colours = paint::depths(&self.means(model)?, &camera).0;
                let painted = paint::painted(&self.device, model, &colours)?;
                paint::depth_picture(self.renderer.render(&painted, &camera)?)
            }
            Picture::Blocks | Picture::Kept | Picture::Score | Picture::Participation | Picture::Guards => {
                let painted = self.painted(input, request.picture)?;
                let image = self.renderer.render(&painted, &camera)?;
                self.painted = input.fixed.then_some((request.picture, painted));
                image
            }
            Picture::Count => {
                let counts = self.renderer.count_blended(model, &camera)?;
                let (picture, mean) = paint::count_picture([camera.width, camera.height], &counts);
                figure = Figure::Blended(mean);
                picture
            }
            Picture::Error => {
                let image = self.renderer.render(model, &camera)?;
                let mut rendered = rgb(&image);
                let (truth, weights) = self.truth(subject, input, request)?;
                hide(&mut rendered, weights.as_deref(), self.background);
                let (picture, db) = paint::error_picture(image, &rendered, &truth, weights.as_deref())?;
                figure = db.map_or(Figure::None, Figure::Psnr);
                picture
            }
        };
        let header = Header {
            // The false colours of other pictures encode numbers, which JPEG would change.
            encoding: if request.still || request.picture != Picture::Colour { Encoding::Png } else { Encoding::Jpeg },
            reduced: reduced.is_some(),
            size: [image.width, image.height],
            number: request.number,
            draw_ms: begun.elapsed().as_secs_f32() * 1e3,
            iteration: input.iteration,
            gaussians: model.len as u32,
            figure,
        };
        Ok(Drawn { header, image })
    }

    /// Red, green, blue of each pixel of the model's picture.
    pub fn colours(&mut self, subject: &Subject, model: &Resident, request: &Request) -> Result<Vec<f32>, Error> {
        self.renderer.set_background(self.background);
        let image = self.renderer.render(model, &camera(request, subject.capture.as_ref())?)?;
        Ok(image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect())
    }

    /// The model in colours that do not depend on the camera.
    fn painted(&mut self, input: PaintInput<'_>, picture: Picture) -> Result<Resident, Error> {
        match self.painted.take() {
            Some((of, painted)) if of == picture && input.fixed => return Ok(painted),
            _ => {}
        }
        let colours = match input.facts.and_then(|facts| paint::told(picture, facts)) {
            Some(colours) => colours,
            None if picture == Picture::Blocks => paint::blocks(&self.means(input.whole)?),
            None => {
                let why = match input.facts {
                    Some(_) => "this prune has no participation, as its selector solves no blocks",
                    None => "this picture is of a prune: `qirf-vk view MODEL --diagnostics FILE`",
                };
                return Err(Error::Usage(why.into()));
            }
        };
        paint::painted(&self.device, input.whole, &colours)
    }

    fn means(&self, model: &Resident) -> Result<Vec<[f32; 3]>, Error> {
        Ok(model.parameters.means.cast::<[f32; 3]>().read(&self.device)?)
    }

    /// The reference of an error picture, with the share of each of its values that counts if a mask hides some: the photo at
    /// a photo's camera, otherwise the other model.
    fn truth(
        &mut self,
        subject: &Subject,
        input: PaintInput<'_>,
        request: &Request,
    ) -> Result<(Vec<f32>, Option<Vec<f32>>), Error> {
        let (RequestCamera::Photo(n), Some(capture)) = (request.camera, &subject.capture) else {
            let why = "an error picture needs the camera of a photo, or a second model";
            return input.other.map(|other| (other.to_vec(), None)).ok_or_else(|| Error::Usage(why.into()));
        };
        let photo = match self.photo.take() {
            Some((at, photo)) if at == n => photo,
            _ => capture.photo(n)?,
        };
        let compared = (truth(&photo, self.background)?, weights(&photo)?);
        self.photo = Some((n, photo));
        Ok(compared)
    }
}

fn camera(request: &Request, capture: Option<&Capture>) -> Result<Camera, Error> {
    match request.camera {
        RequestCamera::Photo(n) => {
            let camera = capture.and_then(|c| c.camera(n));
            camera.ok_or_else(|| Error::Usage(format!("there is no photo {n}")))
        }
        RequestCamera::Pose { position, rotation, fov, shift, stretch } => {
            let [width, height] = request.size;
            if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MOST_PIXELS {
                return Err(Error::Usage(format!("a picture has 1 to {MOST_PIXELS} pixels")));
            }
            RequestCamera::free(position, rotation, fov, shift, stretch, request.size).map_err(Error::Usage)
        }
    }
}
