//! Work that rasterisers leave out: the forward pass loads no splats behind those that make a tile opaque, and a
//! subgroup of the backward pass skips splats that none of its pixels draws.

use crate::support::{device, finish};
use bytemuck::Zeroable;
use qirf_vk::gpu::{Buffer, Device, Groups, Recording};
use qirf_vk::kernels::View;
use qirf_vk::kernels::render::{Rasterise, RasteriseBackward, RasteriseBackwardSpec, RasteriseSpec};

const TILE: u32 = 16;
const LISTED: u32 = 2000;

/// The number of batches loaded by a tile that every splat covers, and by one that every splat misses, with as many
/// splats each.
fn loaded(device: &Device, workgroup: u32, batch: u32) -> [f32; 2] {
    let view = View { size: [2 * TILE, TILE], whole: [2 * TILE, TILE], tiles: [2, 1], ..View::zeroed() };
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
            stride: 1,
            batch,
            stop: 1e-4,
            pixels: TILE * TILE / workgroup,
            count_batches: true,
            count_blended: false,
            medians: false,
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
            // Three splats with an opacity of 0.99 end a pixel.
            assert_eq!(loaded(&device, workgroup, batch), [1.0, all as f32], "batches of {batch}");
        }
    }
    finish(&device);
}

/// The number of subgroups that drew each splat in the backward pass. The splats lie in one tile, each at its own
/// position, and their alpha falls to 1/255 after `reach` pixels.
fn takers(device: &Device, workgroup: u32, at: &[[f32; 2]], reach: f32, opacity: f32) -> Vec<f32> {
    let view = View { size: [TILE, TILE], whole: [TILE, TILE], tiles: [1, 1], ..View::zeroed() };
    let (n, subgroup) = (at.len() as u32, device.info().subgroup_size);
    let cut = (255.0 * opacity).log2();
    let factor = cut.sqrt() / reach;
    // Positions are relative to the picture's middle.
    let middle = TILE as f32 / 2.0;
    let geometry: Vec<[f32; 4]> = at.iter().map(|[x, y]| [x - middle, y - middle, factor, 0.0]).collect();
    let shape = vec![[factor, opacity.log2(), cut, 0.5]; at.len()];
    let slots: Vec<u32> = (0..n).collect();
    let (pixels, unused) = ((TILE * TILE) as usize, device.buffer("unused", 1).unwrap());
    let sums = device.buffer("blue sums", at.len()).unwrap();
    let vectors = || device.buffer("sums", at.len()).unwrap();
    let kernel = RasteriseBackward {
        view: &device.upload("view", &[view]).unwrap(),
        starts: &device.upload("starts", &[0, n]).unwrap(),
        slots: &device.upload("slots", &slots).unwrap(),
        owners: &device.upload("owners", &slots).unwrap(),
        geometry: &device.upload("geometry", &geometry).unwrap(),
        shape: &device.upload("shape", &shape).unwrap(),
        colour: &device.upload("colour", &vec![[0.5_f32; 2]; at.len()]).unwrap(),
        image: &device.upload("image", &vec![[0.5_f32; 4]; pixels]).unwrap(),
        image_gradient: &device.upload("image gradient", &vec![[1.0_f32; 4]; pixels]).unwrap(),
        position_sums: &vectors(),
        covariance_sums: &vectors(),
        blue_sums: &sums,
        response_sums: &unused,
        spec: RasteriseBackwardSpec {
            workgroup,
            tile: TILE,
            stride: 1,
            pixels: TILE * TILE / workgroup,
            stop: 5e-5,
            residual: false,
            batch: subgroup,
            count_takers: true,
        },
    };
    let mut recording = Recording::new();
    recording.dispatch(&kernel, Groups::Count(1));
    device.run(recording).unwrap();
    sums.read(device).unwrap()
}

#[test]
fn subgroups_skip_what_they_do_not_draw() {
    let device = device();
    let workgroup = 128;
    let subgroups = (workgroup / device.info().subgroup_size) as f32;
    let centres: Vec<[f32; 2]> = (0..TILE * TILE).map(|p| [(p % TILE) as f32 + 0.5, (p / TILE) as f32 + 0.5]).collect();
    // One pixel belongs to one subgroup; no pixel lies between four pixels; a wide splat reaches all subgroups.
    assert_eq!(takers(&device, workgroup, &centres, 0.6, 0.5), vec![1.0; centres.len()]);
    let corners: Vec<[f32; 2]> = centres.iter().map(|[x, y]| [x + 0.5, y + 0.5]).collect();
    assert_eq!(takers(&device, workgroup, &corners, 0.6, 0.5), vec![0.0; centres.len()]);
    // Behind three splats with an opacity of 0.99, every pixel is done.
    let wide = takers(&device, workgroup, &[[8.0, 8.0]; 40], 1e4, 1.0);
    assert_eq!(wide, [vec![subgroups; 3], vec![0.0; 37]].concat());
    finish(&device);
}
