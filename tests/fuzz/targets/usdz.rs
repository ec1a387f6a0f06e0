#![no_main]
faults::reader!("a.usdz");
