//! The queue of a device: work goes in here and is waited for here, so that here a device tells that it was lost.

use super::device::lock;
use super::harness::fault::{Call, Fault, Faults};
use ash::vk;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

/// Nobody waits so long for one submission unless the device is slow or hangs: the user hears of it.
const PATIENCE: Duration = Duration::from_secs(60);

/// One queue, and whether its device was lost.
pub(super) struct Queue {
    /// The family that it is of.
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

    /// Whether some call has told that the device was lost. It never comes back.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::SeqCst)
    }

    /// Hands over one command buffer, whose end signals the fence.
    ///
    /// # Safety
    /// `raw` is what [`Queue::lock`] gave; the command buffer is complete, and all that it uses lives until the fence was
    /// waited for.
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

    /// Waits for a fence, as long as it takes. There is no limit: Vulkan promises that waits end when a device is lost, drivers
    /// of GPUs watch their work themselves, software devices may be slow at will, and memory of work that may still run could
    /// not be freed anyway.
    ///
    /// # Errors
    /// A device that was lost. After any other error the work is over all the same, if Vulkan could tell in any way.
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
                    "the device has been at one piece of work for {:?}: it is slow, or it hangs. Where its driver notices a \
                     hang, this program ends and says so; Ctrl-C, twice if need be, ends it now",
                    patience.saturating_mul(waits)
                );
            }
        };
        // A fault on demand comes after the wait, since the device beneath works on.
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

    /// Takes note of a loss.
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
