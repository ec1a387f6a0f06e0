#![no_main]
faults::reader!("nerfstudio ascii: points.ply");
