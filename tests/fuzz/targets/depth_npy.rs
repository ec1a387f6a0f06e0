#![no_main]
faults::reader!("floats.npy");
