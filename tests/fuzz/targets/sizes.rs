#![no_main]
//! Inputs of shaders: sizes, counts, capacities, cameras and values, on the present device.

use glam::{DMat3, DVec2, DVec3};
use libfuzzer_sys::fuzz_target;
use qirf_vk::gaussians::{Gaussians, resident::Resident};
use qirf_vk::gpu::{Device, DeviceOptions, Recording};
use qirf_vk::primitives::{Count, Scan};
use qirf_vk::render::{Renderer, Style};
use qirf_vk::scene::camera::Camera;
use std::sync::LazyLock;

static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let options = DeviceOptions { validation: true, memory_limit: Some(256 << 20), ..DeviceOptions::from_env().expect("options of the environment") };
    Device::open(&options).expect("a Vulkan device")
});

/// Takes numbers from the fuzzer's bytes; zeros after their end.
struct Take<'a>(&'a [u8]);

impl Take<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let n = N.min(self.0.len());
        out[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        out
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.bytes())
    }

    /// A finite number, as the readers guarantee.
    fn finite(&mut self) -> f32 {
        let x = self.f32();
        if x.is_finite() { x } else { 1.0 }
    }
}

fuzz_target!(|data: &[u8]| {
    let mut take = Take(data);
    let device = &*DEVICE;
    match take.bytes::<1>()[0] % 3 {
        0 => picture(device, &mut take),
        1 => scan(device, &mut take),
        // Every request is met, or refused with the buffer's name and bytes.
        _ => {
            let len = (take.u32() as usize) << (take.bytes::<1>()[0] % 33);
            match device.buffer::<f32>("asked for", len / 4) {
                Ok(buffer) => assert_eq!(buffer.len(), len / 4),
                Err(e) => assert!(e.is_resources() && e.to_string().contains("asked for")),
            }
        }
    }
    assert_eq!(Device::validation_messages(), 0);
});

fn picture(device: &Device, take: &mut Take) {
    let [n, degree, w, h] = take.bytes::<4>().map(usize::from);
    let (n, degree) = (n % 40, degree % 4);
    // Long and thin pictures more often than large ones.
    let (width, height) = if w % 8 == 0 { (16 * w as u32 + 1, 1 + h as u32 % 4) } else { (1 + w as u32 % 70, 1 + h as u32 % 70) };
    let style = take.bytes::<1>()[0];
    let style = Style { antialias: style & 1 == 1, depth_order: style & 2 == 2, dilation: None };
    let settings = style.over([0; 3].map(|_: u8| take.finite().clamp(0.0, 1.0)));
    let focal = DVec2::new(f64::from(take.finite().abs().clamp(1e-3, 1e6)), f64::from(take.finite().abs().clamp(1e-3, 1e6)));
    let mut model = Gaussians::zeroed(n, degree);
    let values = model.means.iter_mut().flatten().chain(model.log_scales.iter_mut().flatten());
    let values = values.chain(model.rotations.iter_mut().flatten()).chain(model.opacity_logits.iter_mut());
    values.chain(model.sh.iter_mut().flatten()).for_each(|x| *x = take.finite());
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::new(0.0, 0.0, 4.0),
        focal,
        principal: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
        width,
        height,
        whole: None,
    };
    let resident = Resident::upload(device, &model).expect("a small model");
    let mut renderer = Renderer::new(device, settings, n, width, height).expect("a small picture");
    match renderer.render(&resident, &camera) {
        Ok(image) => {
            assert_eq!(image.pixels.len(), (width * height) as usize);
            assert!(image.pixels.iter().all(|p| (0.0..=1.0 + 1e-4).contains(&p[3])), "alpha");
        }
        Err(e) => assert!(e.is_resources(), "{e}"),
    }
}

fn scan(device: &Device, take: &mut Take) {
    let n = take.u32() % 20_000;
    let seed = take.u32();
    let data: Vec<u32> = (0..n).map(|i| (i.wrapping_mul(seed) >> 7) % 1000).collect();
    let source = device.upload("source", &data).expect("a small buffer");
    let target = device.upload("target", &vec![7; n as usize]).expect("a small buffer");
    let count = Count::known(device, "n", n, &[Scan::block(device)]).expect("a count");
    let scan = Scan::new(device, n).expect("a scan");
    let total = Count::new(device, "total", u32::MAX, &[]).expect("a count");
    let mut recording = Recording::new();
    scan.record(&mut recording, &count, (&source).into(), &target, &total);
    device.run(recording).expect("it runs");
    let mut sum = 0;
    for (got, value) in target.read(device).expect("it is there").into_iter().zip(data) {
        assert_eq!(got, sum);
        sum += value;
    }
}
