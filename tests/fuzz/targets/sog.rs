#![no_main]
faults::reader!("two.sog");
