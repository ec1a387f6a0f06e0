//! The device's rates, from which `make figures` computes its bounds.

#[path = "../../benches/engine/peak.rs"]
mod peak;

use crate::support::{device, finish};
use peak::{By, Chain, Copy, MultiplyAdd};
use qirf_vk::gpu::{Buffer, Hazards, Recording};

#[test]
fn rates_do_the_work_that_they_count() {
    let device = device();
    for by in [By::Kernel, By::Command] {
        // Not a multiple of any workgroup size.
        let copy = Copy::new(&device, 100_003, by).unwrap();
        let mut recording = Recording::new();
        copy.record(&mut recording);
        device.run(recording).unwrap();
        assert!(copy.moved() >= 64 << 20 && copy.moved().is_multiple_of(2 * Buffer::<f32>::bytes_of(100_003)));
        assert!(copy.to.read(&device).unwrap().iter().all(|v| *v == 1.0), "{by:?}");
    }
    let chain = Chain::new(&device).unwrap();
    let mut recording = Recording::new();
    chain.record(&mut recording);
    let work = recording.work(&mut Hazards::default());
    assert_eq!((work.dispatches, work.barriers), (Chain::DISPATCHES as usize, Chain::DISPATCHES as usize - 1));
    device.run(recording).unwrap();
    let work = MultiplyAdd::new(&device).unwrap();
    let mut recording = Recording::new();
    work.record(&mut recording);
    device.run(recording).unwrap();
    let sums = work.sums.read(&device).unwrap();
    assert!(work.operations() > 1_000_000_000 && sums.iter().all(|s| *s == sums[0] && *s == 12.0));
    finish(&device);
}
