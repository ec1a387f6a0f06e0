//! glTF: other programs' layouts, node transforms, our own files, and hostile ones.

use std::fs;

use qirf_vk::gaussians::formats::{self, Format, Loaded, RenderMode};
use qirf_vk::gaussians::{Error, Gaussians};
use serde_json::{Value, json};

use super::readers::read;
use super::writers::angle;
use crate::support::files::gltf::{Layout, bundle, glb, glb_changed, glb_of_spz, gltf};
use crate::support::files::make;

/// Asserts equality up to the rounding of exponentials, and up to integer steps if there are any.
#[track_caller]
pub fn assert_near(a: &Gaussians, b: &Gaussians, steps: f32) {
    assert_eq!((a.len(), a.degree(), &a.means, &a.sh), (b.len(), b.degree(), &b.means, &b.sh));
    for i in 0..a.len() {
        for k in 0..3 {
            let (s, t) = (a.log_scales[i][k], b.log_scales[i][k]);
            assert!((s - t).abs() < 1e-6, "scale {i}: {s} {t}");
        }
        let (p, q) = (a.opacity_logits[i], b.opacity_logits[i]);
        assert!((p - q).abs() < 2e-5 + 255.0 * steps, "opacity {i}: {p} {q}");
        assert!(angle(a.rotations[i], b.rotations[i]) < 1e-6 + f64::from(8.0 * steps), "rotation {i}");
    }
}

#[test]
fn layouts_of_other_programs_give_one_model() {
    for degree in 0..=3 {
        let mut model = make::model(40, degree);
        for layout in [Layout::Planar, Layout::Interleaved, Layout::Sparse] {
            let loaded = read(&glb(&model, layout), "m.glb").unwrap();
            assert_eq!((loaded.format, loaded.mode, loaded.repairs.any()), (Format::Gltf, RenderMode::Plain, false));
            assert_near(&model, &loaded.gaussians, 0.0);
            let (json, _) = gltf(&model, layout, None);
            assert_eq!(read(&json, "m.gltf").unwrap().gaussians, loaded.gaussians);
        }
        // Scales that are whole numbers, opacities of whole 255ths: exact in integers.
        model.log_scales.iter_mut().flatten().enumerate().for_each(|(i, s)| *s = (1.0 + i as f32).ln());
        model.opacity_logits.iter_mut().enumerate().for_each(|(i, o)| *o = ((i + 5) as f32 / (250 - i) as f32).ln());
        let loaded = read(&glb(&model, Layout::Quantised), "m.glb").unwrap();
        assert_near(&model, &loaded.gaussians, 0.5 / 32767.0);
    }
}

#[test]
fn a_written_gltf_holds_the_bytes_of_the_glb() {
    let folder = tempfile::tempdir().unwrap();
    let [text, binary] = ["m.gltf", "m.glb"].map(|name| folder.path().join(name));
    for model in [Gaussians::zeroed(0, 0), make::model(1, 0), make::model(5000, 3)] {
        for path in [&text, &binary] {
            formats::write_at(path, &model, RenderMode::AntiAliased, [1e6, 0.0, 2.0]).unwrap();
        }
        let [of_text, of_binary] = [&text, &binary].map(|path| formats::read(path).unwrap());
        assert_eq!(
            (of_text.gaussians, of_text.mode, of_text.origin),
            (of_binary.gaussians, of_binary.mode, of_binary.origin)
        );
        let json: Value = serde_json::from_slice(&fs::read(&text).unwrap()).unwrap();
        assert_eq!(json["buffers"].is_null(), model.is_empty());
    }
}

#[test]
fn a_written_glb_is_read_back_to_the_last_bit_of_exponentials() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.glb");
    for degree in 0..=3 {
        let model = make::model(5000, degree);
        for mode in [RenderMode::AntiAliased, RenderMode::Plain] {
            formats::write(&path, &model, mode).unwrap();
            let loaded = formats::read(&path).unwrap();
            assert_eq!((loaded.mode, &loaded.doubt, loaded.repairs.any()), (mode, &None, false));
            assert_near(&model, &loaded.gaussians, 0.0);
            let first = fs::read(&path).unwrap();
            formats::write(&path, &loaded.gaussians, mode).unwrap();
            let again = formats::read(&path).unwrap().gaussians;
            assert_near(&loaded.gaussians, &again, 0.0);
            assert_eq!(first.len(), fs::read(&path).unwrap().len());
        }
    }
    // The document as required by the specification.
    let bytes = fs::read(&path).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let primitive = &json["meshes"][0]["primitives"][0];
    assert_eq!(
        (&primitive["mode"], &primitive["extensions"]["KHR_gaussian_splatting"]["kernel"]),
        (&json!(0), &json!("ellipse"))
    );
    assert_eq!(primitive["attributes"].as_object().unwrap().len(), 5 + 16);
    assert!(json["accessors"][0]["min"][0].as_f64().unwrap() < -2.9 && (bytes.len() % 4, length % 4) == (0, 0));
}

