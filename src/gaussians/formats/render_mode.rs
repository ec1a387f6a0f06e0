//! The render mode of a model, which files carry as a tag.
//!
//! PLY: `comment SplatRenderMode: default|mip|2dgs` (brush, splat-transform) or `comment antialiased 0|1` (Postshot); the
//! last one counts. SPZ: bit 0 of the header's flags. SOG: `"model": "antialiased"` (splat-transform) or `"antialias": true`
//! (the specification's first version). The other formats have none. `comment Vertical Axis: z` (nerfstudio) is told, not obeyed.

use crate::wording::{named, shown};
use std::fmt;

use serde::Serialize;
use serde_json::Value;

named! {
    /// The mode in which a model was trained and has to be drawn.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum RenderMode {
        /// Gaussians are widened, and become bolder; also that of files without a tag.
        #[default]
        Plain = "plain",
        /// Gaussians are widened, and keep their energy.
        AntiAliased = "anti-aliased",
    }
}

impl RenderMode {
    /// The mode of a model that is anti-aliased or not.
    pub fn of(antialiased: bool) -> Self {
        if antialiased { Self::AntiAliased } else { Self::Plain }
    }

    /// True if Gaussians keep their energy.
    pub fn antialiased(self) -> bool {
        self == Self::AntiAliased
    }
}

/// The tags of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Tag {
    /// Mode that they state.
    pub mode: RenderMode,
    /// A tag was found that says so.
    stated: bool,
    /// Their faults, as a sentence; [`Tag::add_doubt`] adds one.
    pub doubt: Option<String>,
    /// Local origin of the means in the world; zero unless the file says otherwise.
    pub origin: [f64; 3],
}

/// Bytes of faults beyond which further ones are not named: a file may have thousands.
const LONGEST: usize = 600;
/// End of a list of faults that lacks some.
const MORE: &str = "; and more";

/// First word of the comment with the place, in the world, from which a PLY's means count.
pub(super) const ORIGIN: &str = "origin";

impl Tag {
    /// Tag of a format with one bit for it.
    pub fn of_bit(antialiased: bool) -> Self {
        Self { mode: RenderMode::of(antialiased), stated: true, ..Self::default() }
    }

    /// Tag of a SOG's `model` and `antialias`.
    pub fn of_sog(model: Option<&Value>, antialias: Option<&Value>) -> Self {
        let mut tag = Self::default();
        match antialias {
            None | Some(Value::Null) => {}
            Some(Value::Bool(on)) => tag.state(RenderMode::of(*on)),
            Some(other) => tag.not_understood(format_args!("\"antialias\": {other}")),
        }
        match model {
            None | Some(Value::Null) => {}
            Some(Value::String(name)) if name == "antialiased" => tag.state(RenderMode::AntiAliased),
            Some(Value::String(name)) if name == "default" => tag.state(RenderMode::Plain),
            Some(Value::String(name)) if name == "2dgs" => tag.flat(),
            Some(other) => tag.not_understood(format_args!("\"model\": {other}")),
        }
        tag
    }

