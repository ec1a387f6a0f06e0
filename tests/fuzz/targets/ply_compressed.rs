#![no_main]
faults::reader!("compressed.ply");
