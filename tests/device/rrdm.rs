//! Density matrices on the device against their float64 twin.

use super::overlap::{blocks, model};

use crate::support::{Random, device, finish};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::Error;
use qirf_vk::qirf::assemble::{Assembled, Assembly, Options, unpack_lower};
use qirf_vk::qirf::rrdm::Density;
use qirf_vk::reference::rrdm;

#[test]
fn rrdm_is_its_factors_square_as_its_twin_is() {
    let device = device();
    let sizes = [1, 9, 40, 130];
    let (rows, starts) = blocks(&sizes, 5);
    let n = rows.len();
    let mut r = Random(9);
    let h: Vec<[f32; 8]> = (0..n).map(|_| [0; 8].map(|_| r.unit() as f32)).collect();
    // Members in an order other than the model's.
    let members: Vec<u32> = (0..n as u32).map(|i| (i * 7 + 3) % n as u32).collect();
    let resident = Resident::upload(&device, &model(&rows)).unwrap();
    let density = Density { full: true, ..Density::default() };
    let options = Options { density: Some(density), batch_bytes: 4 * 900, ..Options::default() };
    let assembly = Assembly::new(&device, &resident, &members, &starts, &h, options).unwrap();
    let mut seen = 0;
    let check = |batch: &Assembled<'_>| -> Result<(), Error> {
        for (b, block) in batch.iter() {
            let m = block.m;
            let own = &members[starts[b] as usize..starts[b + 1] as usize];
            // The twin takes responses without the channels' weights; the device receives rows that contain them.
            let bare = |i: &u32| {
                let row = h[*i as usize].map(f64::from);
                std::array::from_fn(|k| row[k] / if k < 4 { 0.75_f64.sqrt() } else { 0.25_f64.sqrt() })
            };
            let w = rrdm::w(&own.iter().map(bare).collect::<Vec<_>>(), 0.75, 1e-4);
            let expected = rrdm::p(&w);
            let mut p = vec![f64::NAN; m * m];
            unpack_lower(m, block.density.expect("asked for"), &mut p);
            for row in 0..m {
                for k in 0..8 {
                    assert!((f64::from(block.factor.expect("asked for")[k * m + row]) - w[row][k]).abs() < 1e-6);
                }
                for c in 0..=row {
                    assert!((p[c * m + row] - expected[row * m + c]).abs() < 1e-6, "block {b}, {row}, {c}");
                }
            }
            seen += 1;
        }
        Ok(())
    };
    assembly.for_each(check).unwrap();
    assert_eq!(seen, sizes.len());
    finish(&device);
}
