//! Shared by the fuzz targets and the tests: a good file of every format, its reader, and the conditions that must
//! hold.

#[path = "../support/files/mod.rs"]
#[allow(dead_code)] // the fuzz targets use its readers
mod files;

pub use files::corpus;
