//! Concatenation of models.

use super::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{Loaded, RenderMode};
use std::path::PathBuf;

/// Concatenates several models, with the highest SH degree among them (missing bands are zero), and returns their render mode.
/// `asked` overrides the modes of the files.
///
/// # Errors [`Error::Modes`] names two files with different render modes.
pub fn merge(models: Vec<(PathBuf, Loaded)>, asked: Option<RenderMode>) -> Result<(Gaussians, RenderMode), Error> {
    let mut whole: Option<(Gaussians, PathBuf, RenderMode)> = None;
    for (path, Loaded { gaussians, mode, .. }) in models {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::formats::{Format, Repairs};

    fn loaded(n: usize, degree: usize, mode: RenderMode) -> (PathBuf, Loaded) {
        let mut gaussians = Gaussians::zeroed(n, degree);
        gaussians.sh.iter_mut().flatten().for_each(|x| *x = n as f32);
        let loaded =
            Loaded { gaussians, format: Format::Ply, mode, doubt: None, repairs: Repairs::default(), origin: [0.0; 3] };
        (format!("{n}.ply").into(), loaded)
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
