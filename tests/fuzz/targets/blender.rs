#![no_main]
faults::reader!("blender: transforms_train.json");
