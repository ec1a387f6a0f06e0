#![no_main]
faults::reader!("rig_config.json");
