#![no_main]
faults::reader!("quantised.glb");
