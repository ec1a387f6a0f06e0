//! A device's queue: submission, waiting, and detection of a lost device.

use super::harness::fault::{Call, Fault, Faults};
use crate::lock::lock;
use ash::vk;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

/// Time after which the user is told that a submission is slow or hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// One queue, and whether its device was lost.
pub(super) struct Queue {
    /// Its queue family.
    pub family: u32,
    raw: Mutex<vk::Queue>,
    lost: AtomicBool,
    faults: Faults,
}

impl Queue {
    pub fn new(raw: vk::Queue, family: u32, fault: Option<Fault>) -> Self {
        Self { family, raw: Mutex::new(raw), lost: AtomicBool::new(false), faults: Faults::new(fault) }
    }

    /// Locks the queue: recordings are submitted in the order in which they take it.
    pub fn lock(&self) -> MutexGuard<'_, vk::Queue> {
        lock(&self.raw)
    }

    /// Whether a call has reported the device lost. It never recovers.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::SeqCst)
    }

    /// Submits one command buffer, whose end signals the fence.
    ///
    /// # Safety
    /// `raw` is the handle that [`Queue::lock`] returned; the command buffer is complete, and all its resources live
    /// until the fence has been waited for.
    pub unsafe fn submit(
        &self,
        device: &ash::Device,
        raw: vk::Queue,
        commands: vk::CommandBuffer,
        fence: vk::Fence,
    ) -> Result<(), vk::Result> {
        let commands = [commands];
        let submit = [vk::SubmitInfo::default().command_buffers(&commands)];
        self.known()?;
        self.answered(self.faults.at(Call::Submit))?;
        // SAFETY: the caller's promise.
        self.answered(unsafe { device.queue_submit(raw, &submit, fence) })
    }

    /// Waits for a fence, as long as it takes. There is no limit: Vulkan guarantees that waits end when a device is
    /// lost, GPU drivers watch their work themselves, software devices may be arbitrarily slow, and memory of work that
    /// may still run could not be freed anyway.
    ///
    /// # Errors
    /// A lost device. After any other error the work has finished all the same, if Vulkan could tell in any way.
    ///
    /// # Safety
    /// The fence was submitted to this queue.
    pub unsafe fn wait(&self, device: &ash::Device, fence: vk::Fence) -> Result<(), vk::Result> {
        if !self.faults.are_planned() {
            self.known()?; // a second wait for a lost device would add nothing but the risk of a hang
        }
        let fault = self.faults.at(Call::Wait);
        let hangs = fault == Err(vk::Result::TIMEOUT);
        let patience = if hangs { Duration::from_millis(50) } else { PATIENCE };
        let mut waits = 0_u32;
        let waited = loop {
            let answer = if hangs {
                std::thread::sleep(patience);
                fault
            } else {
                // SAFETY: the caller's promise.
                unsafe { device.wait_for_fences(&[fence], true, patience.as_nanos() as u64) }
            };
            if answer != Err(vk::Result::TIMEOUT) {
                break answer;
            }
            waits = waits.saturating_add(1);
            if waits.is_power_of_two() {
                tracing::warn!(
                    "the device has been busy with one submission for {:?}: it is slow, or it hangs. If its driver \
                     detects a hang, this program ends with an error; Ctrl-C, twice if necessary, ends it now",
                    patience.saturating_mul(waits)
                );
            }
        };
        // An injected fault comes after the wait, since the real device keeps working.
        let waited = waited.and_then(|()| self.known()).and(fault);
        self.answered(waited).or_else(|e| if self.is_lost() { Err(e) } else { self.idle(device) })
    }

    /// Waits for all work, unless the device was lost.
    pub fn idle(&self, device: &ash::Device) -> Result<(), vk::Result> {
        if !self.faults.are_planned() {
            self.known()?;
        }
        let raw = self.lock();
        // SAFETY: the queue is a child of this device, and is locked.
        let waited = unsafe { device.queue_wait_idle(*raw) };
        self.answered(waited.and_then(|()| self.known()))
    }

    /// Records a device loss.
    pub fn answered<T>(&self, result: Result<T, vk::Result>) -> Result<T, vk::Result> {
        if matches!(result, Err(vk::Result::ERROR_DEVICE_LOST)) {
            self.lost.store(true, Ordering::SeqCst);
        }
        result
    }

    fn known(&self) -> Result<(), vk::Result> {
        if self.is_lost() { Err(vk::Result::ERROR_DEVICE_LOST) } else { Ok(()) }
    }
}
