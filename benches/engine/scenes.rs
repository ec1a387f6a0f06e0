//! Generated scenes: the same on every machine, with the same coverage for any number of Gaussians.

use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu;
use qirf_vk::render::Renderer;
use qirf_vk::scene::{Photo, camera::Camera};

/// A counter-based generator: 32 bits of stream `seed` at `i`.
pub fn noise(seed: u64, i: u64) -> u32 {
    let mut x = (i + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ seed.wrapping_mul(0xD1B5_4A32_D192_ED03);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (x >> 32) as u32
}

/// `n` Gaussians in a ball of radius 2: discs and needles, most of them faint, as in trained models. Their size falls
/// with the root of their number, as in models of one surface at finer detail; `size` multiplies it.
pub fn crowd(n: usize, degree: usize, size: f64, seed: u64) -> Gaussians {
    let mut at = 0;
    let mut uniform = |low: f64, high: f64| {
        at += 1;
        low + (high - low) * f64::from(noise(seed, at)) / 4_294_967_296.0
    };
    let mut model = Gaussians { sh: vec![Vec::new(); degree + 1], ..Gaussians::default() };
    let base = (size * 1.5 / (n as f64).sqrt()).ln();
    for _ in 0..n {
        let (z, turn) = (uniform(-1.0, 1.0), uniform(0.0, std::f64::consts::TAU));
        let (radius, ring) = (2.0 * uniform(0.0, 1.0).cbrt(), (1.0 - z * z).sqrt());
        model.means.push([ring * turn.cos(), ring * turn.sin(), z].map(|v| (radius * v) as f32));
        model.log_scales.push([0, 1, 2].map(|_| (base + uniform(-2.0, 1.0)) as f32));
        model.rotations.push([0, 1, 2, 3].map(|_| uniform(-1.0, 1.0) as f32));
        model.opacity_logits.push(uniform(-5.0, 3.0) as f32);
        for (l, band) in model.sh.iter_mut().enumerate() {
            let width = if l == 0 { 1.0 } else { 0.2 };
            band.extend((0..Gaussians::band_width(l)).map(|_| uniform(-width, width) as f32));
        }
    }
    model
}

/// A camera that sees the whole ball, turned around it by this angle.
pub fn camera(width: u32, height: u32, turn: f64) -> Camera {
    let (sin, cos) = turn.sin_cos();
    let eye = DVec3::new(0.6 * cos + 4.6 * sin, -0.8, 0.6 * sin - 4.6 * cos);
    Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 0.9, width, height)
}

/// A model's picture as a photo: of one crowd as the target of another, every pixel has an error.
pub fn photo(renderer: &mut Renderer, model: &Resident, camera: &Camera) -> gpu::Result<Photo> {
    let image = renderer.render(model, camera)?;
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0) as u8;
    let pixels: Vec<u8> = image.pixels.iter().flat_map(|[r, g, b, _]| [byte(*r), byte(*g), byte(*b), 255]).collect();
    Ok(Photo::opaque(camera.clone(), pixels))
}
