#![no_main]
faults::reader!("inside gzip.spz");
