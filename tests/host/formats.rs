//! Model files: readers, writers, hostile input, and the shared models if they are available.

mod blocks;
mod dialects;
mod gltf;
mod levels;
mod limits;
mod readers;
mod shared;
mod spz;
mod strangers;
mod tags;
mod usd;
mod writers;
