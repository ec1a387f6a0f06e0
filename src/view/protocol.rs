//! The messages between a page and the program over the WebSocket.
//!
//! A page sends JSON: requests, acknowledgements and controls. The program answers with binary frames, a [`Header`] of
//! 32 bytes before an encoded picture, and with JSON about the progress of a run.

use crate::scene::camera::Camera;
use glam::{DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Largest number of pixels of a picture.
pub const MOST_PIXELS: u64 = 8 << 20;
/// Range of the field of view of a request, in radians.
const FIELDS: std::ops::RangeInclusive<f64> = 0.01..=3.0;
/// Largest shift of a request, in heights of the picture.
const MOST_SHIFT: f64 = 1000.0;
/// Range of the stretch of a request.
const STRETCHES: std::ops::RangeInclusive<f64> = 0.01..=100.0;

/// A message from the page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Message {
    /// Draw this picture; replaces an earlier request that is not drawn yet.
    Request(Request),
    /// The frame of this number has been shown.
    Shown(u32),
    /// Control the run.
    Control(Control),
}

/// A picture to draw.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Number of the request, repeated in its frame.
    pub number: u32,
    /// Camera.
    pub camera: RequestCamera,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Content.
    #[serde(default)]
    pub picture: Picture,
    /// Index of the model in the list.
    #[serde(default)]
    pub model: usize,
    /// Highest SH degree drawn.
    #[serde(default = "all_degrees")]
    pub degree: usize,
    /// Colour behind the Gaussians; default: the subject's own.
    #[serde(default)]
    pub background: Option<[f32; 3]>,
    /// True for a whole and lossless picture; false while the camera moves.
    #[serde(default)]
    pub still: bool,
}

fn all_degrees() -> usize {
    crate::gaussians::MAX_SH_DEGREE
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum RequestCamera {
    /// The camera of a photo of the capture, by its number, at the working size; the request's size is ignored.
    Photo(usize),
    /// A free camera.
    Pose {
        /// Centre in world coordinates.
        position: [f64; 3],
        /// Rotation from camera (x right, y down, z forward) to world coordinates: w, x, y, z.
        rotation: [f64; 4],
        /// Vertical field of view in radians.
        fov: f64,
        /// The principal point from the picture's middle, to the right and down, in heights of the picture; default: 0, 0.
        #[serde(default)]
        shift: [f64; 2],
        /// The horizontal focal length over the vertical one; default: 1.
        #[serde(default = "square")]
        stretch: f64,
    },
}

/// The stretch of square pixels.
fn square() -> f64 {
    1.0
}

/// Content of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Picture {
    /// Colours over the background.
    #[default]
    Colour,
    /// Expected depth: the mean of the Gaussians' depths, weighted as their colours.
    Depth,
    /// Opacity.
    Alpha,
    /// Blocks, each in its own colour: of the default partition, or those of the model's prune.
    Blocks,
    /// Mean absolute difference over the channels from the photo, or from the other model.
    Error,
    /// Number of Gaussians that each pixel blends.
    Count,
    /// Gaussians that the prune kept, merged and dropped.
    Kept,
    /// Scores that the model's prune was based on.
    Score,
    /// Participation in the leading modes of the prune's blocks.
    Participation,
    /// Guards that acted in the model's prune.
    Guards,
}

/// A control of a run.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Control {
    /// Pause training; pictures are still drawn.
    Pause,
    /// Resume.
    Resume,
    /// Write a checkpoint.
    Checkpoint,
    /// Write a checkpoint and stop, like Ctrl-C.
    Stop,
    /// Share of the time, 0 to 1, that pictures may take.
    Share(f64),
}

