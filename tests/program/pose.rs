//! Poses of photos and videos: by a COLMAP that the test plays itself, and by the real one.

mod fake;
mod folders;
mod real;
mod rigs;
mod video;
