#![no_main]
faults::reader!("sog levels: lod-meta.json");
