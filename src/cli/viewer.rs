//! Pages that draw a model by themselves, for `convert` and the reports of `run`.

use crate::gaussians::outline::outline;
use crate::gaussians::{Gaussians, formats};
use crate::job::{Error, Session};
use crate::pipeline::evaluate::pictures::byte;
use crate::pipeline::render::picture;
use crate::render::Settings;
use crate::report::picture::data_uri;
use crate::scene::near_at;
use crate::scene::orbit::Look;
use crate::view::alone::{PageOptions, page};
use image::RgbImage;
use std::path::Path;

/// Size of the picture that a page begins with.
const POSTER: (u32, u32) = (400, 250);

/// The picture that a page with these options begins with, as a `data:` URI; none of an empty model.
pub(super) fn poster(session: &Session<'_>, model: &Gaussians, options: &PageOptions) -> Result<Option<String>, Error> {
    if model.is_empty() {
        return Ok(None);
    }
    let (outline, look) = (outline(model, options.up.normalize()), Look { size: POSTER, ..Look::default() });
    let camera = options.first(&outline, &look);
    let size = [camera.width, camera.height];
    let settings = options.style.over(options.background);
    let settings = Settings { near: near_at(settings.near, outline.framing(&look).distance), ..settings };
    let image = picture(session, model, settings, &camera)?;
    let bytes = image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]].map(byte));
    Ok(RgbImage::from_raw(size[0], size[1], bytes.collect()).as_ref().and_then(data_uri))
}

/// The page of the model in this file, drawn as its run drew it.
pub(super) fn of_run(session: &Session<'_>, path: &Path, title: &str, drawn: Settings) -> Result<String, Error> {
    let model = formats::read(path)?.gaussians;
    let Settings { background, style, .. } = drawn;
    let mut options = PageOptions { title: title.to_owned(), background, style, ..PageOptions::default() };
    options.poster = poster(session, &model, &options)?;
    page(&model, &options, path).map_err(Error::writing)
}
