//! Guards of buffers, for tests: each new buffer is filled with NaN, so that elements that no kernel wrote show, and
//! ends in a red zone that no kernel may touch. Descriptors include the red zone: a stray store lands there instead of
//! being dropped.

use crate::gpu::buffer::Storage;
use crate::lock::lock;
use crate::random;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, Weak};

/// Bytes of a red zone: wider than any one invocation's store.
pub(in crate::gpu) const BYTES: u64 = 256;
/// A quiet NaN as a float; as a count it is large enough to be noticed.
const POISON: u32 = 0x7fc0_dead;

/// The words of a buffer's red zone: quiet NaN, each with different bits. A kernel that reads a NaN behind one buffer
/// and stores it behind another, even unchanged through a sum, is therefore noticed too.
fn red_zone_of(number: u64) -> impl Iterator<Item = u32> {
    (0..).map(move |k| 0x7fc0_0000 | (random::bits(&[number, k]) as u32 & 0x003f_ffff))
}

/// Fills a new buffer of this number: its contents and its red zone.
pub(in crate::gpu) fn fill(number: u64, (contents, red_zone): (&mut [u8], &mut [u8])) {
    contents.chunks_exact_mut(4).for_each(|word| word.copy_from_slice(&POISON.to_ne_bytes()));
    for (word, own) in red_zone.chunks_exact_mut(4).zip(red_zone_of(number)) {
        word.copy_from_slice(&own.to_ne_bytes());
    }
}

/// The guarded buffers of a device, and those whose red zone was overwritten.
#[derive(Default)]
pub(in crate::gpu) struct Guards {
    alive: Mutex<HashMap<u64, Weak<Storage>>>,
    overrun: Mutex<Vec<String>>,
}

impl Guards {
    /// Watches a filled buffer from now on.
    pub fn watch(&self, buffer: &Arc<Storage>) {
        lock(&self.alive).insert(buffer.number, Arc::downgrade(buffer));
    }

    /// Checks the red zone of a dropped buffer.
    pub fn leave(&self, buffer: &Storage) {
        lock(&self.alive).remove(&buffer.number);
        if is_overrun(buffer) {
            lock(&self.overrun).push(buffer.name.clone());
        }
    }

    /// Names of the buffers, alive or dropped, behind whose end a kernel wrote.
    pub fn overrun(&self) -> Vec<String> {
        // Strong references first: dropping the last one here takes the lock itself.
        let alive: Vec<Arc<Storage>> = lock(&self.alive).values().filter_map(Weak::upgrade).collect();
        let mut names = lock(&self.overrun).clone();
        names.extend(alive.iter().filter(|buffer| is_overrun(buffer)).map(|buffer| buffer.name.clone()));
        names
    }
}

fn is_overrun(buffer: &Storage) -> bool {
    let words = buffer.red_zone().chunks_exact(4);
    words.zip(red_zone_of(buffer.number)).any(|(word, own)| word != own.to_ne_bytes())
}
