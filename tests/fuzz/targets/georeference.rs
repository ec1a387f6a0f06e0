#![no_main]
faults::reader!("origin: georeference.json");
