#![no_main]
faults::reader!("sog 2: meta.json");
