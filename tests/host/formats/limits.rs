//! Small files that would fill much memory are refused before they do; small files of equal Gaussians are read.

use qirf_vk::gaussians::Error;
use qirf_vk::gaussians::formats::Loaded;
use std::io::Write;

use super::readers::read;
use crate::support::files::gltf::{Layout, glb_changed, glb_of_spz};
use crate::support::files::make;
use serde_json::{Value, json};

fn gzip(parts: &[&[u8]]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    for part in parts {
        encoder.write_all(part).unwrap();
    }
    encoder.finish().unwrap()
}

/// An SPZ of `n` equal Gaussians of SH degree 3.
fn equal(n: usize) -> Vec<u8> {
    let header = [&b"NGSP\x03\0\0\0"[..], &(n as u32).to_le_bytes(), &[3, 12, 0, 0]].concat();
    gzip(&[&header, &vec![1; n * 65]])
}

fn refused(read: Result<Loaded, Error>, what: &str) {
    let said = read.expect_err("must be refused").to_string();
    assert!(said.contains(what), "{said}");
}

/// A Gaussian of degree 3 takes 236 bytes of memory: 250,000 take 59 MB, and 300,000 take 71 MB.
#[test]
fn equal_gaussians_are_read_up_to_a_limit() {
    let (small, large) = (equal(250_000), equal(300_000));
    assert!(large.len() < 100_000);
    assert_eq!(read(&small, "m.spz").unwrap().gaussians.len(), 250_000);
    refused(read(&large, "m.spz"), "300000 Gaussians claimed");
    refused(read(&glb_of_spz(&large, 300_000, false), "m.glb"), "300000 Gaussians claimed");
    // A larger file may hold more: bytes after the gzip stream stand for its content here.
    assert_eq!(read(&[large, vec![0; 600_000]].concat(), "m.spz").unwrap().gaussians.len(), 300_000);
}

#[test]
fn gzip_stops_at_a_limit() {
    let ply = make::ply(&make::model(7, 0), make::Encoding::Little, false);
    assert_eq!(read(&gzip(&[&ply, &vec![0; 60 << 20]]), "m.ply.gz").unwrap().gaussians.len(), 7);
    refused(read(&gzip(&[&ply, &vec![0; 70 << 20]]), "m.ply.gz"), "unpack to more than 67108864");
}

#[test]
fn a_glb_says_how_many_gaussians_its_spz_has() {
    let spz = make::spz(6, 3, 1, true);
    assert_eq!(read(&glb_of_spz(&spz, 6, false), "m.glb").unwrap().gaussians.len(), 6);
    refused(read(&glb_of_spz(&spz, 7, false), "m.glb"), "6 Gaussians claimed, 7 by the file around it");
}

/// One mesh of 1,000 Gaussians (92 kB), placed as often as the limit allows, and more often.
#[test]
fn meshes_are_placed_up_to_a_limit() {
    let placed = |times: usize| {
        let glb = glb_changed(&make::model(1000, 1), Layout::Planar, |d: &mut Value| {
            d["nodes"] = vec![json!({ "mesh": 0 }); times].into();
            d["scenes"] = json!([{ "nodes": (0..times).collect::<Vec<_>>() }]);
        });
        read(&glb, "m.glb")
    };
    assert_eq!(placed(700).unwrap().gaussians.len(), 700_000);
    refused(placed(800), "placed too often");
    let copied = glb_changed(&make::model(1000, 1), Layout::Planar, |d: &mut Value| {
        let places = d["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
        d["nodes"][1]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": places } } });
    });
    refused(read(&copied, "m.glb"), "placed too often");
}
