//! Pages that draw a model by themselves, for `convert` and the reports of `run`.

use crate::gaussians::formats::{self, Loaded};
use crate::job::{Error, Session};
use crate::pipeline::render::picture;
use crate::render::Style;
use crate::report::picture::data_uri;
use crate::view::alone::{PageOptions, page};
use image::RgbImage;
use std::path::Path;

/// Size of the picture that a page begins with.
const POSTER: (u32, u32) = (400, 250);

/// The picture that a page with these options begins with, as a `data:` URI; none of an empty model.
pub(super) fn poster(session: &Session<'_>, loaded: &Loaded, options: &PageOptions) -> Result<Option<String>, Error> {
    let model = &loaded.gaussians;
    if model.is_empty() {
        return Ok(None);
    }
    let camera = options.first(model, POSTER);
    let size = [camera.width, camera.height];
    let image = picture(session, model, Style::of(loaded.mode).over(options.background), &camera)?;
    let bytes = image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]].map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
    Ok(RgbImage::from_raw(size[0], size[1], bytes.collect()).as_ref().and_then(data_uri))
}

/// The page of the model in this file.
pub(super) fn of_file(session: &Session<'_>, path: &Path, title: &str) -> Result<String, Error> {
    let loaded = formats::read(path)?;
    let mut options = PageOptions { title: title.to_owned(), ..PageOptions::default() };
    options.poster = poster(session, &loaded, &options)?;
    page(&loaded.gaussians, loaded.mode, &options, path).map_err(Error::writing)
}
