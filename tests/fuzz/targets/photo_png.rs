#![no_main]
faults::reader!("checksums right: images/a.png");
