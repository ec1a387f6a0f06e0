//! Operations on whole models: allocation, selection, bounds, consistency.

use std::borrow::Cow;

use glam::{DMat3, DQuat, DVec3, DVec4};
use rayon::prelude::*;

use super::band_rotations::rotate_bands;
use super::{Attributes, Error, Gaussians, MAX_SH_DEGREE, MIN_QUATERNION};

/// A quaternion all of whose components are smaller is normalised: pictures leave out lengths below 1e-6.
const SHORT: f32 = 1e-5;

/// Log-scales of models from arrays are below this. The projection leaves out a Gaussian whose length in pixels has a square beyond float32
/// (2^64 pixels). One of e^30 world units is drawn at any depth that shows a world unit with up to a million pixels.
const LARGEST: f32 = 30.0;

/// True for a Gaussian so large that pictures may leave it out.
pub(super) fn is_huge(log_scales: &[f32; 3]) -> bool {
    log_scales.iter().any(|s| *s >= LARGEST)
}

/// Normalises a quaternion that is too short to be drawn, but not zero; whether it was one.
pub(super) fn lengthen(quaternion: &mut [f32; 4]) -> bool {
    let short = *quaternion != [0.0; 4] && quaternion.iter().all(|c| c.abs() < SHORT);
    if short {
        let exact = DVec4::from(quaternion.map(f64::from));
        *quaternion = (exact / exact.length()).as_vec4().to_array();
    }
    short
}

impl Gaussians {
    /// A model of `n` Gaussians of SH degree `degree` whose stored values are all zero.
    pub fn zeroed(n: usize, degree: usize) -> Self {
        Self::of_attributes(Attributes::widths(degree).map(|width| vec![0.0; n * width]), degree + 1)
    }

    /// A model of grey balls at these places, all of one size and opacity.
    pub fn balls(means: Vec<[f32; 3]>, log_scale: f32, opacity_logit: f32, degree: usize) -> Self {
        let n = means.len();
        Self {
            means,
            log_scales: vec![[log_scale; 3]; n],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![opacity_logit; n],
            ..Self::zeroed(n, degree)
        }
    }

