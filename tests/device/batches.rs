//! The forward rasteriser loads no splats behind what covers a tile.

use crate::support::{device, finish};
use bytemuck::Zeroable;
use qirf_vk::gpu::{Buffer, Device, Groups, Recording};
use qirf_vk::kernels::View;
use qirf_vk::kernels::render::{Rasterise, RasteriseSpec};

const TILE: u32 = 16;
const LISTED: u32 = 2000;

/// A tile that every splat covers, and one that every splat misses, each with as many splats: the batches that each loads.
fn loaded(device: &Device, workgroup: u32, batch: u32) -> [f32; 2] {
    let view = View { size: [2 * TILE, TILE], tiles: [2, 1], ..View::zeroed() };
    // Position and two factors; third factor, log2 of the opacity, cut, red: see lib/splat.glsl.
    let (geometry, shape) = ([[0.0, 0.0, 0.0, 0.0], [900.0, 0.0, 1.0, 0.0]], [[0.0_f32, 0.0, 8.0, 0.5]; 2]);
    let owners: Vec<u32> = (0..2 * LISTED).map(|slot| slot / LISTED).collect();
    let slots: Vec<u32> = (0..2 * LISTED).collect();
    let image: Buffer<[f32; 4]> = device.buffer("image", (2 * TILE * TILE) as usize).unwrap();
    let kernel = Rasterise {
        view: &device.upload("view", &[view]).unwrap(),
        starts: &device.upload("starts", &[0, LISTED, 2 * LISTED]).unwrap(),
        slots: &device.upload("slots", &slots).unwrap(),
        owners: &device.upload("owners", &owners).unwrap(),
        geometry: &device.upload("geometry", &geometry).unwrap(),
        shape: &device.upload("shape", &shape).unwrap(),
        colour: &device.upload("colour", &[[0.5_f32; 2]; 2]).unwrap(),
        image: &image,
        spec: RasteriseSpec {
            workgroup,
            tile: TILE,
            batch,
            stop: 1e-4,
            pixels: TILE * TILE / workgroup,
            count_batches: true,
        },
    };
    let mut recording = Recording::new();
    recording.dispatch(&kernel, Groups::Count(2));
    device.run(recording).unwrap();
    let counts = image.read(device).unwrap();
    let of_tile = |tile: u32| counts.chunks(TILE as usize).skip(tile as usize).step_by(2).flatten().map(|p| p[3]);
    [0, 1].map(|tile| {
        let first = of_tile(tile).next().unwrap();
        assert!(of_tile(tile).all(|count| count == first), "a tile's pixels disagree");
        first
    })
}

#[test]
fn a_covered_tile_loads_one_batch() {
    let device = device();
    let subgroup = device.info().subgroup_size;
    for (workgroup, batch) in [(256, 256), (128, 128), (64, 64), (subgroup, 0)] {
        if workgroup % subgroup == 0 {
            let all = LISTED.div_ceil(if batch == 0 { subgroup } else { batch });
            // Three splats of an opacity of 0.99 end a pixel.
            assert_eq!(loaded(&device, workgroup, batch), [1.0, all as f32], "batches of {batch}");
        }
    }
    finish(&device);
}
