#![no_main]
faults::reader!("panorama: transforms.json");
