//! The fields of a transforms file that are no intrinsics, and its text.

use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::super::names::tidy;
use crate::wording::shown;

/// A frame: a photo and its pose.
#[derive(Deserialize)]
pub(super) struct Frame {
    pub file_path: String,
    #[serde(default)]
    pub transform_matrix: Value,
    /// instant-ngp's frames of a rolling shutter have two matrices: the first counts.
    #[serde(default)]
    pub transform_matrix_start: Value,
    #[serde(default, deserialize_with = "text")]
    pub mask_path: Option<String>,
    #[serde(default, deserialize_with = "text")]
    pub depth_file_path: Option<String>,
    #[serde(default, deserialize_with = "text")]
    pub depth_path: Option<String>,
    #[serde(default, deserialize_with = "or_default")]
    pub is_bad: bool,
}

/// The fields of an object; an error names the one at fault.
pub(super) fn fields<'de, T: Deserialize<'de>>(object: &'de Value) -> Result<T, String> {
    serde_path_to_error::deserialize(object).map_err(|e| e.to_string())
}

/// A text, if there is one: for an absent one, writers in Python give NaN, and others an empty one.
pub(super) fn text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<String>, D::Error> {
    Ok(Option::<String>::deserialize(deserializer)?.filter(|text| !matches!(text.as_str(), "" | "NaN")))
}

/// A field whose null says nothing.
pub(super) fn or_default<'de, T: Default + Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<T, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or_default())
}

impl Frame {
    /// The matrix of its pose.
    pub fn matrix(&self) -> &Value {
        let has_own = self.transform_matrix.is_array() && !is_unsaid(&self.transform_matrix);
        if has_own { &self.transform_matrix } else { &self.transform_matrix_start }
    }

    /// True for a photo that was not posed, which some writers list.
    pub fn is_unposed(&self) -> bool {
        is_unsaid(&self.transform_matrix) && is_unsaid(&self.transform_matrix_start)
    }
}

/// True for a matrix of which a file says nothing: null, or an empty list.
fn is_unsaid(matrix: &Value) -> bool {
    matrix.is_null() || matrix.as_array().is_some_and(Vec::is_empty)
}

/// The fault of a file that has no list of frames.
pub(super) fn without_frames(json: &Value) -> &'static str {
    if json.get(0).is_some_and(|pose| pose.get("transform").is_some()) {
        "is a list of poses, as nerfstudio's `ns-export cameras` writes it, in the world of a model: give the capture that the model was \
         trained on"
    } else {
        "has no list \"frames\"; is this a transforms file?"
    }
}

/// Refuses frames that have names, and of which none has a field of a pose.
pub(super) fn with_matrices<'a>(mut frames: impl Iterator<Item = &'a Value> + Clone) -> Result<(), String> {
    let lacks = |frame: &Value, name: &str| frame.get(name).is_none();
    let lacks_all = |frame: &Value| {
        name_of(frame).is_some() && lacks(frame, "transform_matrix") && lacks(frame, "transform_matrix_start")
    };
    let first = frames.clone().next();
    let Some(first) = first.filter(|_| frames.all(lacks_all)) else { return Ok(()) };
    let fields: Vec<&str> = first.as_object().into_iter().flat_map(serde_json::Map::keys).map(String::as_str).collect();
    Err(format!(
        "its frames give no transform_matrix, 4 x 4 numbers from camera to world (the first one has {}): add it to each frame",
        shown(&fields.join(", "), 120)
    ))
}

/// Fields of nerfstudio's file that concern all frames.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Whole {
    #[serde(deserialize_with = "or_default")]
    pub train_filenames: Vec<String>,
    #[serde(deserialize_with = "or_default")]
    pub val_filenames: Vec<String>,
    #[serde(deserialize_with = "or_default")]
    pub test_filenames: Vec<String>,
    /// Held-out frames beside the others, as of ScanNet++.
    #[serde(deserialize_with = "or_default")]
    pub test_frames: Vec<Value>,
    /// Length of a step of the numbers of depth maps, under the names of nerfstudio and instant-ngp.
    pub depth_unit_scale_factor: Option<f64>,
    pub integer_depth_scale: Option<f64>,
    #[serde(deserialize_with = "text")]
    pub ply_file_path: Option<String>,
    /// True if the camera axes are OpenCV's, as of NeuS2.
    #[serde(deserialize_with = "or_default")]
    pub from_na: bool,
    /// Radius in pixels of the circle around the principal point that photos show, of nerfstudio.
    pub fisheye_crop_radius: Option<f64>,
}

impl Whole {
    /// The fields of a file; an error names the one at fault.
    pub fn of(json: &Value) -> Result<Self, String> {
        if json.get("normal_mts_args").is_some_and(|args| !args.is_null()) {
            let what = "has normal_mts_args, so the camera axes are Mitsuba's, which are not read: multiply the first and \
                        third column of each transform_matrix by -1, and remove normal_mts_args";
            return Err(what.to_owned());
        }
        fields(json)
    }
}

/// Fields of instant-ngp and SpectacularAI on movement during the exposure.
const MOVEMENT: [&str; 4] =
    ["rolling_shutter", "rolling_shutter_time", "camera_linear_velocity", "camera_angular_velocity"];

/// A note on fields of a file or its frames that say that the camera moved during the exposure.
pub(super) fn movement(json: &Value) -> Option<String> {
    let frames: &[Value] = json.get("frames").and_then(Value::as_array).map_or(&[], Vec::as_slice);
    let is_told = |name: &&str| frames.iter().chain([json]).any(|of| of.get(*name).is_some_and(is_not_zero));
    let told: Vec<&str> = MOVEMENT.into_iter().filter(is_told).collect();
    let fields = told.join(", ");
    (!told.is_empty()).then(|| format!("not used: {fields}; cameras are taken to stand still during an exposure"))
}

/// True for a number other than 0, or a list that holds one.
fn is_not_zero(value: &Value) -> bool {
    value.as_f64().is_some_and(|v| v != 0.0) || value.as_array().is_some_and(|list| list.iter().any(is_not_zero))
}

/// The name of a frame's photo.
pub(super) fn name_of(frame: &Value) -> Option<String> {
    Some(tidy(frame.get("file_path")?.as_str()?))
}

/// The text with quotes around what Python writes for numbers that JSON does not know: only a matrix takes such a string for a number.
pub(super) fn without_nan(text: &str) -> String {
    // Between quotes, of which none is escaped in what matters here.
    let mut inside = false;
    let part = |part: &str| {
        let told = if inside {
            part.to_owned()
        } else {
            part.replace("-Infinity", "Infinity").replace("Infinity", "\"Infinity\"").replace("NaN", "\"NaN\"")
        };
        inside = !inside;
        told
    };
    text.split('"').map(part).collect::<Vec<_>>().join("\"")
}
