//! Good files of every input format, and their readers. The fuzz targets (`tests/fuzz`) share this folder.

pub mod corpus;
pub mod gltf;
pub mod make;
pub mod mutate;
pub mod reading;
pub mod writers;
