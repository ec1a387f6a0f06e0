#![no_main]
faults::reader!("little.ply");
