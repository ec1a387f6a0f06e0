#![no_main]
faults::reader!("gltf: m.bin");
