#![no_main]
faults::reader!("colmap: points3D.bin");
