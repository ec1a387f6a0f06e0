#![no_main]
faults::reader!("depth.exr");
