//! Model files: readers, writers, hostile input, and the shared models if they are available.

mod readers;
mod shared;
mod tags;
mod writers;
