//! Device faults on demand, for tests: failures that no healthy driver shows, at a chosen call.

use ash::vk;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

/// A call to the device's queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// Submitting work.
    Submit,
    /// Waiting for work.
    Wait,
}

/// The device's answer in place of the real one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Device lost, here and in every later call.
    Lost,
    /// The host has no memory left for this call.
    HostMemory,
    /// The device has no memory left for this call.
    DeviceMemory,
    /// No answer, ever (waits only).
    Hang,
    /// No answer: the process ends at once, as if it were killed.
    Kill,
}

/// One fault, once: the text of `QIRF_DEVICE_FAULT` is `CALL:N:ANSWER`, as in `submit:12:lost`. CALL is `submit` or
/// `wait`; N counts such calls of the process's device from 1; ANSWER is `lost`, `host-memory`, `device-memory`, `kill`
/// or, for waits, `hang`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The call that fails.
    pub call: Call,
    /// The number of that call, from 1.
    pub number: u64,
    /// The answer to it.
    pub answer: Answer,
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(':').collect();
        let [call, number, answer] = parts[..] else { return Err("three parts, CALL:N:ANSWER, are wanted".into()) };
        let call = match call {
            "submit" => Call::Submit,
            "wait" => Call::Wait,
            other => return Err(format!("'{other}' is neither submit nor wait")),
        };
        let number = number.parse().ok().filter(|n| *n > 0).ok_or_else(|| format!("'{number}' counts no call"))?;
        let answer = match answer {
            "lost" => Answer::Lost,
            "host-memory" => Answer::HostMemory,
            "device-memory" => Answer::DeviceMemory,
            "kill" => Answer::Kill,
            "hang" if call == Call::Wait => Answer::Hang,
            other => {
                return Err(format!("'{other}' is none of lost, host-memory, device-memory, kill and (of waits) hang"));
            }
        };
        Ok(Self { call, number, answer })
    }
}

/// The fault of one device, and its call counters.
#[derive(Default)]
pub(in crate::gpu) struct Faults {
    planned: Option<Fault>,
    seen: AtomicU64,
}

impl Faults {
    pub fn new(planned: Option<Fault>) -> Self {
        Self { planned, seen: AtomicU64::new(0) }
    }

    /// Whether a fault is planned: the real device is then sound.
    pub fn are_planned(&self) -> bool {
        self.planned.is_some()
    }

    /// The answer to this call in place of the device's. A hang is a time-out at every repetition.
    pub fn at(&self, call: Call) -> Result<(), vk::Result> {
        let Some(fault) = self.planned.filter(|f| f.call == call) else { return Ok(()) };
        if self.seen.fetch_add(1, Ordering::Relaxed) + 1 != fault.number {
            return Ok(());
        }
        match fault.answer {
            Answer::Lost => Err(vk::Result::ERROR_DEVICE_LOST),
            Answer::HostMemory => Err(vk::Result::ERROR_OUT_OF_HOST_MEMORY),
            Answer::DeviceMemory => Err(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY),
            Answer::Hang => Err(vk::Result::TIMEOUT),
            Answer::Kill => std::process::abort(),
        }
    }
}

impl Drop for Faults {
    fn drop(&mut self) {
        // A test whose fault never came would test nothing.
        if let Some(fault) = self.planned {
            let seen = self.seen.load(Ordering::Relaxed);
            let came = if seen < fault.number { "not yet come" } else { "come" };
            tracing::info!("the fault of call {} had {came} after {seen} such calls", fault.number);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_faults() {
        let fault = Fault { call: Call::Submit, number: 12, answer: Answer::Lost };
        assert_eq!("submit:12:lost".parse(), Ok(fault));
        let fault = Fault { call: Call::Wait, number: 1, answer: Answer::Hang };
        assert_eq!("wait:1:hang".parse(), Ok(fault));
        for wrong in [
            "",
            "submit",
            "submit:0:lost",
            "submit:x:lost",
            "idle:1:lost",
            "wait:1:found",
            "wait:1:lost:2",
            "submit:1:hang",
        ] {
            assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_fault_comes_once_and_at_its_call() {
        let faults = Faults::new("wait:2:host-memory".parse().ok());
        let wait = || faults.at(Call::Wait);
        assert_eq!([faults.at(Call::Submit), faults.at(Call::Submit)], [Ok(()), Ok(())]);
        assert_eq!([wait(), wait(), wait()], [Ok(()), Err(vk::Result::ERROR_OUT_OF_HOST_MEMORY), Ok(())]);
    }
}
