#![no_main]
faults::reader!("sparse.glb");
