//! The tests' guards of buffers do detect violations.

use crate::support::{device, new_device};
use qirf_vk::gpu::{Buffer, Recording};
use qirf_vk::primitives::{Count, gather};

#[test]
fn a_store_behind_a_buffers_end_is_found_alive_or_gone() {
    let device = new_device();
    let indices: Vec<u32> = (0..10).collect();
    let (list, source) = (device.upload("list", &indices).unwrap(), device.upload("source", &indices).unwrap());
    let short: Buffer<u32> = device.buffer("too short", 6).unwrap();
    let write = |count: u32| {
        let count = Count::known(&device, "count", count, &[]).unwrap();
        let mut recording = Recording::new();
        gather(&mut recording, &count, &list, &source, &short);
        device.run(recording).unwrap();
    };
    write(6);
    assert!(device.overrun_buffers().is_empty(), "stores that fit are not reported");
    write(7);
    assert_eq!(device.overrun_buffers(), ["too short"]);
    drop(short);
    assert_eq!(device.overrun_buffers(), ["too short"], "the report outlives the buffer");
}

#[test]
fn what_no_kernel_wrote_is_no_number() {
    let device = device();
    let values = [1.0_f32, 2.0, 3.0, 4.0];
    let source = device.upload("source", &values).unwrap().cast::<u32>();
    let list = device.upload("list", &[3_u32, 1]).unwrap();
    let target: Buffer<f32> = device.buffer("target", 4).unwrap();
    let count = Count::known(&device, "count", 2, &[]).unwrap();
    let mut recording = Recording::new();
    gather(&mut recording, &count, &list, &source, &target.cast());
    device.run(recording).unwrap();
    let got = target.read(&device).unwrap();
    assert_eq!(got[..2], [4.0, 2.0]);
    assert!(got[2..].iter().all(|v| v.is_nan()), "{got:?}");
    // Reused memory is poisoned again.
    drop((target, source));
    let again: Buffer<f32> = device.buffer("again", 64).unwrap();
    assert!(again.read(&device).unwrap().iter().all(|v| v.is_nan()));
}
