//! One value for each attribute of a Gaussian: arrays, names, widths, moments, learning rates.

use super::{Gaussians, MAX_SH_DEGREE};
use bytemuck::Pod;
use std::convert::Infallible;

/// Largest number of SH bands.
const BANDS: usize = MAX_SH_DEGREE + 1;
/// Number of attributes; each SH band is one.
const COUNT: usize = 4 + BANDS;

/// One value for each attribute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Attributes<T> {
    /// For centres.
    pub means: T,
    /// For logarithms of the axes' standard deviations.
    pub log_scales: T,
    /// For quaternions (w, x, y, z).
    pub rotations: T,
    /// For opacities before the sigmoid.
    pub opacity_logits: T,
    /// For spherical harmonics, by band.
    pub sh: [T; BANDS],
}

impl Attributes<&'static str> {
    /// Names, in checkpoints and messages.
    pub const NAMES: Self = Self {
        means: "means",
        log_scales: "log_scales",
        rotations: "rotations",
        opacity_logits: "opacity_logits",
        sh: ["sh0", "sh1", "sh2", "sh3"],
    };
}

impl Attributes<usize> {
    /// Numbers per Gaussian in a model of this SH degree; 0 for bands beyond it.
    pub fn widths(degree: usize) -> Self {
        Self::widths_of_bands(degree + 1)
    }

    /// Numbers per Gaussian of the widest attribute in a model of this SH degree.
    pub fn widest(degree: usize) -> usize {
        Self::widths(degree).into_array().into_iter().fold(0, usize::max)
    }

    /// [`Attributes::widths`] by the number of SH bands.
    pub(super) fn widths_of_bands(bands: usize) -> Self {
        let sh = std::array::from_fn(|l| if l < bands { Gaussians::band_width(l) } else { 0 });
        Self { means: 3, log_scales: 3, rotations: 4, opacity_logits: 1, sh }
    }
}

impl<T> Attributes<T> {
    /// All values, in order.
    pub fn into_array(self) -> [T; COUNT] {
        let [sh0, sh1, sh2, sh3] = self.sh;
        [self.means, self.log_scales, self.rotations, self.opacity_logits, sh0, sh1, sh2, sh3]
    }

    /// The values of a model of this SH degree, in order.
    pub fn up_to(self, degree: usize) -> impl Iterator<Item = T> {
        self.into_array().into_iter().take(COUNT - MAX_SH_DEGREE + degree)
    }

    /// References to all values.
    pub fn each_ref(&self) -> Attributes<&T> {
        let Self { means, log_scales, rotations, opacity_logits, sh } = self;
        Attributes { means, log_scales, rotations, opacity_logits, sh: sh.each_ref() }
    }

    /// Mutable references to all values.
    pub fn each_mut(&mut self) -> Attributes<&mut T> {
        let Self { means, log_scales, rotations, opacity_logits, sh } = self;
        Attributes { means, log_scales, rotations, opacity_logits, sh: sh.each_mut() }
    }

    /// The results of `f` for all values, in order.
    pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> Attributes<U> {
        let Ok(mapped) = self.try_map(|t| Ok::<U, Infallible>(f(t)));
        mapped
    }

    /// The results of `f` for all values, in order, or its first error.
    pub fn try_map<U, E>(self, mut f: impl FnMut(T) -> Result<U, E>) -> Result<Attributes<U>, E> {
        let [sh0, sh1, sh2, sh3] = self.sh;
        Ok(Attributes {
            means: f(self.means)?,
            log_scales: f(self.log_scales)?,
            rotations: f(self.rotations)?,
            opacity_logits: f(self.opacity_logits)?,
            sh: [f(sh0)?, f(sh1)?, f(sh2)?, f(sh3)?],
        })
    }

    /// Pairs of the values of the same attribute.
    pub fn zip<U>(self, other: Attributes<U>) -> Attributes<(T, U)> {
        let ([a, b, c, d], [e, f, g, h]) = (self.sh, other.sh);
        Attributes {
            means: (self.means, other.means),
            log_scales: (self.log_scales, other.log_scales),
            rotations: (self.rotations, other.rotations),
            opacity_logits: (self.opacity_logits, other.opacity_logits),
            sh: [(a, e), (b, f), (c, g), (d, h)],
        }
    }
}

