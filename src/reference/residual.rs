//! Difference between a picture and its photo, pixel by pixel.

/// Mean over the colours of |picture - photo|. The photo (RGBA, 8 bits each) is opaque, or blended by its alpha over
/// `background` if one is given.
pub fn residual(image: &[[f64; 4]], photo: &[u32], background: Option<[f64; 3]>) -> Vec<f64> {
    let pixel = |(p, word): (&[f64; 4], &u32)| {
        let [r, g, b, alpha] = word.to_le_bytes().map(|v| f64::from(v) / 255.0);
        let truth = |c: usize| {
            let own = [r, g, b][c];
            background.map_or(own, |behind| own * alpha + behind[c] * (1.0 - alpha))
        };
        (0..3).map(|c| (p[c] - truth(c)).abs()).sum::<f64>() / 3.0
    };
    image.iter().zip(photo).map(pixel).collect()
}
