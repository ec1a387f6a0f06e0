//! The fields of a transforms file that are no intrinsics, and its text.

use serde::{Deserialize, Deserializer};
use serde_json::Value;

use super::super::names::tidy;

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
}

/// The name of a frame's photo.
pub(super) fn name_of(frame: &Value) -> Option<String> {
    Some(tidy(frame.get("file_path")?.as_str()?))
}

/// The text with quotes around what Python writes for numbers that JSON does not know: no field takes such a string for a number.
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
