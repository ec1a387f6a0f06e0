//! Concatenation of models.

use super::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{Loaded, RenderMode};
use crate::scene::origin::near;
use glam::DVec3;
use std::path::PathBuf;

/// Concatenates several models, with the highest SH degree among them (missing bands are zero), and returns their render mode.
/// `asked` overrides the modes of the files.
///
/// # Errors [`Error::Modes`] names two files with different render modes.
pub fn merge(models: Vec<(PathBuf, Loaded)>, asked: Option<RenderMode>) -> Result<(Gaussians, RenderMode), Error> {
    let mut whole: Option<(Gaussians, PathBuf, RenderMode)> = None;
    // A model without Gaussians has no mode to disagree by, but the first one's counts if all are empty.
    let some = models.iter().any(|(_, loaded)| !loaded.gaussians.is_empty());
    for (path, Loaded { gaussians, mode, .. }) in models.into_iter().filter(|(_, m)| !some || !m.gaussians.is_empty()) {
        let mode = asked.unwrap_or(mode);
        match &mut whole {
            None => whole = Some((gaussians, path, mode)),
            Some((_, first, other)) if *other != mode => {
                return Err(Error::Modes(Box::new((first.clone(), *other)), Box::new((path, mode))));
            }
            Some((all, ..)) => all.append(&gaussians),
        }
    }
    Ok(whole.map_or_else(Default::default, |(all, _, mode)| (all, mode)))
}

/// The number in the files, one after the other, of each Gaussian of several models, without those that were removed on reading.
pub fn numbers(models: &[(PathBuf, Loaded)]) -> Vec<u32> {
    let mut numbers = Vec::new();
    let mut first = 0;
    for (_, Loaded { gaussians, removed, .. }) in models {
        let rows = gaussians.len() + removed.len();
        numbers.extend((0..rows).filter(|row| removed.binary_search(row).is_err()).map(|row| (first + row) as u32));
        first += rows;
    }
    numbers
}

/// The local origin for models with these origins: the first one's, unless another one's is much nearer to all of them.
pub fn common_origin(models: &[(&Gaussians, [f64; 3])]) -> [f64; 3] {
    let farthest = |from: [f64; 3]| {
        let middle = |(model, own): &(&Gaussians, [f64; 3])| box_of(model).0 + DVec3::from(*own) - DVec3::from(from);
        models.iter().map(|model| middle(model).abs().max_element()).fold(0.0, f64::max)
    };
    let first = models.first().map_or([0.0; 3], |(_, origin)| *origin);
    let others = models.iter().map(|(_, origin)| (farthest(*origin), *origin));
    let (reach, nearest) = others.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, first));
    if reach < 0.1 * farthest(first) { nearest } else { first }
}

/// The step of float32 in a model's positions, if it lies so far from its origin that the step matters.
pub fn rounding(model: &Gaussians) -> Option<f64> {
    let (middle, size) = box_of(model);
    (near(middle, size) != DVec3::ZERO).then(|| f64::from(f32::EPSILON) * middle.abs().max_element())
}

/// The warning about a step that [`rounding`] returns; `what` says where the model lies.
pub fn rounding_warning(what: &str, step: f64) -> String {
    format!("{what}: its positions are rounded to about {step:.1e} units")
}

/// What a user should know of a model that was read: an unclear tag, repairs, no Gaussian, positions that float32 rounds.
pub fn reading_warnings(loaded: &Loaded) -> Vec<String> {
    let model = &loaded.gaussians;
    let none = model.is_empty().then(|| "it holds no Gaussian".to_owned());
    let far = rounding(model).map(|step| rounding_warning("the model lies far from its origin", step));
    [loaded.doubt.clone(), loaded.remark(), none, far].into_iter().flatten().collect()
}

/// The middle of a model's box, and the length of its diagonal.
fn box_of(model: &Gaussians) -> (DVec3, f64) {
    let (low, high) = model.bounds().unwrap_or_default();
    let [low, high] = [low, high].map(|corner| DVec3::from(corner.map(f64::from)));
    (low.midpoint(high), low.distance(high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::formats::{Format, Repairs};

    fn loaded(n: usize, degree: usize, mode: RenderMode) -> (PathBuf, Loaded) {
        let mut gaussians = Gaussians::zeroed(n, degree);
        gaussians.sh.iter_mut().flatten().for_each(|x| *x = n as f32);
        let (format, repairs) = (Format::Ply, Repairs::default());
        let loaded = Loaded { gaussians, format, mode, doubt: None, repairs, removed: Vec::new(), origin: [0.0; 3] };
        (format!("{n}.ply").into(), loaded)
    }

    #[test]
    fn numbers_are_those_of_the_files() {
        let mut models = [loaded(3, 0, RenderMode::Plain), loaded(2, 0, RenderMode::Plain)];
        models[0].1.removed = vec![1, 4];
        models[1].1.removed = vec![0];
        assert_eq!(numbers(&models), [0, 2, 3, 6, 7]);
    }

    #[test]
    fn bands_are_aligned_and_modes_must_agree() {
        let plain = RenderMode::Plain;
        let (whole, mode) = merge(vec![loaded(2, 0, plain), loaded(3, 2, plain)], None).unwrap();
        assert_eq!((whole.len(), whole.degree(), mode), (5, 2, plain));
        whole.validate().unwrap();
        assert!(whole.sh[2][..2 * 15].iter().all(|x| *x == 0.0) && whole.sh[2][2 * 15..].iter().all(|x| *x == 3.0));
        let both = || vec![loaded(2, 0, plain), loaded(3, 2, RenderMode::AntiAliased)];
        let refused = merge(both(), None).unwrap_err().to_string();
        assert!(refused.contains("2.ply is plain and 3.ply is anti-aliased"), "{refused}");
        assert_eq!(merge(both(), Some(RenderMode::AntiAliased)).unwrap().1, RenderMode::AntiAliased);
    }
}
