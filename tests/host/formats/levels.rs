//! Streamed SOG: levels of detail in a tree.

use qirf_vk::gaussians::formats::{self, RenderMode};
use serde_json::Value;
use std::path::Path;

use super::writers::matched;
use crate::support::files::make;

/// A wide model, which is divided into several leaves.
fn wide() -> qirf_vk::gaussians::Gaussians {
    let mut model = make::model(20_000, 1);
    model.means.iter_mut().for_each(|m| m[0] *= 8.0);
    model
}

fn meta(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("lod-meta.json")).unwrap()).unwrap()
}

/// Adds up the counts of a level in all leaves; checks that every node's box contains its children's.
fn counted(node: &Value, level: &str) -> u64 {
    match node["children"].as_array() {
        Some(children) => {
            for child in children {
                for k in 0..3 {
                    let at = |n: &Value, side: &str| n["bound"][side][k].as_f64().unwrap();
                    assert!(at(node, "min") <= at(child, "min") && at(node, "max") >= at(child, "max"));
                }
            }
            children.iter().map(|child| counted(child, level)).sum()
        }
        None => node["lods"][level]["count"].as_u64().unwrap_or(0),
    }
}

const FAR: [f64; 3] = [500_000.0, 4e6, 0.0];

#[test]
fn the_finest_level_is_read_back_and_every_leaf_knows_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    let model = wide();
    let coarse = model.select(&(0..model.len()).step_by(4).collect::<Vec<_>>());
    formats::write_levels(&path, &[model.clone(), coarse], (RenderMode::AntiAliased, FAR)).unwrap();
    for place in [path.as_path(), folder.path()] {
        let back = formats::read(place).unwrap();
        assert_eq!((back.gaussians.len(), back.mode), (model.len(), RenderMode::AntiAliased));
        assert_eq!(back.origin, FAR);
        let some = model.select(&(0..model.len()).step_by(997).collect::<Vec<_>>());
        for (i, j) in matched(&some, &back.gaussians) {
            let size = |m: &qirf_vk::gaussians::Gaussians, i: usize| m.log_scales[i].iter().sum::<f32>();
            assert!((size(&some, i) - size(&back.gaussians, j)).abs() < 0.2, "{i}");
        }
    }
    let meta = meta(folder.path());
    assert_eq!(meta["counts"], serde_json::json!([20_000, 5_000]));
    assert!(meta["tree"]["children"].is_array(), "a model of 48 units is divided");
    assert_eq!((counted(&meta["tree"], "0"), counted(&meta["tree"], "1")), (20_000, 5_000));
}

#[test]
fn levels_of_an_earlier_model_are_removed_and_a_model_without_gaussians_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    let model = make::model(60, 0);
    let write =
        |levels: &[qirf_vk::gaussians::Gaussians]| formats::write_levels(&path, levels, (RenderMode::Plain, [0.0; 3]));
    write(&[model.clone(), model.select(&[0, 1, 2])]).unwrap();
    std::fs::create_dir(folder.path().join("notes")).unwrap();
    assert!(folder.path().join("1_0/meta.json").exists());
    write(&[model]).unwrap();
    let there = ["0_0", "1_0", "notes"].map(|name| folder.path().join(name).exists());
    assert_eq!(there, [true, false, true]);
    let refused = write(&[make::model(0, 0)]).unwrap_err().to_string();
    assert!(refused.contains("need a Gaussian"), "{refused}");
    assert_eq!(formats::read(&path).unwrap().gaussians.len(), 60, "the earlier model is still there");
}

