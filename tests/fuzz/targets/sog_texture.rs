#![no_main]
faults::reader!("sog 2: means_u.webp");
