//! COLMAP's camera models: names, numbers and numbers of parameters.

use crate::wording::named;

named! {
    /// COLMAP's camera models, by COLMAP's names, in the order of COLMAP's numbers.
    #[allow(missing_docs)]
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum LensModel {
        SimplePinhole = "SIMPLE_PINHOLE",
        Pinhole = "PINHOLE",
        SimpleRadial = "SIMPLE_RADIAL",
        Radial = "RADIAL",
        OpenCv = "OPENCV",
        OpenCvFisheye = "OPENCV_FISHEYE",
        FullOpenCv = "FULL_OPENCV",
        Fov = "FOV",
        SimpleRadialFisheye = "SIMPLE_RADIAL_FISHEYE",
        RadialFisheye = "RADIAL_FISHEYE",
        ThinPrismFisheye = "THIN_PRISM_FISHEYE",
        RadTanThinPrismFisheye = "RAD_TAN_THIN_PRISM_FISHEYE",
        SimpleDivision = "SIMPLE_DIVISION",
        Division = "DIVISION",
        SimpleFisheye = "SIMPLE_FISHEYE",
        Fisheye = "FISHEYE",
        Eucm = "EUCM",
        Equirectangular = "EQUIRECTANGULAR",
    }
}

/// Numbers of parameters that COLMAP stores.
const PARAMETERS: [usize; LensModel::ALL.len()] = [3, 4, 4, 5, 8, 8, 12, 5, 4, 5, 12, 16, 4, 5, 3, 4, 6, 2];

impl LensModel {
    /// The model with COLMAP's number `id`.
    pub fn from_id(id: i32) -> Option<Self> {
        Self::ALL.get(usize::try_from(id).ok()?).copied()
    }

    /// The model with COLMAP's name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// COLMAP's number.
    pub fn id(self) -> i32 {
        self as i32
    }

    /// Number of parameters that COLMAP stores.
    pub fn parameters(self) -> usize {
        PARAMETERS[self as usize]
    }

    /// Number of focal lengths among them, which come first: one for both axes, or two; the principal point follows.
    pub fn focal_lengths(self) -> usize {
        let single = self.name().starts_with("SIMPLE_") || matches!(self, Self::Radial | Self::RadialFisheye);
        if single { 1 } else { 2 }
    }

    /// True if its radius is the ray's angle.
    pub fn is_fisheye(self) -> bool {
        self.name().ends_with("FISHEYE")
    }

    /// The fault of a camera whose model, by its name or number, is not one of `known`, with the remedy.
    pub(crate) fn unsupported(model: &str, known: impl IntoIterator<Item = Self>) -> String {
        let known: Vec<&str> = known.into_iter().map(Self::name).collect();
        format!(
            "camera model {model} is not supported; known are {}; undistort the photos (those of a COLMAP model by `colmap \
             image_undistorter`), or pose them again with COLMAP's --ImageReader.camera_model OPENCV",
            known.join(", ")
        )
    }
}
