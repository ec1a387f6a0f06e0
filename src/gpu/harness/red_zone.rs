//! Guards of buffers, for tests: each new buffer is filled with NaN, so that elements that no kernel wrote show, and
//! ends in a red zone that no kernel may touch. Descriptors include the red zone: a stray store lands there instead of
//! being dropped.

use crate::gpu::buffer::{RawBuffer, Storage};
use crate::gpu::device::{Context, Device, lock};
use crate::random;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, Weak};

/// Bytes of a red zone: wider than any one invocation's store.
const RED_ZONE: u64 = 256;
/// A quiet NaN as a float; as a count it is large enough to be noticed.
const POISON: u32 = 0x7fc0_dead;

/// The words of a buffer's red zone: quiet NaN, each with different bits. A kernel that reads a NaN behind one buffer
/// and stores it behind another, even unchanged through a sum, is therefore noticed too.
fn red_zone_of(number: u64) -> impl Iterator<Item = u32> {
    (0..).map(move |k| 0x7fc0_0000 | (random::bits(&[number, k]) as u32 & 0x003f_ffff))
}

/// The guarded buffers of a device, and those whose red zone was overwritten.
#[derive(Default)]
pub(in crate::gpu) struct Guards {
    alive: Mutex<HashMap<u64, Weak<Storage>>>,
    overrun: Mutex<Vec<String>>,
}

impl Guards {
    /// Fills a new buffer and its red zone, and watches it from now on.
    pub fn watch(&self, buffer: &mut RawBuffer) {
        let (number, end) = (buffer.number(), buffer.bytes() as usize);
        let (body, red_zone) = buffer.mapped_mut().split_at_mut(end);
        body.chunks_exact_mut(4).for_each(|word| word.copy_from_slice(&POISON.to_ne_bytes()));
        for (word, own) in red_zone.chunks_exact_mut(4).zip(red_zone_of(number)) {
            word.copy_from_slice(&own.to_ne_bytes());
        }
        lock(&self.alive).insert(buffer.number(), Arc::downgrade(&buffer.0));
    }

    /// Checks the red zone of a dropped buffer.
    pub fn leave(&self, storage: &Storage) {
        lock(&self.alive).remove(&storage.number);
        if is_overrun(storage) {
            lock(&self.overrun).push(storage.name.clone());
        }
    }
}

fn is_overrun(storage: &Storage) -> bool {
    let red_zone = storage.bytes as usize..(storage.bytes + storage.red_zone) as usize;
    let mapped = storage.mapped().get(red_zone).unwrap_or_default();
    mapped.chunks_exact(4).zip(red_zone_of(storage.number)).any(|(word, own)| word != own.to_ne_bytes())
}

impl Context {
    /// Bytes to add behind a storage buffer.
    pub fn red_zone(&self) -> u64 {
        if self.guards.is_some() { RED_ZONE } else { 0 }
    }
}

impl Device {
    /// Names of the buffers, alive or dropped, behind whose end a kernel wrote; always empty unless the device was
    /// opened with [`crate::gpu::Harness::guarded`]. All submitted work must have been waited for.
    pub fn overrun_buffers(&self) -> Vec<String> {
        let Some(guards) = &self.context().guards else { return Vec::new() };
        // Strong references first: dropping the last one here takes the lock itself.
        let alive: Vec<Arc<Storage>> = lock(&guards.alive).values().filter_map(Weak::upgrade).collect();
        let mut names = lock(&guards.overrun).clone();
        names.extend(alive.iter().filter(|s| is_overrun(s)).map(|s| s.name.clone()));
        names
    }

    /// Whether buffers are guarded.
    pub fn guards(&self) -> bool {
        self.context().guards.is_some()
    }
}
