#![no_main]
faults::reader!("camera_path.json");
