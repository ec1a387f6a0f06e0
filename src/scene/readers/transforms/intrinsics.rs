//! Intrinsics in transforms files: of the file or of one of its frames.

use std::f64::consts::PI;

use glam::DVec2;
use serde::Deserialize;
use serde_json::Value;

use crate::scene::lens::{Curve, Distortion, Lens, LensModel};

/// Intrinsics of the file or of one of its frames.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Intrinsics {
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    width: Option<f64>,
    height: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    #[serde(deserialize_with = "super::fields::text")]
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    equirectangular: Option<bool>,
    latlong: Option<bool>,
    ftheta_p0: Option<f64>,
    x_fov: Option<f64>,
    y_fov: Option<f64>,
    distortion_params: Option<Vec<f64>>,
    /// Rows of NeuS2's matrix: focal lengths and principal point.
    intrinsic_matrix: Value,
}

/// Below this part of the photo's side, a focal length is not in pixels: lenses that see 170 degrees have one of 0.04 of it.
const SHARE: f64 = 0.04;

/// Largest offset of a principal point from the middle, as a part of the side, in a photo that is no crop.
const NEAR_MIDDLE: f64 = 0.1;
/// Least difference of such offsets that tells which of two sizes is meant.
const CLEARLY: f64 = 0.05;

/// Models whose parameters have no names in these files.
const UNNAMED: [LensModel; 5] =
    [LensModel::ThinPrismFisheye, LensModel::Fov, LensModel::SimpleDivision, LensModel::Division, LensModel::Eucm];

/// Project Aria's name of COLMAP's `RAD_TAN_THIN_PRISM_FISHEYE`, which nerfstudio writes.
const FISHEYE624: &str = "FISHEYE624";

impl Intrinsics {
    /// The intrinsics that a file or a frame gives, under the usual names.
    pub fn of(json: &Value) -> Result<Self, String> {
        let mut found: Self = super::fields::fields(json)?;
        // nerfstudio's order.
        if let Some(&[k1, k2, k3, k4, p1, p2]) = found.distortion_params.as_deref() {
            (found.k1, found.k2, found.k3, found.k4) = (Some(k1), Some(k2), Some(k3), Some(k4));
            (found.p1, found.p2) = (Some(p1), Some(p2));
        }
        let entry = |(row, column): (usize, usize)| found.intrinsic_matrix.get(row)?.get(column)?.as_f64();
        let [fx, fy, cx, cy] = [(0, 0), (1, 1), (0, 2), (1, 2)].map(entry);
        // instant-ngp's flags of lenses.
        let flags = [
            (found.equirectangular == Some(true), "EQUIRECTANGULAR"),
            (found.latlong == Some(true), "latlong"),
            (found.ftheta_p0.is_some(), "ftheta"),
        ];
        let flagged = flags.into_iter().find(|(is_set, _)| *is_set).map(|(_, name)| name.to_owned());
        Ok(Self {
            camera_model: flagged.or(found.camera_model),
            camera_angle_x: found.camera_angle_x.or(found.x_fov.map(f64::to_radians)),
            camera_angle_y: found.camera_angle_y.or(found.y_fov.map(f64::to_radians)),
            fl_x: found.fl_x.or(found.fx).or(fx),
            fl_y: found.fl_y.or(found.fy).or(fy),
            cx: found.cx.or(cx),
            cy: found.cy.or(cy),
            w: found.w.or(found.width),
            h: found.h.or(found.height),
            ..found
        })
    }