impl RequestCamera {
    /// The camera of a free pose, for a picture of `width` x `height` pixels; the parameters are those of [`RequestCamera::Pose`].
    ///
    /// # Errors
    /// A sentence about numbers that are no camera's.
    pub fn free(
        position: [f64; 3],
        rotation: [f64; 4],
        fov: f64,
        shift: [f64; 2],
        stretch: f64,
        [width, height]: [u32; 2],
    ) -> Result<Camera, String> {
        let [w, x, y, z] = rotation;
        let (position, to_world) = (DVec3::from(position), DQuat::from_xyzw(x, y, z, w));
        let length = to_world.length();
        let whole = position.is_finite() && length.is_finite() && length > 1e-6;
        if !whole || !FIELDS.contains(&fov) {
            return Err(
                "the camera is not a finite position, a rotation and a field of view of 0.01 to 3 radians".into()
            );
        }
        if !shift.iter().all(|part| part.abs() <= MOST_SHIFT) {
            return Err(format!("the camera's shift is not two numbers of at most {MOST_SHIFT} picture heights"));
        }
        if !STRETCHES.contains(&stretch) {
            return Err("the camera's stretch is not a number from 0.01 to 100".into());
        }
        let rotation = DMat3::from_quat(to_world.normalize()).transpose();
        let level = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, fov, width, height);
        let principal = level.principal + DVec2::from(shift) * f64::from(height);
        let focal = level.focal * DVec2::new(stretch, 1.0);
        Ok(Camera { rotation, translation: -(rotation * position), focal, principal, ..level })
    }
}

/// Encoding of a frame's picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Encoding {
    /// JPEG, 4:2:0.
    Jpeg = 0,
    /// PNG, 8 bits per channel.
    Png = 1,
}

/// A figure sent with a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Figure {
    /// No figure.
    None,
    /// PSNR in dB against the photo or the other model.
    Psnr(f32),
    /// Mean number of Gaussians that a pixel blends.
    Blended(f32),
}

impl Figure {
    /// Its kind as a byte, and its value.
    fn parts(self) -> (u8, f32) {
        match self {
            Self::None => (0, f32::NAN),
            Self::Psnr(db) => (1, db),
            Self::Blended(mean) => (2, mean),
        }
    }
}

/// The header of a picture: 32 bytes, numbers in little-endian order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Encoding.
    pub encoding: Encoding,
    /// True if Gaussians or pixels were left out.
    pub reduced: bool,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Number of the request.
    pub number: u32,
    /// Milliseconds to draw it.
    pub draw_ms: f32,
    /// Iteration of the run; 0 without one.
    pub iteration: u32,
    /// Number of Gaussians drawn.
    pub gaussians: u32,
    /// A figure of the picture, if its kind has one.
    pub figure: Figure,
}

impl Header {
    /// Bytes of a header.
    pub const BYTES: usize = 32;
    const VERSION: u8 = 2;

