//! The `qirf-vk` program.

fn main() {}
