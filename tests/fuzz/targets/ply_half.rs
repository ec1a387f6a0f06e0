#![no_main]
faults::reader!("halves.ply");