    /// The header's bytes.
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut out = [0; Self::BYTES];
        let (figure, value) = self.figure.parts();
        out[..4].copy_from_slice(&[Self::VERSION, self.encoding as u8, u8::from(self.reduced), figure]);
        let [width, height] = self.size;
        let words =
            [width, height, self.number, self.draw_ms.to_bits(), self.iteration, self.gaussians, value.to_bits()];
        for (place, word) in out[4..].chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        out
    }

    /// Reads a header; `None` if the bytes have another layout.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (head, words) = bytes.get(..Self::BYTES)?.split_at(4);
        let encoding = match head {
            [Self::VERSION, 0, ..] => Encoding::Jpeg,
            [Self::VERSION, 1, ..] => Encoding::Png,
            _ => return None,
        };
        let word = |i: usize| u32::from_le_bytes(std::array::from_fn(|b| words[4 * i + b]));
        let value = f32::from_bits(word(6));
        let figure = match head[3] {
            0 => Figure::None,
            1 => Figure::Psnr(value),
            2 => Figure::Blended(value),
            _ => return None,
        };
        Some(Self {
            encoding,
            reduced: head[2] != 0,
            size: [word(0), word(1)],
            number: word(2),
            draw_ms: f32::from_bits(word(3)),
            iteration: word(4),
            gaussians: word(5),
            figure,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_come_back() {
        let header = Header {
            encoding: Encoding::Png,
            reduced: true,
            size: [640, 360],
            number: 7,
            draw_ms: 1.5,
            iteration: 900,
            gaussians: 93_000,
            figure: Figure::Psnr(30.25),
        };
        let bytes = header.to_bytes();
        assert_eq!(Header::from_bytes(&bytes), Some(header));
        for figure in [Figure::None, Figure::Blended(17.5)] {
            assert_eq!(Header::from_bytes(&Header { figure, ..header }.to_bytes()).map(|h| h.figure), Some(figure));
        }
        assert_eq!(Header::from_bytes(&bytes[..31]), None);
        assert_eq!(Header::from_bytes(&[9; 32]), None);
    }

    #[test]
    fn messages_are_read_as_the_page_writes_them() {
        let text = r#"{"request":{"number":3,"camera":{"pose":{"position":[0,0,-2],"rotation":[1,0,0,0],"fov":0.7}},"size":[64,48],"picture":"depth"}}"#;
        let Ok(Message::Request(request)) = serde_json::from_str(text) else { panic!("{text}") };
        assert_eq!(
            (request.number, request.picture, request.model, request.degree, request.still),
            (3, Picture::Depth, 0, 3, false)
        );
        for text in [r#"{"shown":4}"#, r#"{"control":"pause"}"#] {
            assert!(serde_json::from_str::<Message>(text).is_ok(), "{text}");
        }
        for text in ["", "{}", r#"{"request":{}}"#, r#"{"control":"format"}"#, r#"{"shown":-1}"#] {
            assert!(serde_json::from_str::<Message>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_free_camera_is_that_of_its_pose() {
        let (eye, target) = (DVec3::new(1.0, -2.0, 3.0), DVec3::new(0.5, 0.0, -1.0));
        let wanted = Camera::look_at(eye, target, DVec3::NEG_Y, 0.9, 64, 48);
        let q = DQuat::from_mat3(&wanted.rotation.transpose());
        let camera = RequestCamera::free(eye.to_array(), [q.w, q.x, q.y, q.z], 0.9, [0.0; 2], 1.0, [64, 48]).unwrap();
        assert!((camera.translation - wanted.translation).length() < 1e-12);
        assert_eq!((camera.focal, camera.principal, camera.width), (wanted.focal, wanted.principal, 64));
        let (one, zero) = ([1.0, 0.0, 0.0, 0.0], [0.0; 2]);
        for (position, rotation, fov, shift, stretch) in [
            ([f64::NAN; 3], one, 0.9, zero, 1.0),
            ([0.0; 3], [0.0; 4], 0.9, zero, 1.0),
            ([0.0; 3], one, 0.0, zero, 1.0),
            ([0.0; 3], one, f64::INFINITY, zero, 1.0),
            ([0.0; 3], one, 0.9, [0.0, f64::NAN], 1.0),
            ([0.0; 3], one, 0.9, [1e9, 0.0], 1.0),
            ([0.0; 3], one, 0.9, zero, 0.0),
            ([0.0; 3], one, 0.9, zero, f64::NAN),
        ] {
            assert!(RequestCamera::free(position, rotation, fov, shift, stretch, [64, 48]).is_err());
        }
    }

    /// In a window twice as high, the principal point lies twice as far from the middle; in a part of a picture, it counts from
    /// the part's corner.
    #[test]
    fn a_pose_keeps_the_principal_point_and_the_shape_of_pixels() {
        let level = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 0.9, 64, 48);
        let focal = level.focal * DVec2::new(1.5, 1.0);
        let whole = Camera { principal: DVec2::new(36.0, 12.0), focal, ..level };
        for (camera, expected) in [(whole.part([32, 16], [16, 16]), [8.0, -8.0]), (whole, [72.0, 24.0])] {
            let given = serde_json::json!({ "pose": super::super::subject::pose(&camera) });
            let Ok(RequestCamera::Pose { position, rotation, fov, shift, stretch }) = serde_json::from_value(given)
            else {
                panic!("a pose is not read")
            };
            let size = [2 * camera.width, 2 * camera.height];
            let free = RequestCamera::free(position, rotation, fov, shift, stretch, size).unwrap();
            assert!(free.principal.distance(DVec2::from(expected)) < 1e-9, "{free:?}");
            assert!(free.focal.distance(2.0 * focal) < 1e-9, "{free:?}");
        }
    }
}
