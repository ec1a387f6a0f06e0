//! Model files: readers, writers, hostile input, and the shared models where they are at hand.

mod readers;
mod shared;
mod writers;
