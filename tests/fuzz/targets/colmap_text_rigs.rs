#![no_main]
faults::reader!("colmap: rigs.txt");
