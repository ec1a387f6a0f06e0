#![no_main]
faults::reader!("checkpoint.safetensors");