    /// Reads the words of a PLY comment, most of which are no tag.
    pub fn comment(&mut self, words: &[&str]) {
        let lower: Vec<String> = words.iter().map(|word| word.to_ascii_lowercase()).collect();
        match lower.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
            ["splatrendermode:", "mip"] | ["antialiased", "1"] => self.state(RenderMode::AntiAliased),
            ["splatrendermode:", "default"] | ["antialiased", "0"] => self.state(RenderMode::Plain),
            ["splatrendermode:", "2dgs"] => self.flat(),
            // Any other sentence may begin with the word `antialiased`.
            ["antialiased"] | ["antialiased", _] => self.not_understood(format_args!("comment {}", words.join(" "))),
            [ORIGIN, place @ ..] => self.place(place),
            ["vertical", "axis:", axis @ ("x" | "y" | "z" | "-x" | "-z")] => self.add_doubt(format!(
                "its header, whose comments `convert` drops, says that {axis} is up, where -y is up by default: \
                 `--up {axis}` shows it upright, and `qirf-vk edit --up {axis}:-y` turns it"
            )),
            [first, ..] if first.starts_with("splatrendermode") => {
                self.not_understood(format_args!("comment {}", words.join(" ")));
            }
            _ => {}
        }
    }

    /// Reads three numbers; other sentences may begin with the same word.
    fn place(&mut self, words: &[&str]) {
        let numbers: Vec<f64> =
            words.iter().filter_map(|word| word.parse().ok()).filter(|v: &f64| v.is_finite()).collect();
        if let (&[x, y, z], 3) = (numbers.as_slice(), words.len()) {
            self.origin = [x, y, z];
        }
    }

    /// Adds a fault to those of the file, unless it is known.
    pub fn add_doubt(&mut self, fault: impl Into<String>) {
        let fault = fault.into();
        match &mut self.doubt {
            None => self.doubt = Some(fault),
            Some(known) if known.contains(&fault) || known.ends_with(MORE) => {}
            Some(known) if known.len() > LONGEST => known.push_str(MORE),
            Some(known) => *known = format!("{known}; also {fault}"),
        }
    }

    /// Puts faults of the whole file before those of its parts.
    pub fn add_first(&mut self, faults: impl IntoIterator<Item = String>) {
        let of_parts = self.doubt.take();
        faults.into_iter().chain(of_parts).for_each(|fault| self.add_doubt(fault));
    }

    /// This tag, or where it says nothing that of the group around it.
    pub fn or(self, around: &Self) -> Self {
        if self.stated {
            return self;
        }
        let mut tag = around.clone();
        tag.add_first(self.doubt);
        tag
    }

    /// Tag of a file of several parts: anti-aliased if any of them is.
    pub fn of_parts(parts: impl IntoIterator<Item = Self>) -> Self {
        let join = |mut all: Self, part: Self| {
            if all.mode != part.mode {
                all.mode = RenderMode::AntiAliased;
                all.add_doubt("its parts have different render modes; all of it is drawn anti-aliased");
            }
            if let Some(fault) = part.doubt {
                all.add_doubt(fault);
            }
            all
        };
        parts.into_iter().reduce(join).unwrap_or_default()
    }

    fn state(&mut self, mode: RenderMode) {
        let sentence = |mode| format!("two tags contradict each other; the last one counts: {mode}");
        if self.stated && self.mode != mode {
            let earlier = self.doubt.take().map(|known| known.replace(&sentence(self.mode), &sentence(mode)));
            self.doubt = earlier;
            self.add_doubt(sentence(mode));
        }
        (self.mode, self.stated) = (mode, true);
    }

    fn flat(&mut self) {
        self.state(RenderMode::Plain);
        self.add_doubt("its tag says 2DGS; it is drawn as 3D Gaussians, which look different");
    }

    /// Says that a model of two scales a Gaussian got a third one.
    pub fn thickened(&mut self) {
        self.state(RenderMode::Plain);
        self.add_doubt(
            "a 2DGS model, with two scales a Gaussian: it gets a third one of 1e-6 and is drawn as 3D Gaussians, which look \
             different",
        );
    }

    /// Says that the filters of Mip-Splatting are in a model's scales and opacities now; it is anti-aliased unless a tag says
    /// otherwise.
    pub fn smoothed(&mut self) {
        if !self.stated {
            self.state(RenderMode::AntiAliased);
        }
        self.add_doubt(
            "a model of Mip-Splatting: its filter_3D is taken into scales and opacities, and it is anti-aliased",
        );
    }

    fn not_understood(&mut self, tag: fmt::Arguments<'_>) {
        self.add_doubt(format!("the tag `{}` is not understood, and is ignored", shown(&tag.to_string(), 80)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn of_comments(comments: &[&str]) -> Tag {
        let mut tag = Tag::default();
        for comment in comments {
            tag.comment(&comment.split_whitespace().collect::<Vec<_>>());
        }
        tag
    }

    #[test]
    fn comments_of_other_tools_are_understood() {
        use RenderMode::{AntiAliased, Plain};
        for (comments, mode) in [
            (&["SplatRenderMode: mip"][..], AntiAliased),
            (&["Exported from Brush", "SH degree: 3", "  SPLATRENDERMODE:  MIP "], AntiAliased),
            (&["antialiased 1"], AntiAliased),
            (&["antialiased 0"], Plain),
            (&["SplatRenderMode: default"], Plain),
            (&["Generated by something", "antialiased scene of a garden", ""], Plain),
            (&["Vertical Axis: -y", "Vertical Axis: unknown"], Plain),
            (&[], Plain),
        ] {
            let tag = of_comments(comments);
            assert_eq!((tag.mode, tag.doubt), (mode, None), "{comments:?}");
        }
    }

    #[test]
    fn damaged_and_contradicting_comments_are_doubted() {
        for (comments, mode, doubt) in [
            (&["SplatRenderMode: mop"][..], RenderMode::Plain, "SplatRenderMode: mop"),
            (&["SplatRenderMode:"], RenderMode::Plain, "not understood"),
            (&["SplatRenderMode: mip mip"], RenderMode::Plain, "not understood"),
            (&["antialiased yes"], RenderMode::Plain, "antialiased yes"),
            (&["antialiased"], RenderMode::Plain, "not understood"),
            (&["SplatRenderMode: mip", "antialiased 7"], RenderMode::AntiAliased, "antialiased 7"),
            (&["SplatRenderMode: mip", "antialiased 0"], RenderMode::Plain, "counts: plain"),
            (&["antialiased 0", "SplatRenderMode: mip"], RenderMode::AntiAliased, "counts: anti-aliased"),
            (&["SplatRenderMode: 2dgs"], RenderMode::Plain, "2DGS"),
            (&["Vertical Axis: z"], RenderMode::Plain, "`qirf-vk edit --up z:-y` turns it"),
            (&["Vertical Axis: z"], RenderMode::Plain, "comments `convert` drops, says that z is up"),
            (
                &["antialiased yes", "SplatRenderMode: 2dgs"],
                RenderMode::Plain,
                "and is ignored; also its tag says 2DGS",
            ),
            (&["SplatRenderMode: \u{1b}[2J\u{fffd}"], RenderMode::Plain, "\\u{1b}"),
        ] {
            let tag = of_comments(comments);
            assert_eq!(tag.mode, mode, "{comments:?}");
            assert!(tag.doubt.as_ref().is_some_and(|d| d.contains(doubt)), "{comments:?}: {:?}", tag.doubt);
        }
        let long = of_comments(&[&format!("SplatRenderMode: {}", "m".repeat(10_000))]);
        assert!(long.doubt.unwrap().len() < 200);
        let many: Vec<String> = (0..1000).map(|i| format!("antialiased {i}x")).collect();
        let many = of_comments(&many.iter().map(String::as_str).collect::<Vec<_>>()).doubt.unwrap();
        assert!(many.len() < 900 && many.ends_with(MORE), "{many}");
    }

    #[test]
    fn sog_says_it_in_two_ways() {
        let of = |model: Option<Value>, antialias: Option<Value>| {
            let tag = Tag::of_sog(model.as_ref(), antialias.as_ref());
            (tag.mode.antialiased(), tag.doubt)
        };
        assert_eq!(of(None, None), (false, None));
        assert_eq!(of(Some(json!("antialiased")), None), (true, None));
        assert_eq!(of(Some(json!("default")), None), (false, None));
        assert_eq!(of(None, Some(json!(true))), (true, None));
        assert_eq!(of(None, Some(json!(false))), (false, None));
        assert_eq!(of(Some(json!("antialiased")), Some(json!(true))), (true, None));
        for (model, antialias, antialiased) in [
            (json!("antialiased"), json!(false), true),
            (json!(3), json!(true), true),
            (json!("2dgs"), Value::Null, false),
            (json!({"a": [1]}), Value::Null, false),
            (json!("antialiased"), json!("yes"), true),
        ] {
            let (mode, doubt) = of(Some(model.clone()), Some(antialias.clone()));
            assert!(mode == antialiased && doubt.is_some(), "{model} {antialias}: {mode} {doubt:?}");
        }
    }
}
