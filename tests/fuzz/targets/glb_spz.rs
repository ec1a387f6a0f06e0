#![no_main]
faults::reader!("spz.glb");