#[test]
fn buffers_in_files_beside_it_are_read_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let model = make::model(9, 1);
    let (json, binary) = gltf(&model, Layout::Planar, Some("the%20data.bin"));
    let path = folder.path().join("m.gltf");
    fs::write(&path, &json).unwrap();
    assert!(formats::read(&path).unwrap_err().to_string().contains("the data.bin"));
    fs::write(folder.path().join("the data.bin"), [&binary[..], b"and more"].concat()).unwrap();
    assert_near(&model, &formats::read(&path).unwrap().gaussians, 0.0);
    assert!(read(&json, "m.gltf").unwrap_err().to_string().contains("by its path"));
    fs::write(folder.path().join("the data.bin"), &binary[..binary.len() - 1]).unwrap();
    assert!(formats::read(&path).unwrap_err().to_string().contains("bytes from"));
    let refused = |uri: &str, says: &str| {
        fs::write(&path, gltf(&model, Layout::Planar, Some(uri)).0).unwrap();
        let said = formats::read(&path).unwrap_err().to_string();
        assert!(said.contains(says), "{uri}: {said}");
    };
    for uri in ["/etc/passwd", "../x.bin", "%2e%2e/x.bin", "..\\x.bin", "https://a.org/x.bin", "a/../../x.bin", ""] {
        refused(uri, "not in the folder");
    }
    #[cfg(unix)]
    {
        let outside = tempfile::NamedTempFile::new().unwrap();
        std::os::unix::fs::symlink(outside.path(), folder.path().join("link.bin")).unwrap();
        refused("link.bin", "not a file in the folder");
    }
}

/// A model with a further view of the bytes 4, 2, 0, as `change` uses it.
fn with_bytes(model: &Gaussians, change: impl Fn(&mut Value, usize)) -> Result<Loaded, Error> {
    let bytes = glb_changed(model, Layout::Planar, |d| {
        let buffer =
            add(&mut d["buffers"], json!({ "byteLength": 3, "uri": "data:application/octet-stream;base64,BAIA" }));
        let view = add(&mut d["bufferViews"], json!({ "buffer": buffer, "byteLength": 3 }));
        change(d, view);
    });
    read(&bytes, "m.glb")
}

/// Adds to a list; returns its number.
fn add(list: &mut Value, what: Value) -> usize {
    let list = list.as_array_mut().unwrap();
    list.push(what);
    list.len() - 1
}

#[test]
fn indices_choose_points() {
    let chosen = |n: usize, count: usize| {
        with_bytes(&make::model(n, 1), |d, view| {
            let indices = json!({ "bufferView": view, "componentType": 5121, "count": count, "type": "SCALAR" });
            d["meshes"][0]["primitives"][0]["indices"] = add(&mut d["accessors"], indices).into();
        })
    };
    let whole = read(&glb(&make::model(9, 1), Layout::Planar), "m.glb").unwrap().gaussians;
    assert_eq!(chosen(9, 3).unwrap().gaussians, whole.select(&[4, 2, 0]));
    for (n, count, said) in [(4, 3, "beyond the 4 elements"), (9, 4, "beyond the end")] {
        let fault = chosen(n, count).unwrap_err().to_string();
        assert!(fault.contains(said), "{fault}");
    }
}

