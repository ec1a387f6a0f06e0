#![no_main]
faults::reader!("depth.png");
