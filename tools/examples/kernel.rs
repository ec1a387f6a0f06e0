//! A kernel of your own on the engine's device: takes the colour out of a rendered picture before it leaves the device.
//! `cargo run --release --example kernel -- flowers.ply grey.png`.
//!
//! The shader is `grey.comp`, compiled by `glslc -O0 --target-env=vulkan1.2 grey.comp -o grey.spv`. `SHADER` describes
//! it to the engine: its bindings, and what it does with each. Barriers follow from that.

use qirf_vk::gaussians::formats;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::glam::DVec3;
use qirf_vk::gpu::{Access, Buffer, Device, DeviceOptions, Groups, Kernel, RawBuffer, Recording, Shader};
use qirf_vk::render::{Renderer, Settings};
use qirf_vk::scene::camera::Camera;
use std::error::Error;
use std::path::{Path, PathBuf};

const RING: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tools/examples/ring.ply");

/// Push constants, laid out as `grey.comp` has them.
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
struct Push {
    count: u32,
    amount: f32,
}

/// The kernel with its arguments.
struct Grey<'a> {
    pixels: &'a Buffer<[f32; 4]>,
    push: Push,
}

impl Grey<'_> {
    const SHADER: &'static Shader = &Shader {
        name: "examples/grey",
        spirv: include_bytes!("../../glsl/spirv/examples-grey.spv"),
        bindings: &[Access::ReadWrite],
        push_size: size_of::<Push>() as u32,
        constants: &[],
        subgroup_constant: None,
        backwards_constant: None,
    };
}

impl Kernel for Grey<'_> {
    fn shader(&self) -> &'static Shader {
        Self::SHADER
    }
    fn buffers(&self, into: &mut Vec<RawBuffer>) {
        into.push(self.pixels.raw().clone());
    }
    fn push_bytes(&self) -> &[u8] {
        bytemuck::bytes_of(&self.push)
    }
    fn constants(&self, _: &mut Vec<u32>) {}
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let model = arguments.next().unwrap_or_else(|| RING.into());
    let path = arguments.next().unwrap_or_else(|| "grey.png".into());
    let (coloured, grey) = grey(&model, &path)?;
    println!("{}: mean saturation {coloured:.3} before, {grey:.3} after", path.display());
    Ok(())
}

/// Writes a picture of a model without its colours; returns the mean saturation before and after.
pub(crate) fn grey(model: &Path, path: &Path) -> Result<(f32, f32), Box<dyn Error>> {
    let gaussians = formats::read(model)?.gaussians;
    let device = Device::open(&DeviceOptions::from_env()?)?;
    let resident = Resident::upload(&device, &gaussians)?;
    let camera = Camera::look_at(DVec3::new(0.0, -1.0, 3.0), DVec3::ZERO, DVec3::NEG_Y, 1.0, 640, 480);
    let mut renderer = Renderer::new(&device, Settings::default(), gaussians.len(), 640, 480)?;
    let before = saturation(&renderer.render(&resident, &camera)?.pixels);

    let pixels = renderer.image();
    let count = camera.width * camera.height;
    let mut recording = Recording::new();
    recording.dispatch(&Grey { pixels, push: Push { count, amount: 1.0 } }, Groups::Count(count.div_ceil(64)));
    device.run(recording)?;

    let after = pixels.read_first(&device, count as usize)?;
    let bytes = after.iter().map(|[grey, ..]| (grey.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    image::GrayImage::from_raw(camera.width, camera.height, bytes).expect("a byte a pixel").save(path)?;
    Ok((before, saturation(&after)))
}

/// Mean difference of the largest and the smallest of red, green and blue.
fn saturation(pixels: &[[f32; 4]]) -> f32 {
    let spread = |[r, g, b, _]: &[f32; 4]| r.max(*g).max(*b) - r.min(*g).min(*b);
    pixels.iter().map(spread).sum::<f32>() / pixels.len().max(1) as f32
}
