//! A page that contains a model and draws it by itself: without a network, and without a program beside it.
//!
//! The page contains the model as SPZ 3, whose bytes the vertex shader unpacks; a worker sorts by depth; quads are
//! blended back to front. Projection, colour, dilation and anti-aliasing follow `glsl/render/project.comp`.

mod fit;

use super::subject::pose;
use crate::gaussians::formats::{self, SpzVersion};
use crate::gaussians::outline::outline;
use crate::gaussians::{Error, Gaussians};
use crate::render::Style;
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::scene::orbit::{Look, Outline, UP};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use serde_json::{Value, json};
use std::borrow::Cow;
use std::path::Path;

pub use fit::Fit;

const PAGE: &str = include_str!("page.html");
/// The script's parts, in order; all imports between them are resolved within the page.
const SCRIPTS: [&str; 2] = [include_str!("../camera.js"), include_str!("viewer.js")];
/// Aspect ratios of windows, width by height, for which the framing is computed.
const SHAPES: [f64; 8] = [0.45, 0.6, 0.8, 1.0, 1.35, 1.8, 2.4, 3.5];

/// Contents of a page besides its model.
#[derive(Clone, Debug, PartialEq)]
pub struct PageOptions {
    /// The title, shown above the picture.
    pub title: String,
    /// Red, green and blue behind the Gaussians, 0 to 1.
    pub background: [f32; 3],
    /// Dilation and anti-aliasing; pages know one order of depths only.
    pub style: Style,
    /// Up direction in the world.
    pub up: DVec3,
    /// The initial camera; by default one that sees the whole model.
    pub start: Option<Camera>,
    /// The point about which the initial camera turns, in world units; by default the model's centre.
    pub target: Option<DVec3>,
    /// Nothing nearer to a camera than this is drawn, in world units; by default in proportion to the model.
    pub near: Option<f32>,
    /// A picture from that camera, as a `data:` URI, shown until the model is drawn.
    pub poster: Option<String>,
    /// Text on the page about the model; by default its number of Gaussians.
    pub facts: Option<String>,
}

impl PageOptions {
    /// Takes the up direction, the near plane and the target of this initial camera from a scene, whose coordinates are the
    /// model's plus `shift`.
    pub fn place_in(&mut self, scene: &Scene, camera: Option<&Camera>, shift: DVec3) {
        self.up = scene.up();
        self.near = Some(scene.near);
        self.start = camera.map(|camera| camera.relative_to(shift));
        self.target = camera.map(|camera| scene.sight(camera) - shift);
    }

    /// The initial camera of the page, for a picture of the look's size of a model with this outline.
    pub fn first(&self, outline: &Outline, look: &Look) -> Camera {
        self.start.clone().unwrap_or_else(|| outline.camera(0.0, look))
    }
}

impl Default for PageOptions {
    fn default() -> Self {
        Self {
            title: String::new(),
            background: [0.0; 3],
            style: Style::default(),
            up: UP,
            start: None,
            target: None,
            near: None,
            poster: None,
            facts: None,
        }
    }
}

/// The page of a model, which is moved and scaled first where it needs that ([`Fit`]); `name` appears in messages.
///
/// # Errors
/// [`Error::Unsupported`] if SPZ cannot hold the model, [`Error::Inconsistent`].
pub fn page(model: &Gaussians, options: &PageOptions, name: &Path) -> Result<String, Error> {
    let (mut model, mut options) = (Cow::Borrowed(model), Cow::Borrowed(options));
    if let Some(fit) = Fit::of(&model) {
        fit.apply(model.to_mut(), options.to_mut());
    }
    let packed = formats::spz(&model, options.style.mode(), SpzVersion::Three, name)?;
    Ok(Shell::new(&model, &options).page(&packed))
}

/// A page without its model.
pub struct Shell {
    before: String,
    after: String,
}

