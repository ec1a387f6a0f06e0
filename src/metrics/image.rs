//! Pictures in the form that the metrics take, the 8-bit round trip and PSNR.

use super::Error;
use rayon::prelude::*;

/// A borrowed picture: interleaved red, green, blue in [0, 1], row by row.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    width: usize,
    height: usize,
    pixels: &'a [f32],
    weights: Option<&'a [f32]>,
}

impl<'a> Image<'a> {
    /// A picture of `width` x `height` x 3 floats.
    ///
    /// # Errors
    /// [`Error::Pixels`] for another number of floats, or for no pixels.
    pub fn new(width: usize, height: usize, pixels: &'a [f32]) -> Result<Self, Error> {
        let wanted = width.checked_mul(height).and_then(|n| n.checked_mul(3));
        if pixels.is_empty() || wanted != Some(pixels.len()) {
            return Err(Error::Pixels { width, height, found: pixels.len() });
        }
        Ok(Self { width, height, pixels, weights: None })
    }

    /// The same picture, of which masks hide some: a weight in [0, 1] for each value, not all 0. Where it is 0, nothing counts.
    ///
    /// # Errors
    /// [`Error::Pixels`] for another number of weights.
    pub fn weighted(self, weights: &'a [f32]) -> Result<Self, Error> {
        if weights.len() != self.pixels.len() {
            return Err(Error::Pixels { width: self.width, height: self.height, found: weights.len() });
        }
        Ok(Self { weights: Some(weights), ..self })
    }

    /// The weight of each value; none if all count alike.
    pub fn weights(&self) -> Option<&'a [f32]> {
        self.weights
    }

    /// Pixels per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, `height` x `width` x 3.
    pub fn pixels(&self) -> &'a [f32] {
        self.pixels
    }

    pub(super) fn same_size(&self, other: &Self) -> Result<(), Error> {
        let (a, b) = ((self.width, self.height), (other.width, other.height));
        if a == b { Ok(()) } else { Err(Error::Sizes(a, b)) }
    }
}

/// The values as after storage in 8 bits: clamped to [0, 1] and rounded to the nearest of 256 levels; NaN becomes 0.
pub fn round_trip_8bit(pixels: &[f32]) -> Vec<f32> {
    // The cast to u8 saturates, and maps NaN to 0.
    pixels.iter().map(|v| f32::from((v * 255.0 + 0.5) as u8) / 255.0).collect()
}

/// Peak signal-to-noise ratio in dB for the peak 1, over all pixels and channels; infinite for identical images. If `b` has weights,
/// both pictures are already mixed with the same background by them, and the mean is over what counts.
///
/// # Errors
/// [`Error::Sizes`] if the sizes differ.
pub fn psnr(a: &Image<'_>, b: &Image<'_>) -> Result<f64, Error> {
    a.same_size(b)?;
    let row = a.width * 3;
    // Summed per row and then in order, so that the sum does not depend on the threads.
    let rows: Vec<f64> = (a.pixels.par_chunks(row).zip(b.pixels.par_chunks(row)))
        .map(|(a, b)| a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum())
        .collect();
    let square = |w: &f32| f64::from(*w).powi(2);
    let count = b.weights.map_or(a.pixels.len() as f64, |weights| weights.iter().map(square).sum());
    let mean = rows.iter().sum::<f64>() / count;
    Ok(if mean == 0.0 { f64::INFINITY } else { -10.0 * mean.log10() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_checked() {
        assert!(Image::new(2, 1, &[0.0; 6]).is_ok());
        assert!(Image::new(2, 1, &[0.0; 5]).is_err());
        assert!(Image::new(0, 5, &[]).is_err());
        assert!(Image::new(usize::MAX, 3, &[0.0; 3]).is_err());
        let (a, b) = ([0.0; 6], [0.0; 6]);
        let (a, b) = (Image::new(2, 1, &a).unwrap(), Image::new(1, 2, &b).unwrap());
        assert!(psnr(&a, &b).unwrap_err().to_string().contains("2 x 1 and 1 x 2"));
    }

    #[test]
    fn eight_bits() {
        let v = [-1.0, 0.0, 0.0019, 0.002, 0.5, 1.0, 7.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
        let levels: Vec<f32> = round_trip_8bit(&v).iter().map(|v| v * 255.0).collect();
        assert_eq!(levels, [0.0, 0.0, 0.0, 1.0, 128.0, 255.0, 255.0, 0.0, 255.0, 0.0]);
        let once = round_trip_8bit(&(0..=1000).map(|i| i as f32 / 1000.0).collect::<Vec<_>>());
        assert_eq!(round_trip_8bit(&once), once);
    }

    #[test]
    fn known_values() {
        let (a, b) = ([0.5f32; 75], [0.6f32; 75]);
        let (a, b) = (Image::new(5, 5, &a).unwrap(), Image::new(5, 5, &b).unwrap());
        assert!((psnr(&a, &b).unwrap() - 20.0).abs() < 1e-5);
        assert_eq!(psnr(&a, &a).unwrap(), f64::INFINITY);
        let shown: Vec<f32> = (0..75).map(|i| if i < 30 { 1.0 } else { 0.0 }).collect();
        let mixed: Vec<f32> = shown.iter().map(|w| 0.5 + 0.1 * w).collect();
        let hidden = Image::new(5, 5, &mixed).unwrap().weighted(&shown).unwrap();
        assert!((psnr(&a, &hidden).unwrap() - 20.0).abs() < 1e-5, "what is hidden is no part of the mean");
        assert!(a.weighted(&shown[1..]).is_err());
        let (black, white) = ([0.0f32; 3], [1.0f32; 3]);
        let pair = (Image::new(1, 1, &black).unwrap(), Image::new(1, 1, &white).unwrap());
        assert_eq!(psnr(&pair.0, &pair.1).unwrap(), 0.0);
    }
}
