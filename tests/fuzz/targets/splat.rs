#![no_main]
faults::reader!("a.splat");
