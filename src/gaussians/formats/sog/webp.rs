//! Lossless WebP textures, by libwebp: its files are 8 to 19 % smaller than those of the encoder in Rust that we had.

use webp::{Encoder, WebPConfig};

/// One texture: its name, width in texels, and RGBA.
pub(super) struct Texture {
    pub name: &'static str,
    pub width: usize,
    pub texels: Vec<[u8; 4]>,
}

impl Texture {
    /// Method and quality of libwebp. More effort finds matches of runs that a model's textures seldom have: it makes some files
    /// larger, and a trial of several costs three times as long for 0.1 %.
    fn effort(&self) -> (i32, f32) {
        match self.name {
            "sh0.webp" => (4, 50.0),
            "means_u.webp" | "shN_centroids.webp" => (1, 30.0),
            _ => (2, 50.0),
        }
    }

    /// The texture as a WebP file, its last row filled up.
    pub fn encode(mut self) -> Result<Vec<u8>, String> {
        let height = self.texels.len().div_ceil(self.width).max(1);
        let filling = self.texels.last().copied().unwrap_or([0, 0, 0, 255]);
        self.texels.resize(self.width * height, filling);
        let mut config = WebPConfig::new().map_err(|()| "libwebp has no configuration".to_owned())?;
        // Without `exact`, texels with alpha 0 would lose their colours.
        (config.lossless, config.exact) = (1, 1);
        (config.method, config.quality) = self.effort();
        let encoder = Encoder::from_rgba(self.texels.as_flattened(), self.width as u32, height as u32);
        let webp = encoder.encode_advanced(&config).map_err(|error| format!("libwebp: {error:?}"))?;
        Ok(webp.to_vec())
    }
}
