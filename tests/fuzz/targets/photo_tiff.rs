#![no_main]
faults::reader!("photo: images/a.tif");
