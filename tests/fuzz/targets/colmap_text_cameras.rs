#![no_main]
faults::reader!("colmap: cameras.txt");
