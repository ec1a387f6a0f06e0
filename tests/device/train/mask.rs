//! Masks against their twin: hidden parts are background and pass no gradient.

use crate::support::{Random, device, finish};
use qirf_vk::gpu::Recording;
use qirf_vk::reference::mask;
use qirf_vk::train::mask::Mask;

#[test]
fn mask_hides_as_its_twin_does_and_takes_the_gradient_back() {
    let device = device();
    let background = [0.25_f32, 0.5, 0.75];
    for n in [1, 300, 70_001] {
        let mut r = Random(n as u64);
        let mut pixels = || -> Vec<[f32; 4]> { (0..n).map(|_| [0; 4].map(|_| r.within(-1.0, 1.0) as f32)).collect() };
        let (image, gradient) = (pixels(), pixels());
        // Completely hidden, completely visible, and everything between.
        let photo: Vec<u32> = (0..n as u32).map(|i| [0, 255, i % 256][i as usize % 3] << 24 | 0x0012_3456).collect();
        let held = Mask::new(&device, n, background).unwrap();
        let photos = device.upload("photo", &photo).unwrap();
        let pictures = device.upload("picture", &image).unwrap();
        let gradients = device.upload("gradient", &gradient).unwrap();
        let mut recording = Recording::new();
        held.apply(&mut recording, &photos, &pictures, n as u32);
        held.backward(&mut recording, &photos, &gradients, n as u32);
        device.run(recording).unwrap();
        let wide = |rows: &[[f32; 4]]| -> Vec<[f64; 4]> { rows.iter().map(|row| row.map(f64::from)).collect() };
        let near = |got: Vec<[f32; 4]>, expected: Vec<[f64; 4]>| {
            assert_eq!(got.len(), expected.len());
            for (at, (g, e)) in got.iter().zip(&expected).enumerate() {
                assert!((0..4).all(|c| (f64::from(g[c]) - e[c]).abs() < 1e-6), "pixel {at} of {n}: {g:?}, {e:?}");
            }
        };
        near(held.image.read(&device).unwrap(), mask::mask(&wide(&image), &photo, background.map(f64::from)));
        near(gradients.read(&device).unwrap(), mask::backward(&wide(&gradient), &photo));
    }
    finish(&device);
}
