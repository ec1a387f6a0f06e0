//! Whole jobs as readable lists of stages.

pub mod active_run;
mod backdrop;
pub mod budget;
pub mod checkpoint;
pub mod compress;
pub mod depth;
mod draw_source;
pub mod effects;
pub mod eval;
pub mod evaluate;
pub mod film;
pub mod floaters;
pub mod kernels;
pub mod pair_capacity;
pub mod panorama;
pub mod place;
pub mod prepare;
pub mod prune;
pub mod render;
pub mod run;
pub mod setup;
pub mod start;
pub mod trial;
pub mod tune;
pub mod virtual_views;
