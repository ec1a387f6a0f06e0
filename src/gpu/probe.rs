//! A check that a device works as it claims. Kernels are specialised for its subgroup size, and a driver that runs them
//! with another would compute wrong pictures without an error. Mesa's llvmpipe before 25 (22.3, 23.2 and 24.0 were
//! tried) silently stops an invocation after 65,535 iterations in total: every long tile list would be cut. One
//! submission checks both.

use super::device::Device;
use super::error::Error;
use super::info::DeviceKind;
use super::recording::{Groups, Recording};
use crate::kernels::probe::{Loop, LoopPush, LoopSpec, Subgroups, SubgroupsSpec};

/// Iterations of the probe's loop: more than the 65,535 at which old drivers stop.
const ITERATIONS: u32 = 70_000;
/// Invocations that report their subgroups: a workgroup size that every device supports.
const INVOCATIONS: u32 = 256;

/// Probes a device and returns its subgroup size, which equals the claimed one wherever it can be pinned.
///
/// # Errors
/// [`Error::Driver`] with the fault.
pub(super) fn check(device: &Device) -> Result<u32, Error> {
    let distrust =
        |what| Error::Driver { device: device.info().name.clone(), driver: device.info().driver.clone(), what };
    let lanes = device.buffer::<[u32; 4]>("probe of subgroups", INVOCATIONS as usize)?;
    let added = device.buffer::<u32>("probe of branches", INVOCATIONS as usize)?;
    let sum = device.buffer::<u32>("probe of loops", 1)?;
    let mut recording = Recording::new();
    let spec = SubgroupsSpec { workgroup: INVOCATIONS };
    recording.dispatch(&Subgroups { seen: &lanes, added: &added, spec }, Groups::Count(1));
    // Only CPU drivers have such a limit; on the slowest GPUs the loop would take a while.
    let loops = device.info().kind == DeviceKind::Cpu;
    if loops {
        let kernel = Loop { result: &sum, push: LoopPush { iterations: ITERATIONS }, spec: LoopSpec::default() };
        recording.dispatch(&kernel, Groups::Count(1));
    }
    let invocations = INVOCATIONS as usize;
    let count = invocations * 4;
    let mut landing = device.readback::<u32>("probe", count + invocations + 1)?;
    landing.submit(device, recording, &[(&lanes.cast(), count), (&added, invocations), (&sum, usize::from(loops))])?;
    let (seen, _) = landing.wait()?;
    // The loop sums 1..=n modulo 2^32.
    let expected = (1..=ITERATIONS).fold(0_u32, u32::wrapping_add);
    let (seen, rest) = seen.split_at(count);
    let (added, sum) = rest.split_at(invocations);
    if loops && sum[0] != expected {
        return Err(distrust(
            "it ends shader loops early (Mesa before 25 does so after 65,535 iterations), which would cut pictures \
             without an error"
                .to_owned(),
        ));
    }
    let width = width(bytemuck::cast_slice(seen)).map_err(distrust)?;
    reconverges(added, width).map_err(distrust)?;
    Ok(width)
}

/// Checks the sums over each subgroup's lanes of the steps of the Collatz sequence from `lane + round + 1` to 1, in as many
/// rounds as the subgroup's number: an addition in which some lanes are missing gives less.
fn reconverges(added: &[u32], width: u32) -> Result<(), String> {
    let round = |round: u32| (0..width).map(|lane| steps(lane + round + 1)).sum::<u32>();
    let mut all = 0;
    for (subgroup, added) in (0..).zip(added.chunks(width.max(1) as usize)) {
        all += round(subgroup);
        if let Some(wrong) = added.iter().find(|added| **added != all) {
            return Err(format!(
                "its subgroups do not meet again after branches: subgroup {subgroup} of {width} added up to {wrong} instead of {all}"
            ));
        }
    }
    Ok(())
}

/// Steps of the Collatz sequence from `n` to 1.
fn steps(mut n: u32) -> u32 {
    let mut count = 0;
    while n > 1 {
        n = if n.is_multiple_of(2) { n / 2 } else { 3 * n + 1 };
        count += 1;
    }
    count
}

/// The subgroup size that all invocations agree on. Each reports the lanes of its subgroup, the driver's value for
/// them, the number of subgroups, and its own subgroup and lane.
fn width(seen: &[[u32; 4]]) -> Result<u32, String> {
    let width = seen.first().map_or(0, |first| first[0]);
    let same = |at: usize, name: &str, told: u32, expected: u32| {
        if told == expected {
            return Ok(());
        }
        Err(format!(
            "its subgroups are wrong: invocation {at} of {} has {name} {told} instead of {expected}",
            seen.len()
        ))
    };
    for (at, [lanes, size, count, place]) in seen.iter().enumerate() {
        same(at, "active lanes", *lanes, width)?;
        same(at, "gl_SubgroupSize", *size, width)?;
        same(at, "gl_NumSubgroups", *count, (seen.len() as u32).div_ceil(width.max(1)))?;
        same(at, "gl_SubgroupID", place >> 16, at as u32 / width.max(1))?;
        same(at, "gl_SubgroupInvocationID", place & 0xffff, at as u32 % width.max(1))?;
    }
    Ok(width)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The report of a sound device of this width.
    fn sound(width: u32) -> Vec<[u32; 4]> {
        (0..INVOCATIONS).map(|i| [width, width, INVOCATIONS / width, ((i / width) << 16) | (i % width)]).collect()
    }

    #[test]
    fn widths_that_all_agree_on() {
        for width in [4, 8, 16, 32, 64, 128] {
            assert_eq!(super::width(&sound(width)), Ok(width));
        }
    }

    #[test]
    fn lanes_that_miss_an_addition_are_named() {
        assert_eq!((steps(1), steps(6), steps(27)), (0, 8, 111));
        // Subgroups of 2: steps 0 + 1, then 1 + 7 more.
        assert_eq!(reconverges(&[1, 1, 9, 9], 2), Ok(()));
        let error = reconverges(&[1, 1, 9, 8], 2).expect_err("a lane was missing");
        assert!(error.contains("subgroup 1 of 2 added up to 8 instead of 9"), "{error}");
    }

    #[test]
    fn each_disagreement_is_named() {
        // A driver for AMD's GPUs on Macs reported 64 for subgroups of 32.
        let told = sound(32).into_iter().map(|[lanes, _, count, place]| [lanes, 64, count, place]).collect();
        let last = |change: fn([u32; 4]) -> [u32; 4]| {
            let mut seen = sound(32);
            seen[255] = change(seen[255]);
            seen
        };
        let cases: [(Vec<[u32; 4]>, &str); 5] = [
            (told, "gl_SubgroupSize 64"),
            (last(|[_, b, c, d]| [16, b, c, d]), "255 of 256 has active lanes 16"),
            (last(|[a, b, _, d]| [a, b, 4, d]), "gl_NumSubgroups 4"),
            (last(|[a, b, c, d]| [a, b, c, d + (1 << 16)]), "gl_SubgroupID 8"),
            (last(|[a, b, c, d]| [a, b, c, d - 1]), "gl_SubgroupInvocationID 30 instead of 31"),
        ];
        for (seen, named) in cases {
            let error = width(&seen).expect_err(named);
            assert!(error.contains(named), "{error}");
        }
    }
}
