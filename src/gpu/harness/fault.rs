//! Faults of a device on demand, for tests: what no healthy driver shows, at a call that can be chosen.

use ash::vk;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

/// A call to the device's queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// Handing work over.
    Submit,
    /// Waiting for work to be done.
    Wait,
}

/// What the device answers instead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It is lost, and so for every later call.
    Lost,
    /// The host has no memory left for this call.
    HostMemory,
    /// The device has no memory left for this call.
    DeviceMemory,
    /// Nothing, for ever (waits only).
    Hang,
    /// Nothing: the process ends on the spot, as when it is killed.
    Kill,
}

/// One fault, once: in `QIRF_DEVICE_FAULT` its text is `CALL:N:ANSWER`, as in `submit:12:lost`. CALL is `submit` or `wait`; N
/// counts such calls of the process's device from 1; ANSWER is `lost`, `host-memory`, `device-memory`, `kill`
/// or, of waits, `hang`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The call that fails.
    pub call: Call,
    /// Which of these calls, from 1.
    pub number: u64,
    /// How it fails.
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

/// The fault of one device, and how near it is.
#[derive(Default)]
pub(in crate::gpu) struct Faults {
    planned: Option<Fault>,
    seen: AtomicU64,
}

impl Faults {
    pub fn new(planned: Option<Fault>) -> Self {
        Self { planned, seen: AtomicU64::new(0) }
    }

    /// Whether faults are made here at all: the device beneath is then sound.
    pub fn are_planned(&self) -> bool {
        self.planned.is_some()
    }

    /// What this call answers in place of the device; a hang is a time-out that every repetition ends in.
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
