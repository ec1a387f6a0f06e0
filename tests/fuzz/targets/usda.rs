#![no_main]
faults::reader!("a.usda");
