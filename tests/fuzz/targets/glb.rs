#![no_main]
faults::reader!("planar.glb");
