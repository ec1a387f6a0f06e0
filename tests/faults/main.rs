//! Faults: damaged files, kills, lost devices, full disks, too little memory. Errors name the cause, and what was there stays whole.
#![cfg(unix)] // limits and signals are the system's

#[path = "../formats/make.rs"]
#[allow(dead_code)] // this program uses its own part
mod make;
#[path = "../scenes/writers.rs"]
#[allow(dead_code)] // as above
mod writers;

mod corpus;
mod house;
mod killed;
mod lost;
mod mutate;
mod mutations;
mod resources;