impl Attributes<u64> {
    /// The sum of all values.
    pub fn sum(self) -> u64 {
        self.into_array().into_iter().sum()
    }
}

/// Rows of `N` numbers.
pub(crate) fn rows<T: Copy, const N: usize>(values: &[T]) -> Vec<[T; N]> {
    values.as_chunks().0.to_vec()
}

impl<T: Pod> Gaussians<T> {
    /// The bytes of each attribute, in order; for checksums.
    pub fn bytes(&self) -> impl Iterator<Item = &[u8]> {
        self.attributes().into_array().into_iter().map(bytemuck::cast_slice)
    }
}

impl<T: Copy> Gaussians<T> {
    /// The numbers of each attribute, Gaussian by Gaussian; empty for bands that the model lacks.
    pub fn attributes(&self) -> Attributes<&[T]> {
        Attributes {
            means: self.means.as_flattened(),
            log_scales: self.log_scales.as_flattened(),
            rotations: self.rotations.as_flattened(),
            opacity_logits: &self.opacity_logits,
            sh: std::array::from_fn(|l| self.sh.get(l).map_or(&[][..], Vec::as_slice)),
        }
    }

    /// Like [`Gaussians::attributes`], mutable.
    pub fn attributes_mut(&mut self) -> Attributes<&mut [T]> {
        let mut bands = self.sh.iter_mut();
        Attributes {
            means: self.means.as_flattened_mut(),
            log_scales: self.log_scales.as_flattened_mut(),
            rotations: self.rotations.as_flattened_mut(),
            opacity_logits: &mut self.opacity_logits,
            sh: std::array::from_fn(|_| bands.next().map_or(&mut [][..], Vec::as_mut_slice)),
        }
    }

    /// A model of these numbers with `bands` SH bands.
    pub fn of_attributes(attributes: Attributes<Vec<T>>, bands: usize) -> Self {
        let Attributes { means, log_scales, rotations, opacity_logits, sh } = attributes;
        Self {
            means: rows(&means),
            log_scales: rows(&log_scales),
            rotations: rows(&rotations),
            opacity_logits,
            sh: sh.into_iter().take(bands).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_its_attributes() {
        for bands in 0..=4 {
            let widths = Attributes::widths_of_bands(bands);
            let mut next = 0.0;
            let mut count = |width: usize| -> Vec<f32> {
                (0..5 * width)
                    .map(|_| {
                        next += 1.0;
                        next
                    })
                    .collect()
            };
            let attributes = widths.map(&mut count);
            let model = Gaussians::of_attributes(attributes.clone(), bands);
            assert_eq!((model.len(), model.sh.len()), (5, bands));
            assert_eq!(model.attributes().map(<[f32]>::to_vec), attributes);
            assert!(model.validate().is_ok() || bands == 0);
            let numbers: Vec<f32> = (1..=next as usize).map(|number| number as f32).collect();
            assert_eq!(model.bytes().collect::<Vec<_>>().concat(), bytemuck::cast_slice::<f32, u8>(&numbers));
        }
    }

    #[test]
    fn order_holds_whatever_is_done() {
        let names = Attributes::NAMES.into_array();
        assert_eq!(Attributes::NAMES.up_to(1).collect::<Vec<_>>(), names[..6]);
        assert_eq!(Attributes::NAMES.up_to(3).count(), names.len());
        let mut seen = Vec::new();
        let both = Attributes::NAMES.zip(Attributes::widths(3)).map(|(name, width)| {
            seen.push(name);
            (name, width)
        });
        assert_eq!(seen, names);
        assert_eq!(both.each_ref().into_array().map(|(name, _)| *name), names);
        assert_eq!(both.sh[2], ("sh2", 15));
        let stopped = Attributes::NAMES.try_map(|name| if name == "rotations" { Err(name) } else { Ok(()) });
        assert_eq!(stopped, Err("rotations"));
    }
}
