//! All figures of one picture or of a test split, and the networks that LPIPS needs.

use super::{Error, Image, Kind, Lpips, Range, psnr, round_trip_8bit, ssim};
use std::path::Path;

/// The available LPIPS networks; each may be missing.
#[derive(Default)]
pub struct Networks {
    /// VGG16, which the 3DGS papers use.
    pub vgg: Option<Lpips>,
    /// AlexNet.
    pub alex: Option<Lpips>,
}

impl Networks {
    /// Reads `given` (`--lpips-weights`: a file, or a folder with `lpips-vgg.safetensors` and
    /// `lpips-alex.safetensors`), otherwise the path in `QIRF_LPIPS`, otherwise the user's data folder, where missing
    /// files are not an error.
    ///
    /// # Errors
    /// [`Error::Read`] and [`Error::Weights`] for a named file that cannot be used, or a broken one.
    pub fn find(given: Option<&Path>) -> Result<Self, Error> {
        let named = std::env::var_os("QIRF_LPIPS").filter(|v| !v.is_empty());
        match (given, &named) {
            (Some(path), _) => Self::named(path),
            (None, Some(path)) => Self::named(Path::new(path)),
            (None, None) => match dirs::data_dir() {
                Some(data) => Self::folder(&data.join("qirf-vk")),
                None => Ok(Self::default()),
            },
        }
    }

    /// A line for the records if VGG16, the network of the papers, is missing.
    pub fn note(&self) -> Option<&'static str> {
        self.vgg.is_none().then_some("no VGG16 weights were found, so lpips_vgg is left out")
    }

    fn named(path: &Path) -> Result<Self, Error> {
        if !path.is_dir() {
            let lpips = Lpips::load(path)?;
            return Ok(match lpips.kind() {
                Kind::Vgg => Self { vgg: Some(lpips), alex: None },
                Kind::Alex => Self { vgg: None, alex: Some(lpips) },
            });
        }
        let found = Self::folder(path)?;
        if found.vgg.is_none() && found.alex.is_none() {
            let wanted = path.join("lpips-vgg.safetensors");
            return Err(Error::Read { path: wanted, source: std::io::ErrorKind::NotFound.into() });
        }
        Ok(found)
    }

    fn folder(folder: &Path) -> Result<Self, Error> {
        let load = |kind: Kind| {
            let path = folder.join(format!("lpips-{kind}.safetensors"));
            if !path.exists() {
                return Ok(None);
            }
            let lpips = Lpips::load(&path)?;
            let held = lpips.kind();
            if held == kind { Ok(Some(lpips)) } else { Err(Error::weights(&path, format!("holds the {held} network"))) }
        };
        Ok(Self { vgg: load(Kind::Vgg)?, alex: load(Kind::Alex)? })
    }
}

/// The figures of one picture, or their means; `None` (null in JSON) for an undefined figure, explained in `notes`. All are
/// `None` for a photo of which nothing counts.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Scores {
    /// PSNR in dB; `None` if it is infinite.
    pub psnr: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// LPIPS with VGG16, values fed unchanged in [0, 1], as the 3DGS papers report.
    pub lpips_vgg: Option<f64>,
    /// LPIPS with VGG16, values mapped to [-1, 1] as the network was calibrated.
    pub lpips_vgg_normalized: Option<f64>,
    /// LPIPS with AlexNet, values mapped to [-1, 1].
    pub lpips_alex: Option<f64>,
    /// Reasons for missing figures.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

impl Scores {
    /// The figures of a photo of which nothing counts: none.
    pub fn hidden() -> Self {
        Self { notes: vec!["no score: masks hide all that is compared".to_owned()], ..Self::default() }
    }

    /// Returns true if something of the photo counts.
    pub fn counts(&self) -> bool {
        self.ssim.is_some()
    }
}

/// All figures of `rendered` against `truth`, both after the 8-bit round trip. PSNR and SSIM are means over what the weights of
/// `truth` let count, LPIPS over the whole pictures.
///
/// # Errors
/// [`Error::Sizes`] if the sizes differ; an image too small for LPIPS is a note.
pub fn evaluate(rendered: &Image<'_>, truth: &Image<'_>, networks: &Networks) -> Result<Scores, Error> {
    rendered.same_size(truth)?;
    let (a, b) = (round_trip_8bit(rendered.pixels()), round_trip_8bit(truth.pixels()));
    let a = Image::new(rendered.width(), rendered.height(), &a)?;
    let b = Image::new(truth.width(), truth.height(), &b)?;
    let b = truth.weights().map_or(Ok(b), |weights| b.weighted(weights))?;
    let mut notes = Vec::new();
    let psnr = Some(psnr(&a, &b)?).filter(|v| v.is_finite());
    if psnr.is_none() {
        notes.push("psnr: infinite, the images are identical".to_owned());
    }
    let mut lpips = |network: Option<&Lpips>, range| match network.map(|n| n.distance(&a, &b, range)).transpose() {
        Err(small @ Error::TooSmall { .. }) => {
            let note = small.to_string();
            if !notes.contains(&note) {
                notes.push(note);
            }
            Ok(None)
        }
        other => other,
    };
    Ok(Scores {
        psnr,
        ssim: Some(ssim(&a, &b)?),
        lpips_vgg: lpips(networks.vgg.as_ref(), Range::Unit)?,
        lpips_vgg_normalized: lpips(networks.vgg.as_ref(), Range::Symmetric)?,
        lpips_alex: lpips(networks.alex.as_ref(), Range::Symmetric)?,
        notes,
    })
}

/// The means over the views of which something counts, or `None` without any; a figure that some of them lack is the mean of the
/// others, with a note.
pub fn mean(scores: &[Scores]) -> Option<Scores> {
    let counting: Vec<&Scores> = scores.iter().filter(|scores| scores.counts()).collect();
    if counting.is_empty() {
        return None;
    }
    let (views, hidden) = (counting.len(), scores.len() - counting.len());
    let mut notes = Vec::new();
    if hidden > 0 {
        notes.push(format!("mean of {views} of {} views: masks hide the others", scores.len()));
    }
    let mut over = |name: &str, values: Vec<Option<f64>>| {
        let present: Vec<f64> = values.into_iter().flatten().collect();
        if present.is_empty() {
            return None;
        }
        if present.len() < views {
            notes.push(format!("{name}: mean of {} of {views} views; it does not exist for the others", present.len()));
        }
        Some(present.iter().sum::<f64>() / present.len() as f64)
    };
    let each = |get: fn(&Scores) -> Option<f64>| counting.iter().map(|scores| get(scores)).collect::<Vec<_>>();
    let psnr = over("psnr", each(|s| s.psnr));
    let ssim = over("ssim", each(|s| s.ssim));
    let lpips_vgg = over("lpips_vgg", each(|s| s.lpips_vgg));
    let lpips_vgg_normalized = over("lpips_vgg_normalized", each(|s| s.lpips_vgg_normalized));
    let lpips_alex = over("lpips_alex", each(|s| s.lpips_alex));
    if psnr.is_none() {
        notes.push("psnr: infinite, all images are identical".to_owned());
    }
    Some(Scores { psnr, ssim, lpips_vgg, lpips_vgg_normalized, lpips_alex, notes })
}
