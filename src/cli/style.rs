//! Options of the style of rendering, which must match training.

use super::console::Console;
use super::values;
use crate::extension::folder_of;
use crate::gaussians::formats::{Loaded, RenderMode};
use crate::job::{RunConfig, earlier};
use crate::render::Style;
use clap::Args;
use std::path::Path;

#[derive(Clone, Debug, Args)]
pub struct Rendering {
    /// Keep the energy of Gaussians smaller than a pixel; without a value, on; true and false stand for on and off [default: as
    /// the model's file says]
    #[arg(long, value_name = "on|off", help_heading = "Rendering", num_args = 0..=1, require_equals = true,
        default_missing_value = "on", value_parser = values::switch(), ignore_case = true)]
    antialias: Option<bool>,
    /// Variance added to every splat, in square pixels; anti-aliased models of gsplat and PlayCanvas need 0.3, which their
    /// files do not record [default: 0.1 for anti-aliased models, 0.3 for others]
    #[arg(long, value_name = "0.1|0.3", help_heading = "Rendering", value_parser = values::dilation)]
    dilation: Option<f32>,
    /// Sort Gaussians by depth in each tile of the picture, for models trained with depth_order; this avoids popping when the
    /// camera turns; without a value, on [default: as the model's run did]
    #[arg(long, value_name = "on|off", help_heading = "Rendering", num_args = 0..=1, require_equals = true,
        default_missing_value = "on", value_parser = values::switch(), ignore_case = true)]
    depth_order: Option<bool>,
}

impl Rendering {
    /// The mode that the options ask for, if they do.
    pub fn mode(&self) -> Option<RenderMode> {
        self.antialias.map(RenderMode::of)
    }

    /// True if an option asks for another style than the file's.
    pub fn is_given(&self) -> bool {
        self.antialias.is_some() || self.is_of_pictures()
    }

    /// True if an option asks for something that only pictures have.
    pub fn is_of_pictures(&self) -> bool {
        self.dilation.is_some() || self.depth_order()
    }

    /// True if Gaussians are to be sorted in each tile.
    pub fn depth_order(&self) -> bool {
        self.depth_order.unwrap_or(false)
    }

    /// The style of a model of this mode, which the options have settled.
    pub fn of(&self, mode: RenderMode) -> Style {
        Style { antialias: mode.antialiased(), depth_order: self.depth_order(), dilation: self.dilation }
    }

    /// The style of the model read from `path`: the options come first, then its run's style, if known, and its tag. Says
    /// where an option contradicts those.
    pub fn style(&self, path: &Path, model: &Loaded, run: Option<Style>, console: &Console) -> Style {
        let run = run.unwrap_or_default();
        let tagged = Style { antialias: run.antialias || model.mode.antialiased(), ..run };
        let chosen = Style {
            antialias: self.antialias.unwrap_or(tagged.antialias),
            depth_order: self.depth_order.unwrap_or(run.depth_order),
            dilation: self.dilation.or(run.dilation),
        };
        if chosen.antialias != tagged.antialias {
            console.note(format_args!(
                "{}: drawn {}, as --antialias says; its file is tagged as {}",
                path.display(),
                chosen.mode(),
                tagged.mode()
            ));
        }
        chosen
    }

    /// As [`Self::style`], with the style of the config.toml beside the model, such as that of its run; a note says what is taken from it.
    pub fn beside(&self, path: &Path, model: &Loaded, console: &Console) -> Beside {
        let run = earlier::of_model(path).unwrap_or_else(|error| {
            console.warn(format_args!("{error}; the style of rendering and exposures are not taken from it"));
            None
        });
        // The file's own tag says whether it is anti-aliased: the model may have been edited.
        let style = run.as_ref().map(|run| Style { antialias: false, ..run.style });
        let given = style.unwrap_or_default();
        let mut taken = Vec::new();
        if let Some(dilation) = given.dilation.filter(|_| self.dilation.is_none()) {
            taken.push(format!("--dilation {dilation}"));
        }
        if given.depth_order && self.depth_order.is_none() {
            taken.push("--depth-order".to_owned());
        }
        if !taken.is_empty() {
            console.note(format_args!("drawn with {}, as config.toml beside the model says", taken.join(" ")));
        }
        Beside { style: self.style(path, model, style, console), run }
    }
}

/// The style of a model, and the configuration beside it.
pub(super) struct Beside {
    pub style: Style,
    run: Option<RunConfig>,
}

impl Beside {
    /// The background that the configuration names.
    pub fn background(&self) -> Option<[f32; 3]> {
        self.run.as_ref()?.background
    }

    /// True if its run has learnt an exposure of each photo; a note says so.
    pub fn exposure(&self, console: &Console) -> bool {
        let learnt = self.run.as_ref().is_some_and(|run| run.exposure);
        if learnt {
            console.note("an exposure is fitted to each photo, as config.toml beside the model says");
        }
        learnt
    }
}

/// The background of pictures of the model read from `path`: the one given, else that of its run, of which a note tells, else black.
pub(super) fn background_beside(path: &Path, given: Option<[f32; 3]>, console: &Console) -> [f32; 3] {
    let folder = folder_of(path);
    let of_run = || earlier::of_model(path).ok().flatten()?.background.or_else(|| earlier::scored_on(folder));
    let own = if given.is_some() { None } else { of_run().filter(|own| *own != [0.0; 3]) };
    if let Some([red, green, blue]) = own {
        console.note(format_args!("drawn on --background {red:.3},{green:.3},{blue:.3}, as in its run"));
    }
    given.or(own).unwrap_or_default()
}
