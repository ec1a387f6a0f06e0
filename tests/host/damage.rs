//! Damaged files of every input, on every system. `program::faults::mutations` limits memory and time, too.

use crate::support::files::corpus::{damaged, inputs};
use qirf_vk::gaussians::formats;
use qirf_vk::random;
use std::path::Path;

/// Models that can still be read are finite: the input's reader asserts it.
#[test]
fn damaged_files_never_panic() {
    let inputs = inputs();
    let folders: Vec<_> = inputs.iter().map(|_| tempfile::tempdir().unwrap()).collect();
    inputs.iter().zip(&folders).for_each(|(input, folder)| input.prepare(folder.path()));
    let mut loaded = 0;
    // Cases that `program::faults` does not have.
    for case in 20_000..20_600_u64 {
        let at = (case % inputs.len() as u64) as usize;
        loaded += usize::from(inputs[at].read(&damaged(case, &inputs[at], &inputs), folders[at].path()));
    }
    assert!((60..540).contains(&loaded), "{loaded} of 600 load");
}

#[test]
fn noise_never_panics() {
    for case in 0..100 {
        let length = (random::bits(&[case, 1]) % 600) as usize;
        let noise: Vec<u8> = (0..length).map(|i| random::bits(&[case, 2, i as u64]) as u8).collect();
        let magics: [&[u8]; 8] = [
            b"",
            b"ply\n",
            b"\x1f\x8b\x08\0",
            b"NGSP\x03\0\0\0",
            b"NGSP\x04\0\0\0",
            b"PK\x03\x04",
            b"glTF\x02\0\0\0",
            b"#usda",
        ];
        for magic in magics {
            for name in ["a.ply", "a.splat", "a.ksplat", "a.gltf", "a.usdz", "a"] {
                let _ = formats::read_bytes(&[magic, &noise].concat(), Path::new(name));
            }
        }
    }
}
