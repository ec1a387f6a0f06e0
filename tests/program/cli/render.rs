//! `render`: pictures of scenes and orbits, their formats, outputs that cannot be written, and an interrupt. `convert --lod`: the same
//! of its output, and what it says of levels.

use super::{Sandbox, model};
use qirf_vk::gaussians::formats;
use std::fs;
use std::path::Path;

fn size(path: &Path) -> (u32, u32) {
    image::image_dimensions(path).unwrap()
}

#[test]
fn pictures_of_a_scene_are_named_after_its_images() {
    let sandbox = Sandbox::new();
    let ran = sandbox.validated(&["render", "model.ply", "--scene", "scene", "-o", "out"]);
    assert!(ran.out.is_empty() && ran.said.contains("2 pictures"), "{}", ran.said);
    let first = fs::read(sandbox.path("out/one.png")).unwrap();
    assert_eq!((size(&sandbox.path("out/one.png")), size(&sandbox.path("out/b/two.png"))), ((40, 30), (40, 30)));
    let picture = image::open(sandbox.path("out/one.png")).unwrap().into_rgb8();
    assert!(picture.pixels().any(|p| p.0[0] > 60), "something is drawn");

    // Again: the same bytes in the same place. Half the size; quiet.
    sandbox.works(&["render", "model.ply", "--scene", "scene", "-o", "out"]);
    assert_eq!(fs::read(sandbox.path("out/one.png")).unwrap(), first);
    let ran = sandbox.works(&["-q", "render", "model.ply", "--scene", "scene", "-o", "half", "--resolution", "/2"]);
    assert!(ran.said.is_empty() && ran.out.is_empty());
    assert_eq!(size(&sandbox.path("half/b/two.png")), (20, 15));
    sandbox.works(&["render", "model.ply", "--scene", "scene/sparse/0", "-o", "w", "--resolution", "10"]);
    assert_eq!(size(&sandbox.path("w/one.png")), (10, 8));
}

#[test]
fn npy_holds_float32_height_width_4() {
    let sandbox = Sandbox::new();
    let background = ["--background", "0.25,0.5,1"];
    sandbox.works(
        &[&["render", "model.ply", "--scene", "scene", "-o", "out", "--format", "npy"], &background[..]].concat(),
    );
    let file =
        npyz::NpyFile::new(fs::File::open(sandbox.path("out/one.npy")).map(std::io::BufReader::new).unwrap()).unwrap();
    assert_eq!(file.shape(), [30, 40, 4]);
    assert_eq!(file.order(), npyz::Order::C);
    let values: Vec<f32> = file.into_vec().unwrap();
    let empty = values.chunks_exact(4).find(|p| p[3] == 0.0).expect("a pixel without Gaussians");
    assert_eq!(empty, [0.25, 0.5, 1.0, 0.0]);

    // The PNG holds the same values in 8 bits.
    sandbox.works(&[&["render", "model.ply", "--scene", "scene", "-o", "out"], &background[..]].concat());
    let picture = image::open(sandbox.path("out/one.png")).unwrap().into_rgb8();
    for (pixel, value) in picture.pixels().zip(values.chunks_exact(4)) {
        for c in 0..3 {
            assert!((f32::from(pixel.0[c]) / 255.0 - value[c].clamp(0.0, 1.0)).abs() < 0.51 / 255.0);
        }
    }
}

#[test]
fn orbits_of_any_model_show_it() {
    let sandbox = Sandbox::new();
    let turned = ["--size", "64x48", "--up", "-z", "--fov", "60"];
    sandbox.validated(&[&["render", "model.ply", "--orbit", "3", "-o", "out"][..], &turned].concat());
    for i in 0..3 {
        let path = sandbox.path(&format!("out/orbit_00{i}.png"));
        assert_eq!(size(&path), (64, 48));
        let picture = image::open(path).unwrap().into_rgb8();
        assert!(picture.pixels().filter(|p| p.0[0] > 30).count() > 100);
    }
    let clear = ["--size", "64x48", "--transparent", "--antialias"];
    sandbox.works(&[&["render", "model.ply", "--orbit", "1", "-o", "clear"][..], &clear].concat());
    let picture = image::open(sandbox.path("clear/orbit_000.png")).unwrap();
    assert!(picture.color().has_alpha());
    assert!(picture.into_rgba8().pixels().any(|p| p.0[3] == 0));

    // One Gaussian, none at all, a picture of one pixel, a model a thousandth the size.
    let mut tiny = model(20);
    tiny.means.iter_mut().flatten().for_each(|v| *v *= 1e-3);
    tiny.log_scales.iter_mut().flatten().for_each(|v| *v -= 6.9);
    for (name, model) in [("lone.ply", model(1)), ("none.ply", model(0)), ("tiny.ply", tiny)] {
        formats::write(&sandbox.path(name), &model, formats::RenderMode::Plain).unwrap();
        sandbox.works(&["render", name, "--orbit", "1", "-o", name.trim_end_matches(".ply"), "--size", "32x32"]);
        sandbox.works(&["render", name, "--orbit", "1", "-o", "one", "--size", "1x1"]);
    }
    let shown = |name: &str| {
        let picture = image::open(sandbox.path(name).join("orbit_000.png")).unwrap().into_rgb8();
        picture.pixels().filter(|p| p.0[0] > 30).count()
    };
    assert!(shown("lone") > 20 && shown("tiny") > 50 && shown("none") == 0);
}

/// Otherwise the message is that of the device.
#[test]
fn an_output_that_cannot_be_written_is_refused_before_a_device_is_opened() {
    let sandbox = Sandbox::new();
    let device = ["--device", "no such device"];
    let fails = |command: &[&str]| sandbox.fails(5, &[command, &device].concat(), &["model.ply"]);
    fails(&["render", "model.ply", "--panorama", "-o", "model.ply/around.png"]);
    fails(&["convert", "model.ply", "model.ply/new/lod-meta.json", "--lod", "3"]);
}

#[test]
fn levels_of_detail_are_measured_as_they_are_written() {
    let sandbox = Sandbox::new();
    let said = sandbox.works(&["convert", "model.ply", "lod/lod-meta.json", "--lod", "2"]).said;
    assert!(said.contains("level 0: 20 Gaussians, ") && said.contains("level 1: 7 Gaussians, "), "{said}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_with_130_and_whole_pictures() {
    use crate::program::faults::harness::{start, whole};
    let sandbox = Sandbox::new();
    let render = ["render", "model.ply", "--orbit", "100000", "-o", "out", "--size", "64x48"];
    let mut child = start(&mut sandbox.command(&render));
    assert!(child.until(|| sandbox.path("out/orbit_000003.png").exists()), "no picture came");
    child.signal("INT").with(130, &["interrupted"]);
    whole(&sandbox.path("out"));
}
