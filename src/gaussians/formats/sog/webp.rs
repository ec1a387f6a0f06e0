//! Lossless WebP textures, by libwebp: its files are 8 to 19 % smaller than those of the encoder in Rust that we had.

use webp::{Encoder, WebPConfig};

/// Efforts that are tried; the smaller file is taken. Higher ones take seconds for less than 0.1 %.
const METHODS: [(i32, f32); 2] = [(2, 50.0), (4, 75.0)];

/// One texture: its name, width in texels, and RGBA.
pub(super) struct Texture {
    pub name: &'static str,
    pub width: usize,
    pub texels: Vec<[u8; 4]>,
}

impl Texture {
    /// The texture as a WebP file, its last row filled up.
    pub fn encode(mut self) -> Result<Vec<u8>, String> {
        let height = self.texels.len().div_ceil(self.width).max(1);
        let filling = self.texels.last().copied().unwrap_or([0, 0, 0, 255]);
        self.texels.resize(self.width * height, filling);
        let mut smallest: Option<Vec<u8>> = None;
        for (method, quality) in METHODS {
            let mut config = WebPConfig::new().map_err(|()| "libwebp has no configuration".to_owned())?;
            // Without `exact`, texels with alpha 0 would lose their colours.
            (config.lossless, config.exact, config.method, config.quality) = (1, 1, method, quality);
            let encoder = Encoder::from_rgba(self.texels.as_flattened(), self.width as u32, height as u32);
            let webp = encoder.encode_advanced(&config).map_err(|error| format!("libwebp: {error:?}"))?;
            if smallest.as_ref().is_none_or(|found| webp.len() < found.len()) {
                smallest = Some(webp.to_vec());
            }
        }
        smallest.ok_or_else(|| "no effort".to_owned())
    }
}