    /// The frame's own values if given, otherwise the file's; a frame's own field of view or focal length replaces both of the file's.
    pub fn over(&self, common: &Self) -> Self {
        let upright = self.camera_angle_y.is_some() && self.fl_y.is_none();
        let own = self.camera_angle_x.is_some() || self.fl_x.is_some() || upright;
        let focal = |frame: Option<f64>, file: Option<f64>| if own { frame } else { frame.or(file) };
        Self {
            fl_x: focal(self.fl_x, common.fl_x),
            fl_y: focal(self.fl_y, common.fl_y),
            camera_angle_x: focal(self.camera_angle_x, common.camera_angle_x),
            camera_angle_y: focal(self.camera_angle_y, common.camera_angle_y),
            cx: self.cx.or(common.cx),
            cy: self.cy.or(common.cy),
            w: self.w.or(common.w),
            h: self.h.or(common.h),
            k1: self.k1.or(common.k1),
            k2: self.k2.or(common.k2),
            k3: self.k3.or(common.k3),
            k4: self.k4.or(common.k4),
            k5: self.k5.or(common.k5),
            k6: self.k6.or(common.k6),
            p1: self.p1.or(common.p1),
            p2: self.p2.or(common.p2),
            camera_model: self.camera_model.clone().or_else(|| common.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(common.is_fisheye),
            distortion_params: self.distortion_params.clone().or_else(|| common.distortion_params.clone()),
            ..Self::default()
        }
    }

    /// Width and height if given; absurd ones become 0, which no lens accepts.
    pub fn size(&self) -> Option<(u32, u32)> {
        let whole = |x: f64| x.round() as u32; // saturates; NaN gives 0
        Some((whole(self.w?), whole(self.h?)))
    }

    /// Width and height for which a frame's own values, with those of the file where it gives none, hold: as given, else those of its
    /// photo. If the frame gives cx and cy, but the file the size, and the photo has another, the size of the two to whose middle they
    /// are nearer. The fault is a sentence.
    pub fn size_of_frame(
        &self,
        common: &Self,
        photo: impl FnOnce() -> Option<(u32, u32)>,
    ) -> Result<Option<(u32, u32)>, String> {
        let Some(size) = self.over(common).size() else { return Ok(photo()) };
        let (None, None, Some(cx), Some(cy)) = (self.w, self.h, self.cx, self.cy) else { return Ok(Some(size)) };
        let differs = |(w, h): &(u32, u32)| {
            [(*w, size.0), (*h, size.1)].into_iter().any(|(a, b)| f64::from(a.abs_diff(b)) > super::ROUNDED)
        };
        let Some(photo) = photo().filter(differs) else { return Ok(Some(size)) };
        let off = |(w, h): (u32, u32)| (cx / f64::from(w) - 0.5).abs().max((cy / f64::from(h) - 0.5).abs());
        let (nearer, other) = if off(photo) < off(size) { (photo, size) } else { (size, photo) };
        if off(nearer) <= NEAR_MIDDLE || off(other) > off(nearer) + CLEARLY {
            return Ok(Some(nearer));
        }
        let [(w, h), (wide, high)] = [photo, size];
        Err(format!(
            "gives cx {cx} and cy {cy}, but neither w nor h: its photo is {w} x {h}, and the file says {wide} x {high}; give the \
             frame the w and h for which its numbers hold"
        ))
    }

    /// The side that it gives without the other, with its name.
    pub fn lone_side(&self) -> Option<(&'static str, f64)> {
        match (self.w, self.h) {
            (Some(w), None) => Some(("w", w)),
            (None, Some(h)) => Some(("h", h)),
            _ => None,
        }
    }

    /// True if it says both that the lens is a fisheye and that it is none.
    pub fn contradicts_itself(&self) -> bool {
        let named = self.camera_model.as_deref().and_then(|name| LensModel::from_name(&name.to_uppercase()));
        let straight = |model: LensModel| !model.is_fisheye() && model != LensModel::Equirectangular;
        self.is_fisheye == Some(true) && named.is_some_and(straight)
    }

    /// The model of the lens; the fault names the models that these files can give.
    pub fn model(&self) -> Result<LensModel, String> {
        let Some(name) = self.camera_model.as_deref() else {
            return Ok(if self.is_fisheye == Some(true) { LensModel::OpenCvFisheye } else { LensModel::OpenCv });
        };
        let upper = name.to_uppercase();
        match upper.as_str() {
            "PERSPECTIVE" => return Ok(LensModel::OpenCv),
            FISHEYE624 => return Ok(LensModel::RadTanThinPrismFisheye),
            _ => {}
        }
        let known = LensModel::ALL.into_iter().filter(|model| !UNNAMED.contains(model));
        let found = known.clone().find(|model| model.name() == upper);
        found.ok_or_else(|| LensModel::unsupported(name, known))
    }

    /// The distortion of a lens of this model; the fault is a sentence.
    fn distortion(&self, model: LensModel) -> Result<Distortion, String> {
        let listed = self.distortion_params.as_deref().unwrap_or_default();
        let count = listed.len();
        if model == LensModel::RadTanThinPrismFisheye {
            let (&[radial, after], []) = listed.as_chunks::<6>() else {
                return Err(format!(
                    "its distortion_params has {count} numbers, not the twelve of {FISHEYE624} ({}): k0 to k5, p0, p1 and s0 to s3",
                    model.name()
                ));
            };
            return Ok(Distortion { curve: Curve::Angle, radial, after, ..Distortion::default() });
        }
        if !matches!(count, 0 | 6) {
            return Err(format!(
                "its distortion_params has {count} numbers, not the six k1, k2, k3, k4, p1 and p2: write them under these names"
            ));
        }
        let curve = if model.is_fisheye() { Curve::Angle } else { Curve::Straight };
        let k = [self.k1, self.k2, self.k3, self.k4, self.k5, self.k6].map(|k| k.unwrap_or(0.0));
        let (radial, denominator) = if model == LensModel::FullOpenCv {
            ([k[0], k[1], k[2], 0.0, 0.0, 0.0], [k[3], k[4], k[5]])
        } else {
            ([k[0], k[1], k[2], k[3], 0.0, 0.0], [0.0; 3])
        };
        let tangential = if model.is_fisheye() { [0.0; 2] } else { [self.p1, self.p2].map(|p| p.unwrap_or(0.0)) };
        Ok(Distortion { curve, radial, denominator, tangential, ..Distortion::default() })
    }

    /// The lens of this model on a photo of `width` x `height` pixels; the fault is a sentence.
    pub fn lens(&self, model: LensModel, width: u32, height: u32) -> Result<Lens, String> {
        let distortion = self.distortion(model)?;
        if model == LensModel::Equirectangular {
            // All directions, whatever focal length is given.
            return Lens::panorama(width.into(), height.into());
        }
        let size = DVec2::new(f64::from(width), f64::from(height));
        for angle in [self.camera_angle_x, self.camera_angle_y].into_iter().flatten() {
            if !(angle > 0.0 && angle < PI) {
                return Err(format!("its camera_angle {angle} is not an angle of view in radians; is it in degrees?"));
            }
        }
        let from_angle = |extent: f64, angle: f64| 0.5 * extent / (0.5 * angle).tan();
        let fx = self.fl_x.or_else(|| self.camera_angle_x.map(|a| from_angle(size.x, a)));
        let fy = self.fl_y.or_else(|| match (self.fl_x, self.camera_angle_y) {
            (None, Some(angle)) => Some(from_angle(size.y, angle)),
            _ => fx,
        });
        let (Some(fx), Some(fy)) = (fx.or(fy), fy) else {
            return Err("gives neither fl_x nor camera_angle_x; add one".to_owned());
        };
        for (name, focal, side, of) in [("fl_x", self.fl_x, width, "w"), ("fl_y", self.fl_y, height, "h")] {
            if let Some(focal) = focal.filter(|focal| *focal > 0.0 && *focal < SHARE * f64::from(side)) {
                return Err(format!(
                    "its {name} {focal} is not a focal length in pixels of a photo of {width} x {height}: multiply shares of \
                     the photo's size by {of}"
                ));
            }
        }
        let principal = DVec2::new(self.cx.unwrap_or(0.5 * size.x), self.cy.unwrap_or(0.5 * size.y));
        let model = if distortion == Distortion::default() { LensModel::Pinhole } else { model };
        Lens { model, width, height, focal: DVec2::new(fx, fy), principal, distortion }.checked()
    }
}
