//! Guards of buffers, for tests: each is born full of NaN, so that what no kernel wrote shows, and ends in a fence that no
//! kernel may touch. Descriptors span the fence too: a store that goes astray lands there instead of being dropped.

use super::buffer::{RawBuffer, Storage};
use super::device::{Context, Device, lock};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, Weak};

/// Bytes of a fence: wider than any one invocation's store.
pub(super) const FENCE: u64 = 256;
/// A quiet NaN as a float; as a count it is large enough to be noticed.
pub(super) const POISON: u32 = 0x7fc0_dead;

/// The guarded buffers of a device, and those whose fence was found broken.
#[derive(Default)]
pub(super) struct Guards {
    alive: Mutex<HashMap<u64, Weak<Storage>>>,
    broken: Mutex<Vec<String>>,
}

impl Guards {
    /// Poisons a new buffer, fence included, and watches it from now on.
    pub fn watch(&self, buffer: &mut RawBuffer) {
        for word in buffer.mapped_mut().chunks_exact_mut(4) {
            word.copy_from_slice(&POISON.to_ne_bytes());
        }
        lock(&self.alive).insert(buffer.number(), Arc::downgrade(&buffer.0));
    }

    /// Takes a buffer's last words before it goes.
    pub fn leave(&self, storage: &Storage) {
        lock(&self.alive).remove(&storage.number);
        if broken(storage) {
            lock(&self.broken).push(storage.name.clone());
        }
    }
}

fn broken(storage: &Storage) -> bool {
    let mapped = storage.mapped();
    let fence = mapped.get(storage.bytes as usize..(storage.bytes + storage.fence) as usize).unwrap_or_default();
    fence.chunks_exact(4).any(|word| word != POISON.to_ne_bytes())
}

impl Context {
    /// Bytes to add behind a storage buffer.
    pub fn fence(&self) -> u64 {
        if self.guards.is_some() { FENCE } else { 0 }
    }
}

impl Device {
    /// Names of buffers behind whose end something was written, alive or gone; always empty unless the device was opened
    /// with [`super::DeviceOptions::guarded`]. Submitted work must have been waited for.
    pub fn broken_fences(&self) -> Vec<String> {
        let Some(guards) = &self.context().guards else { return Vec::new() };
        // Strong references first: the last one may go here, and takes the lock itself.
        let alive: Vec<Arc<Storage>> = lock(&guards.alive).values().filter_map(Weak::upgrade).collect();
        let mut names = lock(&guards.broken).clone();
        names.extend(alive.iter().filter(|s| broken(s)).map(|s| s.name.clone()));
        names
    }

    /// Whether buffers are guarded.
    pub fn guards(&self) -> bool {
        self.context().guards.is_some()
    }
}
