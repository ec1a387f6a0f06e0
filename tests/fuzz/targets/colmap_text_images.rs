#![no_main]
faults::reader!("colmap: images.txt");
