//! Cameras, photos, points and the train/test split of a capture.

pub mod camera;
