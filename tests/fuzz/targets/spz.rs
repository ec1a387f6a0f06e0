#![no_main]
faults::reader!("4.spz");