#[test]
fn sparse_positions_need_no_data() {
    let model = make::model(9, 1);
    let whole = read(&glb(&model, Layout::Planar), "m.glb").unwrap().gaussians;
    let sparse = with_bytes(&model, |d, view| {
        let index = d["meshes"][0]["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap() as usize;
        let of_values = d["accessors"][index]["bufferView"].take();
        d["accessors"][index].as_object_mut().unwrap().remove("bufferView");
        let indices = json!({ "bufferView": view, "componentType": 5121 });
        d["accessors"][index]["sparse"] =
            json!({ "count": 3, "indices": indices, "values": { "bufferView": of_values } });
    });
    let means = sparse.unwrap().gaussians.means;
    for (i, at) in [(4, Some(0)), (2, Some(1)), (0, Some(2)), (1, None), (8, None)] {
        assert_eq!(means[i], at.map_or([0.0; 3], |at| whole.means[at]));
    }
}

#[test]
fn parts_of_different_render_modes_are_told() {
    let bytes = glb_changed(&make::model(9, 1), Layout::Planar, |d| {
        let mut tagged = d["meshes"][0]["primitives"][0].clone();
        tagged["extras"] = json!({ "SplatRenderMode": "mip" });
        add(&mut d["meshes"][0]["primitives"], tagged);
    });
    let loaded = read(&bytes, "m.glb").unwrap();
    assert!(loaded.mode.antialiased() && loaded.doubt.unwrap().contains("different render modes"));
}

#[test]
fn nodes_move_turn_and_scale() {
    let model = make::model(12, 3);
    let as_is = read(&glb(&model, Layout::Planar), "m.glb").unwrap().gaussians;
    let placed = |node: Value| {
        let bytes = glb_changed(&model, Layout::Planar, |d| {
            for (key, value) in node.as_object().unwrap() {
                d["nodes"][0][key] = value.clone();
            }
        });
        read(&bytes, "m.glb").map(|loaded| loaded.gaussians)
    };
    let moved = placed(json!({ "translation": [1, 2, 3], "scale": [2, 2, 2] })).unwrap();
    for i in 0..12 {
        // glTF's x and y point in the opposite directions.
        let [x, y, z] = as_is.means[i];
        let expected = [2.0 * x - 1.0, 2.0 * y - 2.0, 2.0 * z + 3.0];
        assert!((0..3).all(|k| (moved.means[i][k] - expected[k]).abs() < 1e-6));
        assert!((moved.log_scales[i][0] - as_is.log_scales[i][0] - 2f32.ln()).abs() < 1e-6);
    }
    assert_eq!(moved.sh, as_is.sh);
    // Half a turn about z, as quaternion and as matrix: the axes of the file then equal ours.
    let half =
        [json!({ "rotation": [0, 0, 1, 0] }), json!({ "matrix": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] })];
    for node in half {
        let turned = placed(node).unwrap();
        for i in 0..12 {
            let [x, y, z] = as_is.means[i];
            assert!((0..3).all(|k| (turned.means[i][k] - [-x, -y, z][k]).abs() < 1e-6));
            assert!((turned.sh[1][9 * i] + as_is.sh[1][9 * i]).abs() < 1e-6, "m = -1 changes its sign");
            assert!((turned.sh[3][21 * i + 9] - as_is.sh[3][21 * i + 9]).abs() < 1e-6, "m = 0 does not");
        }
    }
    let mirrored = placed(json!({ "scale": [-1, -1, -1] })).unwrap();
    for i in 0..12 {
        assert_eq!(mirrored.means[i], as_is.means[i].map(|x| -x));
        let near =
            |l: usize, sign: f32| mirrored.sh[l].iter().zip(&as_is.sh[l]).all(|(a, b)| (a - sign * b).abs() < 1e-6);
        assert!(near(0, 1.0) && near(1, -1.0) && near(2, 1.0) && near(3, -1.0), "odd bands change their sign");
    }
    for (node, said) in [
        (json!({ "scale": [1, 2, 1] }), "different factors"),
        (json!({ "scale": [-1, 2, 1] }), "different factors"),
        (json!({ "rotation": [0, 0, 0, 0] }), "not finite"),
        (json!({ "children": [0] }), "several parents"),
        (json!({ "children": [1, 1] }), "several parents"),
        (json!({ "children": [7] }), "does not exist"),
        (json!({ "mesh": 3 }), "does not exist"),
    ] {
        let fault = placed(node.clone()).unwrap_err().to_string();
        assert!(fault.contains(said), "{node}: {fault}");
    }
}

#[test]
fn parts_far_apart_are_told_and_parts_without_a_place_are_refused() {
    let with = |nodes: Value| {
        let bytes = glb_changed(&make::model(9, 1), Layout::Planar, |d| {
            d["scenes"] = json!([{ "nodes": (0..nodes.as_array().unwrap().len()).collect::<Vec<_>>() }]);
            d["nodes"] = nodes;
        });
        read(&bytes, "m.glb")
    };
    for (x, told) in [(50.0, false), (500_000.0, true)] {
        let (near, far) = (json!({ "mesh": 0 }), json!({ "mesh": 0, "translation": [x, 0, 0] }));
        for nodes in [json!([near, far]), json!([far, near])] {
            let doubt = with(nodes).unwrap().doubt;
            assert_eq!(doubt.is_some(), told, "{x}: {doubt:?}");
            let says = ["node 1 lies far", "about 6.0e-2 units"];
            assert!(doubt.is_none_or(|doubt| says.iter().all(|what| doubt.contains(what))));
        }
    }
    let fault = with(json!([{ "name": "empty" }])).unwrap_err().to_string();
    assert!(fault.contains("in a mesh that no node of the scene places"), "{fault}");
}

