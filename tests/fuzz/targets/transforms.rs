#![no_main]
faults::reader!("nerfstudio: transforms.json");
