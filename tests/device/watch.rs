//! The watcher works: validation layers report a dropped barrier, within a submission and between two.

use crate::support::{device, opened, skip};
use qirf_vk::gpu::{Buffer, Device, Forget, Groups, Hazard, Order, Recording};
use qirf_vk::kernels::rates::{Copy, CopyPush, CopySpec};
use std::process::Command;

const COUNT: usize = 1024;

fn copy(recording: &mut Recording, source: &Buffer<f32>, target: &Buffer<f32>) {
    let (push, spec) = (CopyPush { count: COUNT as u32 }, CopySpec { workgroup: 256, rows: 4 });
    recording.dispatch(&Copy { source, target, push, spec }, Groups::Count(1));
}

/// Number of validation messages for two copies, the second of which reads the first one's result.
fn messages(device: &Device, forget: Forget, two_submissions: bool) -> usize {
    let [a, b, c] = ["first", "second", "third"].map(|name| device.buffer::<f32>(name, COUNT).unwrap());
    let before = Device::validation_messages();
    device.reorder(Order::Recorded, forget);
    let mut recording = Recording::new();
    copy(&mut recording, &a, &b);
    let mut under_way = Vec::new();
    if two_submissions {
        under_way.push(device.submit(std::mem::take(&mut recording)).unwrap());
    }
    copy(&mut recording, &b, &c);
    under_way.push(device.submit(recording).unwrap());
    for ticket in under_way {
        ticket.wait().unwrap();
    }
    Device::validation_messages() - before
}

#[test]
#[ignore = "its validation messages are wanted: the next test runs it in a process of its own"]
fn forgotten_barriers_raise_messages() {
    let device = opened(|options| options.harness.order = Some(Order::Recorded));
    assert!(device.validates(), "the validation layers are installed (tools/setup)");
    for two_submissions in [false, true] {
        assert_eq!(messages(&device, Forget::Nothing, two_submissions), 0, "two submissions: {two_submissions}");
        let forgotten = messages(&device, Forget::All(Hazard::ReadAfterWrite), two_submissions);
        assert!(forgotten > 0, "a forgotten barrier was not noticed; two submissions: {two_submissions}");
    }
}

/// Whether this is a copied program (`tools/gpu-report`) on a machine without the validation layers.
pub fn unwatched() -> bool {
    std::env::var_os("QIRF_SOURCE").is_some() && !device().validates()
}

#[test]
fn validation_tells_of_a_forgotten_barrier() {
    if unwatched() {
        return skip("no validation layers");
    }
    let own = std::env::current_exe().expect("this program");
    let name = "device::watch::forgotten_barriers_raise_messages";
    let output = Command::new(own).args(["--ignored", "--exact", name]).output().expect("it starts again");
    let told = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && told.contains("1 passed"), "{told}");
}