    /// The Gaussians at `indices`, in that order; an index may occur more than once.
    ///
    /// # Panics
    /// If an index is not below [`Gaussians::len`], as slice indexing does.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        let picked = |(values, width): (&[f32], usize)| -> Vec<f32> {
            indices.iter().flat_map(|&i| &values[i * width..(i + 1) * width]).copied().collect()
        };
        let bands = self.sh.len();
        Self::of_attributes(self.attributes().zip(Attributes::widths_of_bands(bands)).map(picked), bands)
    }

    /// Moves all means, in world units.
    pub fn shift(&mut self, by: DVec3) {
        if by != DVec3::ZERO {
            self.means.iter_mut().for_each(|m| *m = (DVec3::from(m.map(f64::from)) + by).as_vec3().to_array());
        }
    }

    /// Applies x -> scale * rotation * x + shift to all Gaussians, including spherical harmonics; in float64, rounded once.
    /// `rotation` is orthonormal and may mirror; `scale` is above 0.
    pub(crate) fn transform(&mut self, rotation: DMat3, scale: f64, shift: DVec3) {
        if scale != 1.0 || rotation != DMat3::IDENTITY || shift != DVec3::ZERO {
            self.means.par_iter_mut().for_each(|mean| {
                let moved = rotation * DVec3::from_array(mean.map(f64::from)) * scale + shift;
                *mean = moved.to_array().map(|x| x as f32);
            });
        }
        if scale != 1.0 {
            let more = scale.ln();
            self.log_scales.as_flattened_mut().par_iter_mut().for_each(|s| *s = (f64::from(*s) + more) as f32);
        }
        if rotation == DMat3::IDENTITY {
            return;
        }
        // An ellipsoid is its own mirror image through its centre: a mirror turns it as the opposite matrix does.
        let proper = if rotation.determinant() < 0.0 { -rotation } else { rotation };
        let turn = DQuat::from_mat3(&proper);
        self.rotations.par_iter_mut().for_each(|quaternion| {
            let [w, x, y, z] = quaternion.map(f64::from);
            let turned = turn * DQuat::from_xyzw(x, y, z, w);
            *quaternion = [turned.w, turned.x, turned.y, turned.z].map(|q| q as f32);
        });
        rotate_bands(&mut self.sh, rotation);
    }

    /// The model with all lengths times `factor`.
    pub fn scaled(&self, factor: f64) -> Cow<'_, Self> {
        if factor == 1.0 {
            return Cow::Borrowed(self);
        }
        let mut model = self.clone();
        model.means.iter_mut().flatten().for_each(|v| *v = (f64::from(*v) * factor) as f32);
        let longer = factor.ln();
        model.log_scales.iter_mut().flatten().for_each(|v| *v = (f64::from(*v) + longer) as f32);
        Cow::Owned(model)
    }

    /// Adds the Gaussians of another model behind these; bands that one of the two lacks are zero.
    pub fn append(&mut self, other: &Self) {
        let bands = self.sh.len().max(other.sh.len());
        for l in 0..bands {
            let width = Self::band_width(l);
            if l == self.sh.len() {
                self.sh.push(vec![0.0; self.len() * width]);
            }
            match other.sh.get(l) {
                Some(band) => self.sh[l].extend(band),
                None => self.sh[l].extend(std::iter::repeat_n(0.0, other.len() * width)),
            }
        }
        self.means.extend(&other.means);
        self.log_scales.extend(&other.log_scales);
        self.rotations.extend(&other.rotations);
        self.opacity_logits.extend(&other.opacity_logits);
    }

    /// Takes memory for exactly so many more Gaussians.
    pub(crate) fn reserve(&mut self, more: usize) {
        self.means.reserve_exact(more);
        self.log_scales.reserve_exact(more);
        self.rotations.reserve_exact(more);
        self.opacity_logits.reserve_exact(more);
        for (l, band) in self.sh.iter_mut().enumerate() {
            band.reserve_exact(more * Self::band_width(l));
        }
    }

    /// Keeps the Gaussians whose flag is set, n, in their order and in place: no attribute is copied.
    ///
    /// # Panics
    /// If there is not one flag for each Gaussian.
    pub fn compact(&mut self, kept: &[bool]) {
        assert_eq!(kept.len(), self.len(), "one flag for each Gaussian");
        let Self { means, log_scales, rotations, opacity_logits, sh } = self;
        rayon::scope(|scope| {
            for (l, band) in sh.iter_mut().enumerate() {
                scope.spawn(move |_| compact_rows(band, Self::band_width(l), kept));
            }
            scope.spawn(|_| compact_values(means, kept));
            scope.spawn(|_| compact_values(log_scales, kept));
            scope.spawn(|_| compact_values(rotations, kept));
            scope.spawn(|_| compact_values(opacity_logits, kept));
        });
    }

    /// Least and greatest coordinates of the finite centres in world units; `None` if there are none.
    pub fn bounds(&self) -> Option<([f32; 3], [f32; 3])> {
        let mut finite = self.means.iter().filter(|mean| mean.iter().all(|x| x.is_finite()));
        let first = *finite.next()?;
        Some(finite.fold((first, first), |(mut low, mut high), mean| {
            for axis in 0..3 {
                low[axis] = low[axis].min(mean[axis]);
                high[axis] = high[axis].max(mean[axis]);
            }
            (low, high)
        }))
    }

    /// Number of Gaussians that pictures leave out: those that are not [`Gaussians::drawable`], and those of e^30 world units and
    /// more: close cameras leave them out from that size on, usual ones from about e^43 on.
    pub fn undrawable(&self) -> usize {
        (0..self.len()).filter(|i| !self.drawable(*i) || is_huge(&self.log_scales[*i])).count()
    }

    /// False for a Gaussian that the projection leaves out in every picture, because a value is not finite (infinite opacity
    /// logits excepted), or the largest component of the quaternion is below [`MIN_QUATERNION`].
    ///
    /// # Panics
    /// If `i` is not below [`Gaussians::len`].
    pub fn drawable(&self, i: usize) -> bool {
        self.drawable_turn(i) && self.is_finite(i)
    }

    /// Whether all values of Gaussian `i` are finite, infinite opacity logits excepted.
    pub(crate) fn is_finite(&self, i: usize) -> bool {
        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        let band = |(l, band): (usize, &Vec<f32>)| {
            let width = Self::band_width(l);
            band.get(i * width..(i + 1) * width).is_none_or(finite)
        };
        let shaped = finite(&self.means[i]) && finite(&self.log_scales[i]) && finite(&self.rotations[i]);
        shaped && !self.opacity_logits[i].is_nan() && self.sh.iter().enumerate().all(band)
    }

    /// Whether a quaternion is long enough to be a rotation.
    fn drawable_turn(&self, i: usize) -> bool {
        self.rotations[i].iter().fold(0.0_f32, |m, q| m.max(q.abs())) >= MIN_QUATERNION
    }

    /// The model, if its arrays agree and every Gaussian can be drawn and trained; for models that come from no reader,
    /// since readers repair. Rotations that are too short to be drawn are lengthened, as readers do.
    ///
    /// # Errors
    /// [`Error::Inconsistent`] names the array, or the first bad Gaussian and its fault.
    pub fn checked(mut self) -> Result<Self, Error> {
        self.validate()?;
        for quaternion in &mut self.rotations {
            lengthen(quaternion);
        }
        let wrong =
            |i: usize| !self.drawable(i) || self.opacity_logits[i].is_infinite() || is_huge(&self.log_scales[i]);
        let Some(i) = (0..self.len()).find(|i| wrong(*i)) else { return Ok(self) };
        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        let what = if !finite(&self.means[i]) {
            "its mean is not finite"
        } else if !finite(&self.log_scales[i]) {
            "its log_scales are not finite; the logarithm of a flat axis may be -20"
        } else if is_huge(&self.log_scales[i]) {
            "its log_scales are too large to be drawn: they are natural logarithms, and should be less than 30"
        } else if !finite(&[self.opacity_logits[i]]) {
            "its opacity_logit is not finite; -20 is transparent, and 20 opaque"
        } else if !finite(&self.rotations[i]) {
            "its rotation is not finite"
        } else if self.drawable_turn(i) {
            "its spherical harmonics are not finite"
        } else {
            "its rotation, a quaternion w, x, y, z, is zero"
        };
        Err(Error::Inconsistent { what: format!("Gaussian {i}: {what}") })
    }

    /// Checks that all arrays have the same length and that the SH degree is at most [`MAX_SH_DEGREE`].
    ///
    /// # Errors
    /// [`Error::Inconsistent`] names the array that differs. A default (empty) model without any band passes.
    pub fn validate(&self) -> Result<(), Error> {
        let n = self.len();
        let differs = |name: String, length: usize, expected: usize| {
            Err(Error::Inconsistent {
                what: format!("{name} has {length} entries, {expected} expected for {n} Gaussians"),
            })
        };
        if self.log_scales.len() != n {
            return differs("log_scales".into(), self.log_scales.len(), n);
        }
        if self.rotations.len() != n {
            return differs("rotations".into(), self.rotations.len(), n);
        }
        if self.opacity_logits.len() != n {
            return differs("opacity_logits".into(), self.opacity_logits.len(), n);
        }
        if self.sh.len() > MAX_SH_DEGREE + 1 || (self.sh.is_empty() && n > 0) {
            return Err(Error::Inconsistent {
                what: format!("{} SH bands, 1 to {} expected", self.sh.len(), MAX_SH_DEGREE + 1),
            });
        }
        for (l, band) in self.sh.iter().enumerate() {
            if band.len() != n * Self::band_width(l) {
                return differs(format!("SH band {l}"), band.len(), n * Self::band_width(l));
            }
        }
        Ok(())
    }
}

