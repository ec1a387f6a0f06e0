//! COLMAP's camera models: names, numbers and numbers of parameters.

/// COLMAP's camera models, by COLMAP's names.
#[allow(missing_docs)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LensModel {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    OpenCv,
    OpenCvFisheye,
    FullOpenCv,
    Fov,
    SimpleRadialFisheye,
    RadialFisheye,
    ThinPrismFisheye,
    RadTanThinPrismFisheye,
    SimpleDivision,
    Division,
    SimpleFisheye,
    Fisheye,
    Eucm,
    Equirectangular,
}

/// Model, COLMAP's number, COLMAP's name, number of parameters.
const MODELS: [(LensModel, i32, &str, usize); 18] = [
    (LensModel::SimplePinhole, 0, "SIMPLE_PINHOLE", 3),
    (LensModel::Pinhole, 1, "PINHOLE", 4),
    (LensModel::SimpleRadial, 2, "SIMPLE_RADIAL", 4),
    (LensModel::Radial, 3, "RADIAL", 5),
    (LensModel::OpenCv, 4, "OPENCV", 8),
    (LensModel::OpenCvFisheye, 5, "OPENCV_FISHEYE", 8),
    (LensModel::FullOpenCv, 6, "FULL_OPENCV", 12),
    (LensModel::Fov, 7, "FOV", 5),
    (LensModel::SimpleRadialFisheye, 8, "SIMPLE_RADIAL_FISHEYE", 4),
    (LensModel::RadialFisheye, 9, "RADIAL_FISHEYE", 5),
    (LensModel::ThinPrismFisheye, 10, "THIN_PRISM_FISHEYE", 12),
    (LensModel::RadTanThinPrismFisheye, 11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
    (LensModel::SimpleDivision, 12, "SIMPLE_DIVISION", 4),
    (LensModel::Division, 13, "DIVISION", 5),
    (LensModel::SimpleFisheye, 14, "SIMPLE_FISHEYE", 3),
    (LensModel::Fisheye, 15, "FISHEYE", 4),
    (LensModel::Eucm, 16, "EUCM", 6),
    (LensModel::Equirectangular, 17, "EQUIRECTANGULAR", 2),
];

impl LensModel {
    /// All models, in COLMAP's order.
    pub fn all() -> impl Iterator<Item = Self> {
        MODELS.iter().map(|m| m.0)
    }

    /// The model with COLMAP's number `id`.
    pub fn from_id(id: i32) -> Option<Self> {
        MODELS.iter().find(|m| m.1 == id).map(|m| m.0)
    }

    /// The model with COLMAP's name.
    pub fn from_name(name: &str) -> Option<Self> {
        MODELS.iter().find(|m| m.2 == name).map(|m| m.0)
    }

    /// COLMAP's number.
    pub fn id(self) -> i32 {
        MODELS[self as usize].1
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        MODELS[self as usize].2
    }

    /// Number of parameters that COLMAP stores.
    pub fn parameters(self) -> usize {
        MODELS[self as usize].3
    }

    /// True if its radius is the ray's angle.
    pub fn is_fisheye(self) -> bool {
        matches!(
            self,
            Self::OpenCvFisheye
                | Self::SimpleRadialFisheye
                | Self::RadialFisheye
                | Self::ThinPrismFisheye
                | Self::RadTanThinPrismFisheye
                | Self::SimpleFisheye
                | Self::Fisheye
        )
    }

    /// All names, for messages.
    pub(crate) fn names() -> String {
        MODELS.map(|m| m.2).join(", ")
    }
}