#[test]
fn every_level_is_read_however_the_text_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    let model = make::model(60, 1);
    formats::write_levels(&path, &[model.clone(), model.select(&[0, 1, 2])], (RenderMode::Plain, [0.0; 3])).unwrap();
    assert_eq!([0, 1].map(|level| formats::read_level(&path, level).unwrap().len()), [60, 3]);
    let none = formats::read_level(&path, 2).unwrap_err().to_string();
    assert!(none.contains("no Gaussians of level 2"), "{none}");
    let text = std::fs::read_to_string(&path).unwrap();
    let marked = format!("\u{feff}{text}");
    let wide: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let dotted = text.replace("\"0_0/", "\"./0_0/");
    assert_ne!(dotted, text);
    for written in [marked.into_bytes(), wide, dotted.into_bytes()] {
        std::fs::write(&path, &written).unwrap();
        assert_eq!(formats::read(&path).unwrap().gaussians.len(), 60, "{:?}", written.get(..8));
    }
}

/// Viewers draw it at every distance.
#[test]
fn an_environment_is_part_of_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    let write = |path: &Path, model: &qirf_vk::gaussians::Gaussians, mode: RenderMode| {
        formats::write_levels(path, std::slice::from_ref(model), (mode, [0.0; 3])).unwrap();
    };
    write(&path, &make::model(60, 1), RenderMode::Plain);
    let mut around = make::model(9, 0);
    around.means.iter_mut().for_each(|m| m[0] += 50.0);
    write(&folder.path().join("env/lod-meta.json"), &around, RenderMode::AntiAliased);
    let mut levels = meta(folder.path());
    levels["environment"] = "env/0_0/meta.json".into();
    std::fs::write(&path, levels.to_string()).unwrap();
    let read = formats::read(&path).unwrap();
    assert_eq!((read.gaussians.len(), read.gaussians.degree(), read.mode), (69, 1, RenderMode::AntiAliased));
    assert!(read.gaussians.means[60..].iter().all(|m| m[0] > 40.0) && read.gaussians.validate().is_ok());
    assert!(read.doubt.unwrap().contains("different render modes"));
    for bad in ["../env/meta.json", "absent/meta.json", "0_0/meta.json", "env/0_0"] {
        levels["environment"] = bad.into();
        std::fs::write(&path, levels.to_string()).unwrap();
        assert!(formats::read(&path).is_err(), "{bad}");
    }
    // An empty name names nothing.
    levels["environment"] = "".into();
    std::fs::write(&path, levels.to_string()).unwrap();
    assert_eq!(formats::read(&path).unwrap().gaussians.len(), 60);
}

#[test]
fn hostile_levels_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lod-meta.json");
    formats::write_levels(&path, &[make::model(50, 0)], (RenderMode::Plain, [0.0; 3])).unwrap();
    let good = meta(folder.path()).to_string();
    for (from, to) in [
        ("0_0/meta.json", "../0_0/meta.json"),
        ("0_0/meta.json", "/0_0/meta.json"),
        ("0_0/meta.json", "9_9/meta.json"),
        ("\"count\":50}", "\"count\":51}"),
        ("\"offset\":0", "\"offset\":18446744073709551615"),
        ("\"file\":0", "\"file\":7"),
        ("\"tree\"", "\"bush\""),
    ] {
        let bad = good.replace(from, to);
        assert_ne!(bad, good, "{from}");
        std::fs::write(&path, bad).unwrap();
        assert!(formats::read(&path).is_err(), "{to}");
    }
    // A folder's Gaussians are loaded once: a list of it in every leaf would fill any memory.
    for again in ["0_0//meta.json", "./0_0/meta.json"] {
        let mut twice: Value = serde_json::from_str(&good).unwrap();
        twice["filenames"] = serde_json::json!(["0_0/meta.json", again]);
        let leaf = twice["tree"].clone();
        let mut second = leaf.clone();
        second["lods"]["0"]["file"] = 1.into();
        twice["tree"] = serde_json::json!({ "bound": leaf["bound"], "children": [leaf, second] });
        std::fs::write(&path, twice.to_string()).unwrap();
        assert!(formats::read(&path).unwrap_err().to_string().contains("named twice"), "{again}");
    }
    let deep = format!("{}{}", "{\"children\":[".repeat(5000), "]}".repeat(5000));
    std::fs::write(&path, format!("{{\"filenames\":[],\"tree\":{deep}}}")).unwrap();
    assert!(formats::read(folder.path()).is_err());
}
