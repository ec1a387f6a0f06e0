#![no_main]
faults::reader!("matrix.txt");