/// Copies whose places are the attributes of the mesh itself.
#[test]
fn instances_are_copies() {
    let model = make::model(5, 1);
    let as_is = read(&glb(&model, Layout::Planar), "m.glb").unwrap().gaussians;
    let placed = |of: &[(&str, &str)]| {
        let bytes = glb_changed(&model, Layout::Planar, |d| {
            for (key, name) in of {
                let accessor = d["meshes"][0]["primitives"][0]["attributes"][name].clone();
                d["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"][key] = accessor;
            }
            d["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
        });
        read(&bytes, "m.glb")
    };
    let (places, turns) = (("TRANSLATION", "POSITION"), ("ROTATION", "KHR_gaussian_splatting:ROTATION"));
    let loaded = placed(&[places]).unwrap();
    assert_eq!((loaded.gaussians.len(), &loaded.doubt), (25, &None));
    for (k, mean) in loaded.gaussians.means.iter().enumerate() {
        let (copy, i) = (as_is.means[k / 5], as_is.means[k % 5]);
        assert!((0..3).all(|axis| (mean[axis] - copy[axis] - i[axis]).abs() < 1e-5), "{k}: {mean:?}");
    }
    // A copy of the Gaussian that gives its turn is turned by that once more.
    let turned = placed(&[places, turns]).unwrap().gaussians;
    assert!((0..5).all(|k| angle(turned.rotations[6 * k], as_is.rotations[k]) > 1e-3), "{:?}", turned.rotations);
    for (of, said) in [
        (("SCALE", "KHR_gaussian_splatting:SCALE"), "different factors"),
        (("SCALE", "KHR_gaussian_splatting:OPACITY"), "5 of 3 expected"),
    ] {
        let fault = placed(&[of]).unwrap_err().to_string();
        assert!(fault.contains(said), "{of:?}: {fault}");
    }
}

#[test]
fn an_spz_inside_is_read_in_the_axes_of_gltf() {
    for version in [2, 3] {
        let file = make::spz(5, version, 3, true);
        let alone = read(&file, "m.spz").unwrap().gaussians;
        for early in [false, true] {
            let inside = read(&glb_of_spz(&file, 5, early), "m.glb").unwrap();
            assert_eq!(inside.format, Format::Gltf);
            for (a, b) in alone.means.iter().zip(&inside.gaussians.means) {
                // From right-up-back to ours, and from left-up-front: they differ by half a turn about y.
                assert_eq!([-a[0], a[1], -a[2]], *b);
            }
            assert_eq!(alone.log_scales, inside.gaussians.log_scales);
        }
    }
}

#[test]
fn tags_and_what_is_not_known_are_told() {
    let model = make::model(3, 0);
    let with = |change: fn(&mut Value)| {
        let bytes = glb_changed(&model, Layout::Planar, |d| change(&mut d["meshes"][0]["primitives"][0]));
        read(&bytes, "m.glb").unwrap()
    };
    assert_eq!(with(|p| p["extras"] = json!({ "SplatRenderMode": "mip" })).mode, RenderMode::AntiAliased);
    for extras in
        [|p: &mut Value| p["extras"] = json!(7), |p: &mut Value| p["extras"] = json!([["SplatRenderMode", 1]])]
    {
        assert_eq!((with(extras).mode, with(extras).doubt), (RenderMode::Plain, None));
    }
    let doubt = with(|p| p["extras"] = json!({ "SplatRenderMode": { "a": 1 } })).doubt.unwrap();
    assert!(doubt.contains("not understood"), "{doubt}");
    let linear = with(|p| p["extensions"]["KHR_gaussian_splatting"]["colorSpace"] = json!("lin_rec709_display"));
    assert!(linear.doubt.unwrap().contains("lin_rec709_display"));
    for (name, known) in [("KHR_gaussian_splatting", true), ("EXT_other", false)] {
        let bytes = glb_changed(&model, Layout::Planar, |d| d["extensionsRequired"] = json!([name]));
        let loaded = read(&bytes, "m.glb").unwrap();
        assert_eq!((loaded.gaussians.len(), loaded.doubt.is_none()), (3, known), "{name}");
    }
}

#[test]
fn all_faults_of_a_file_are_told() {
    let bytes = glb_changed(&make::model(3, 0), Layout::Planar, |d| {
        let splats = &mut d["meshes"][0]["primitives"][0]["extensions"]["KHR_gaussian_splatting"];
        (splats["colorSpace"], splats["kernel"]) = (json!("lin_rec709_display"), json!("customShape"));
        d["extensionsRequired"] = json!(["FOO_bar"]);
    });
    let doubt = read(&bytes, "m.glb").unwrap().doubt.unwrap();
    assert!(["lin_rec709_display", "customShape", "FOO_bar"].iter().all(|what| doubt.contains(what)), "{doubt}");
}

/// A hidden node hides those below it.
#[test]
fn hidden_nodes_are_left_out() {
    let off = json!({ "KHR_node_visibility": { "visible": false } });
    let with = |nodes: Value| {
        let bytes = glb_changed(&make::model(3, 0), Layout::Planar, |d| {
            d["nodes"] = nodes;
            d["extensionsRequired"] = json!(["KHR_node_visibility"]);
        });
        read(&bytes, "m.glb")
    };
    let one = with(json!([{ "mesh": 0, "children": [1] }, { "mesh": 0, "extensions": off }])).unwrap();
    assert_eq!((one.gaussians.len(), one.doubt), (3, None));
    let none = with(json!([{ "children": [1], "extensions": off }, { "mesh": 0 }])).unwrap_err().to_string();
    assert!(none.contains("no visible primitive"), "{none}");
}

#[test]
fn hostile_documents_are_refused() {
    let model = make::model(6, 1);
    let refused = |what: &str, change: &dyn Fn(&mut Value)| {
        let said = read(&glb_changed(&model, Layout::Planar, change), "m.glb").unwrap_err().to_string();
        assert!(said.contains(what), "{what}: {said}");
    };
    refused("beyond the end", &|d| d["accessors"][0]["count"] = 7.into());
    refused("beyond the end", &|d| d["accessors"][0]["count"] = json!(u64::MAX));
    refused("beyond the end", &|d| d["accessors"][0]["byteOffset"] = json!(u64::MAX));
    refused("apart", &|d| d["bufferViews"][0]["byteStride"] = 0.into());
    refused("of a buffer of", &|d| d["bufferViews"][0]["byteLength"] = json!(u64::MAX));
    refused("does not exist", &|d| d["bufferViews"][0]["buffer"] = 1.into());
    refused("has no data", &|d| drop(d["accessors"][0].as_object_mut().unwrap().remove("bufferView")));
    refused("elements of", &|d| d["accessors"][1]["count"] = 5.into());
    refused("elements of", &|d| d["accessors"][1]["type"] = "VEC3".into());
    refused("does not exist", &|d| d["accessors"][1]["componentType"] = 5130.into());
    refused("no attribute", &|d| {
        drop(
            d["meshes"][0]["primitives"][0]["attributes"]
                .as_object_mut()
                .unwrap()
                .remove("KHR_gaussian_splatting:SCALE"),
        );
    });
    refused("2 of 3 coefficients", &|d| {
        let attributes = d["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap();
        attributes.remove("KHR_gaussian_splatting:SH_DEGREE_1_COEF_1");
    });
    refused("meshopt", &|d| d["bufferViews"][0]["extensions"] = json!({ "EXT_meshopt_compression": {} }));
    refused("version 1.0", &|d| d["asset"]["version"] = "1.0".into());
    refused("more than 65536 entries", &|d| d["nodes"] = vec![json!({}); 65_537].into());
    refused("more than 65536 primitives", &|d| {
        let primitive = d["meshes"][0]["primitives"][0].clone();
        d["meshes"][0]["primitives"] = [vec![json!({}); 20_000], vec![primitive]].concat().into();
        d["nodes"] = vec![json!({ "mesh": 0 }); 20_000].into();
        d["scenes"] = json!([{ "nodes": (0..20_000).collect::<Vec<_>>() }]);
    });
    let plain =
        bundle(&json!({ "asset": { "version": "2.0" }, "meshes": [{ "primitives": [{ "attributes": {} }] }] }), &[]);
    assert!(read(&plain, "m.glb").unwrap_err().to_string().contains("holds meshes or points"));
    let good = glb(&model, Layout::Planar);
    for end in (0..good.len()).step_by(7) {
        assert!(read(&good[..end], "m.glb").is_err(), "cut at {end}");
    }
}
