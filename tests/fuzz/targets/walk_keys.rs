#![no_main]
faults::reader!("keys.json");