impl Shell {
    /// The page for this model, or for one that looks like it; without a title, it is called Model.
    pub fn new(model: &Gaussians, options: &PageOptions) -> Self {
        let script: Vec<&str> =
            SCRIPTS.iter().flat_map(|part| part.lines()).filter(|l| !l.starts_with("import ")).collect();
        let script =
            script.iter().map(|line| line.strip_prefix("export ").unwrap_or(line)).collect::<Vec<_>>().join("\n")
                + "\n";
        let poster = options
            .poster
            .as_ref()
            .map_or_else(String::new, |uri| format!("<img id=\"poster\" src=\"{}\" alt=\"\">", escaped(uri)));
        let title = if options.title.trim().is_empty() { "Model" } else { options.title.as_str() };
        let [red, green, blue] = options.background.map(|part| (255.0 * part).round());
        let parts = [
            ("title", &*escaped(title)),
            ("style", include_str!("page.css")),
            ("background", &format!("rgb({red}, {green}, {blue})")),
            ("poster", &poster),
            ("scene", &scene(model, options).to_string().replace('<', "\\u003c")),
            ("worker", include_str!("worker.js")),
            ("vertex", include_str!("splat.vert")),
            ("fragment", include_str!("splat.frag")),
            ("script", &script),
        ];
        let (before, after) = PAGE.split_once("{model}").expect("a place for the model");
        Self { before: filled(before, &parts), after: filled(after, &parts) }
    }

    /// The page for a model that is packed as SPZ 3.
    pub fn page(&self, packed: &[u8]) -> String {
        [&self.before, &*STANDARD.encode(packed), &self.after].concat()
    }
}

/// The template with these texts in place of their names in braces; the texts themselves stay as they are.
fn filled(template: &str, parts: &[(&str, &str)]) -> String {
    let mut pieces = template.split('{');
    let begin = pieces.next().unwrap_or_default().to_owned();
    pieces.fold(begin, |page, piece| {
        let (name, rest) = piece.split_once('}').expect("braces of a template hold a name");
        let (_, text) = parts.iter().find(|(known, _)| *known == name).expect("a part of this name");
        page + text + rest
    })
}

/// Escapes text for an element or a quoted attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Parameters of the script.
fn scene(model: &Gaussians, options: &PageOptions) -> Value {
    let settings = options.style.over(options.background);
    let up = options.up.normalize();
    let outline = outline(model, up);
    let look = |aspect: f64| Look { size: ((1000.0 * aspect) as u32, 1000), ..Look::default() };
    let framings: Vec<[f64; 3]> = SHAPES
        .iter()
        .map(|&aspect| {
            let framing = outline.framing(&look(aspect));
            [aspect, framing.height, framing.distance]
        })
        .collect();
    let Look { fov, elevation, .. } = look(1.0);
    // Level from the middle to the first camera of an orbit.
    let eye = outline.camera(0.0, &look(1.0)).centre() - outline.centre;
    let front = eye.reject_from(up).try_normalize().unwrap_or_else(|| up.any_orthonormal_vector());
    json!({
        "centre": outline.centre.to_array(),
        "up": up.to_array(),
        "front": front.to_array(),
        "fov": fov,
        "elevation": elevation,
        "framings": framings,
        "start": options.start.as_ref().map(pose),
        "target": options.target.map(|target| target.to_array()),
        "near": options.near,
        "background": options.background,
        "dilation": settings.dilation,
        "antialiased": options.style.antialias,
        "facts": options.facts,
        "made": concat!("packed by qirf-vk ", env!("CARGO_PKG_VERSION")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn script_and_style_are_small_and_nothing_is_left_to_fill_in() {
        let style = Style { antialias: true, ..Style::default() };
        let options = PageOptions { title: "<b> & \"c\"</script> {scene}".into(), style, ..PageOptions::default() };
        let model = Gaussians::balls(vec![[0.0; 3]; 3], 0.0, 0.0, 1);
        let page = page(&model, &options, Path::new("m.html")).unwrap();
        assert!(page.len() < 60_000, "{} bytes; 120 kB are allowed", page.len());
        // A name in braces within a title stays.
        assert!(page.contains("<title>&lt;b&gt; &amp; &quot;c&quot;&lt;/script&gt; {scene}</title>"));
        for left in ["{title}", "{style}", "{poster}", "{worker}", "{vertex}", "{fragment}", "{script}", "{model}"] {
            assert!(!page.contains(left), "{left}");
        }
        assert!(!page.contains("\nimport ") && !page.contains("\nexport ") && !page.contains("://"));
        assert!(page.contains("<body style=\"background: rgb(0, 0, 0)\">"));
        assert!(page.contains("\"dilation\":0.1") && page.contains("\"antialiased\":true"));
    }
}
