//! Settings of a picture besides its model and camera.

use crate::gaussians::formats::RenderMode;
use crate::kernels::View;
use crate::kernels::constants::blending::TRANSMITTANCE_STOP;
use crate::kernels::constants::tiles;
use crate::kernels::constants::view::float64::FIELD_MARGIN;
use crate::kernels::constants::view::{DILATION, DILATION_ANTIALIAS, NEAR};
use crate::scene::camera::{Camera, Whole};
use glam::DVec2;
use serde::{Deserialize, Serialize};

/// Method of leaving out tiles that a Gaussian cannot touch; its numbers are the shader's CULLING.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Culling {
    /// The ellipse where alpha falls to 1/255, tested against each tile: lists every pair that is drawn, and no other.
    #[default]
    Exact = tiles::EXACT,
    /// The box of three standard deviations, as in the reference; it cuts faint tails.
    ThreeSigma = tiles::THREE_SIGMA,
    /// No culling: every Gaussian is listed in every tile.
    Off = tiles::OFF,
}

/// Settings of image formation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Colour behind the Gaussians.
    pub background: [f32; 3],
    /// Effects of the model.
    pub style: Style,
    /// Added to a splat's variance, in square pixels.
    pub dilation: f32,
    /// Method of culling tiles.
    pub culling: Culling,
    /// Blending ends before transmittance would fall below this.
    pub stop: f32,
    /// Gaussians nearer than this, in world units, are left out.
    pub near: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            style: Style::default(),
            dilation: DILATION,
            culling: Culling::Exact,
            stop: TRANSMITTANCE_STOP,
            near: NEAR,
        }
    }
}

/// Effects that a model is trained with and must be rendered with. Files store these fields among their own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Style {
    /// True to preserve the energy of Gaussians smaller than a pixel.
    pub antialias: bool,
    /// True for a depth order per tile: by the depth at which a Gaussian is densest along the ray through the tile's
    /// middle. Otherwise one order, by the depth of means, holds for the whole picture.
    #[serde(default)]
    pub depth_order: bool,
    /// Added to every splat's variance, in square pixels, one of [`Style::DILATIONS`]; if absent, 0.1 with `antialias`
    /// and 0.3 without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dilation: Option<f32>,
}

impl Style {
    /// The dilations in use: near a pixel's own variance, and that of the 3DGS reference.
    pub const DILATIONS: [f32; 2] = [DILATION_ANTIALIAS, DILATION];

    /// The style for models of this mode.
    pub fn of(mode: RenderMode) -> Self {
        Self { antialias: mode.antialiased(), ..Self::default() }
    }

    /// The mode of models with this style.
    pub fn mode(self) -> RenderMode {
        RenderMode::of(self.antialias)
    }

    /// The settings of image formation for this style and background.
    #[must_use]
    pub fn over(self, background: [f32; 3]) -> Settings {
        let usual = if self.antialias { DILATION_ANTIALIAS } else { DILATION };
        let dilation = self.dilation.unwrap_or(usual);
        Settings { background, style: self, dilation, ..Settings::default() }
    }
}

/// A camera in the layout of the kernels.
pub fn view(camera: &Camera, settings: &Settings, degree: usize, tile: u32) -> View {
    let rotation = camera.rotation.transpose().to_cols_array_2d();
    let centre = camera.centre().as_vec3();
    let lost = (camera.centre() - centre.as_dvec3()).as_vec3();
    let row = |r: usize| [rotation[r][0] as f32, rotation[r][1] as f32, rotation[r][2] as f32, lost[r]];
    let Whole { size: whole, corner } = camera.whole();
    // Picture coordinates are relative to this point: origin() of lib/view.glsl.
    let origin = DVec2::new(f64::from(whole[0] / 2), f64::from(whole[1] / 2));
    let [r, g, b] = settings.background;
    let limit = |size: u32, focal: f64| (FIELD_MARGIN * 0.5 * f64::from(size) / focal) as f32;
    View {
        rotation: [row(0), row(1), row(2)],
        centre: [centre.x, centre.y, centre.z, settings.near],
        background: [r, g, b, 0.0],
        focal: camera.focal.as_vec2().to_array(),
        principal: (camera.principal - origin).as_vec2().to_array(),
        tangent_limit: [limit(whole[0], camera.focal.x), limit(whole[1], camera.focal.y)],
        size: [camera.width, camera.height],
        tiles: [camera.width.div_ceil(tile), camera.height.div_ceil(tile)],
        degree: degree as u32,
        dilation: settings.dilation,
        whole,
        corner,
    }
}