fn compact_values<T>(values: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    values.retain(|_| kept.next().copied().unwrap_or(false));
}

fn compact_rows(values: &mut Vec<f32>, width: usize, kept: &[bool]) {
    let mut end = 0;
    for i in (0..kept.len()).filter(|i| kept[*i]) {
        values.copy_within(i * width..(i + 1) * width, end);
        end += width;
    }
    values.truncate(end);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_from_arrays_are_checked() {
        let mut model = Gaussians::balls(vec![[0.0; 3]; 3], 0.0, 0.0, 1);
        model.log_scales[2] = [29.9, -200.0, 0.0];
        assert_eq!(model.clone().checked().unwrap(), model);
        let mut short = model.clone();
        short.rotations[1] = [0.0, 3.0, 0.0, -4.0].map(|q| q * 2.0_f32.powi(-60));
        assert_eq!(short.checked().unwrap().rotations[1], [0.0, 0.6, 0.0, -0.8]);
        let refused = |change: &dyn Fn(&mut Gaussians)| {
            let mut model = model.clone();
            change(&mut model);
            model.checked().unwrap_err().to_string()
        };
        for (change, said) in [
            (&(|m: &mut Gaussians| m.means[1][2] = f32::NAN) as &dyn Fn(&mut Gaussians), "Gaussian 1: its mean"),
            (&|m| m.log_scales[2][0] = f32::NEG_INFINITY, "Gaussian 2: its log_scales"),
            (&|m| m.log_scales[1][2] = 30.0, "Gaussian 1: its log_scales are too large"),
            (&|m| m.opacity_logits[0] = f32::INFINITY, "Gaussian 0: its opacity_logit"),
            (&|m| m.rotations[1] = [0.0; 4], "is zero"),
            (&|m| m.rotations[1][3] = f32::NAN, "Gaussian 1: its rotation is not finite"),
            (&|m| m.sh[1][9] = f32::NAN, "Gaussian 1: its spherical harmonics"),
            (&|m| m.sh[0].truncate(8), "SH band 0 has 8 entries, 9 expected"),
        ] {
            let told = refused(change);
            assert!(told.contains(said), "{told}");
        }
    }

    #[test]
    fn compaction_in_place_is_selection() {
        let mut model = Gaussians::zeroed(9, 3);
        let mut next = 0.0;
        for values in model.attributes_mut().into_array() {
            for value in values {
                next += 1.0;
                *value = next;
            }
        }
        for kept in [[true; 9], [false; 9], [true, false, false, true, true, false, true, true, false]] {
            let numbers: Vec<usize> = (0..9).filter(|i| kept[*i]).collect();
            let mut compacted = model.clone();
            compacted.compact(&kept);
            assert_eq!(compacted, model.select(&numbers));
            compacted.validate().unwrap();
        }
    }

    #[test]
    fn what_the_projection_leaves_out_is_counted() {
        let mut model = Gaussians::zeroed(8, 1);
        model.rotations.fill([0.0, 0.0, -1e-3, 0.0]);
        model.opacity_logits[0] = f32::INFINITY;
        assert_eq!(model.undrawable(), 0);
        model.rotations[1] = [0.0; 4];
        model.rotations[2] = [1e-20; 4];
        model.means[3][2] = f32::NAN;
        model.log_scales[4][0] = f32::INFINITY;
        model.sh[1][5 * 9 + 8] = f32::NAN;
        model.opacity_logits[6] = f32::NAN;
        model.log_scales[7][1] = 50.0;
        assert_eq!((model.undrawable(), model.drawable(7)), (7, true));
    }

    fn three() -> Gaussians {
        let mut model = Gaussians::zeroed(3, 1);
        for i in 0..3 {
            model.means[i] = [i as f32, -(i as f32), 0.0];
            model.opacity_logits[i] = i as f32;
        }
        for (i, value) in model.sh[1].iter_mut().enumerate() {
            *value = i as f32;
        }
        model
    }

    #[test]
    fn selection_carries_every_array() {
        let picked = three().select(&[2, 0]);
        assert_eq!(picked.means, [[2.0, -2.0, 0.0], [0.0, 0.0, 0.0]]);
        assert_eq!(picked.opacity_logits, [2.0, 0.0]);
        assert_eq!(picked.sh[1][..9], three().sh[1][18..27]);
        assert!(picked.validate().is_ok());
    }

    #[test]
    fn appended_models_have_the_bands_of_both() {
        let (one, two) = (three(), three().select(&[2]));
        let mut both = one.clone();
        both.append(&two);
        assert!(both == one.select(&[0, 1, 2, 2]) && both.validate().is_ok());
        let flat = Gaussians::zeroed(2, 0);
        let mut grown = flat.clone();
        grown.append(&one);
        assert!(grown.validate().is_ok() && grown.select(&[2, 3, 4]) == one);
        assert_eq!(grown.sh[1][..18], [0.0; 18]);
        let mut shrunk = one.clone();
        shrunk.append(&flat);
        assert!(shrunk.validate().is_ok() && shrunk.len() == 5 && shrunk.sh[1][27..] == [0.0; 18]);
        let mut none = Gaussians::default();
        none.append(&one);
        assert_eq!(none, one);
    }

    #[test]
    fn bounds_ignore_what_is_not_finite() {
        let mut model = three();
        model.means[1][0] = f32::NAN;
        assert_eq!(model.bounds(), Some(([0.0, -2.0, 0.0], [2.0, 0.0, 0.0])));
        assert_eq!(Gaussians::default().bounds(), None);
    }

    #[test]
    fn validation_names_the_array() {
        let mut model = three();
        model.sh[1].pop();
        assert!(model.validate().unwrap_err().to_string().contains("SH band 1 has 26 entries"));
        assert!(Gaussians::default().validate().is_ok());
    }
}
