//! Faults: damaged files, kills, lost devices, full disks, too little memory. Errors name the cause, and existing files
//! stay whole.

pub mod harness;
mod killed;
mod lost;
mod mutations;
mod resources;
