#![no_main]
faults::reader!("config.toml");
