//! Pages that draw a model by themselves, for `convert` and the reports of `run`.

use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, Loaded};
use crate::gaussians::outline::outline;
use crate::job::{Error, Selection, Session};
use crate::pipeline::evaluate::pictures::byte;
use crate::pipeline::place::shift_to;
use crate::pipeline::render::picture;
use crate::render::Settings;
use crate::report::picture::{data_uri, size_in_page};
use crate::scene::camera::Camera;
use crate::scene::orbit::Look;
use crate::scene::{Scene, near_at};
use crate::view::alone::{PageOptions, page};
use image::RgbImage;
use std::path::Path;

/// Size of the picture that a page without an initial camera begins with.
const POSTER: (u32, u32) = (400, 250);

/// The picture that a page with these options begins with, as a `data:` URI; none of an empty model.
pub(super) fn poster(session: &Session<'_>, model: &Gaussians, options: &PageOptions) -> Result<Option<String>, Error> {
    if model.is_empty() {
        return Ok(None);
    }
    let (outline, look) = (outline(model, options.up.normalize()), Look { size: POSTER, ..Look::default() });
    let camera = options.first(&outline, &look);
    let (width, height) = size_in_page(camera.width, camera.height);
    let camera = camera.resized(width, height);
    let settings = options.style.over(options.background);
    let near = options.near.unwrap_or_else(|| near_at(settings.near, outline.framing(&look).distance));
    let settings = Settings { near, ..settings };
    let image = picture(session, model, settings, &camera)?;
    let bytes = image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]].map(byte));
    Ok(RgbImage::from_raw(width, height, bytes.collect()).as_ref().and_then(data_uri))
}

/// The page of a run's model, drawn as its run drew it, with the up direction, the near plane and the first held-out camera of
/// the run's scene.
pub(super) fn of_run(
    session: &Session<'_>,
    path: &Path,
    title: &str,
    drawn: Settings,
    selection: &Selection,
) -> Result<String, Error> {
    let Loaded { gaussians: model, origin, .. } = formats::read(path)?;
    let Settings { background, style, .. } = drawn;
    let mut options = PageOptions { title: title.to_owned(), background, style, ..PageOptions::default() };
    match scene(selection) {
        Ok((scene, camera)) => options.place_in(&scene, camera.as_ref(), shift_to(&model, origin, &scene)),
        // The report of a long run is worth more than its first view.
        Err(gone) => session.watcher.note(&format!("the report's model is shown without the run's cameras: {gone}")),
    }
    options.poster = poster(session, &model, &options)?;
    page(&model, &options, path).map_err(Error::writing)
}

/// The scene of a run, and its first held-out camera, or else its first one, at the size of the run's pictures.
fn scene(selection: &Selection) -> Result<(Scene, Option<Camera>), Error> {
    let mut scene = Scene::open(&selection.scene, &selection.open_options())?;
    scene.require_photos()?;
    let first = scene.split(selection.eval_every).test.first().copied().unwrap_or(0);
    let resize = selection.resize().map_err(Error::Usage)?;
    let camera = scene.views.get(scene.ahead(first)).map(|view| view.camera_at(resize));
    Ok((scene, camera))
}
