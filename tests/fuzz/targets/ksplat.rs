#![no_main]
faults::reader!("1.ksplat");
