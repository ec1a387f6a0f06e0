//! Does the driver run long loops to their end? Mesa before 23 stops an invocation after 65,535 iterations in total, in
//! silence: every long tile list would be cut.

use super::device::Device;
use super::error::Error;
use super::recording::{Groups, Recording};
use crate::kernels::probe::{Loop, LoopPush, LoopSpec};

/// More than the 65,535 at which old drivers stop.
const ITERATIONS: u32 = 70_000;

pub(super) fn check(device: &Device) -> Result<(), Error> {
    let result = device.buffer::<u32>("probe", 1)?;
    let mut recording = Recording::new();
    let kernel = Loop { result: &result, push: LoopPush { iterations: ITERATIONS }, spec: LoopSpec::default() };
    recording.dispatch(&kernel, Groups::Count(1));
    device.run(recording)?;
    // The loop sums 1..=n modulo 2^32.
    let expected = (1..=ITERATIONS).fold(0_u32, u32::wrapping_add);
    if result.read(device)?.first() == Some(&expected) {
        return Ok(());
    }
    Err(Error::Driver {
        device: device.info().name.clone(),
        driver: device.info().driver.clone(),
        what: "it ends shader loops early (Mesa before 23 does so after 65,535 iterations), which would cut pictures \
               without an error"
            .into(),
    })
}
