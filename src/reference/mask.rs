//! Masks: the hidden part of a photo is background in both pictures, and adds nothing to the loss.

/// The picture (n pixels, RGB and alpha) with its hidden parts replaced by `background`; the fourth byte of `photo` is
/// the weight of a pixel.
pub fn mask(image: &[[f64; 4]], photo: &[u32], background: [f64; 3]) -> Vec<[f64; 4]> {
    let pixel = |(p, word): (&[f64; 4], &u32)| {
        let counts = counts(*word);
        std::array::from_fn(|c| if c < 3 { p[c] * counts + background[c] * (1.0 - counts) } else { p[3] })
    };
    image.iter().zip(photo).map(pixel).collect()
}

/// The gradient by the picture, from the gradient by the masked one; its fourth component is unchanged.
pub fn backward(gradient: &[[f64; 4]], photo: &[u32]) -> Vec<[f64; 4]> {
    let pixel = |(g, word): (&[f64; 4], &u32)| std::array::from_fn(|c| if c < 3 { g[c] * counts(*word) } else { g[3] });
    gradient.iter().zip(photo).map(pixel).collect()
}

/// Weight of a pixel, 0 to 1.
fn counts(word: u32) -> f64 {
    f64::from(word >> 24) / 255.0
}
