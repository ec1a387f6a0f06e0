//! Tags of anti-aliased models: written, preserved, and read from files of other tools.

use std::fs;
use std::io::{Cursor, Read};
use std::path::Path;

use qirf_vk::gaussians::formats::{self, RenderMode, SpzVersion};

use super::readers::read;
use crate::support::files::make::{self, Encoding};

/// A PLY with additional lines in its header.
fn commented(ply: &[u8], comments: &[u8]) -> Vec<u8> {
    let at = ply.windows(8).position(|w| w == b"element ").expect("an element");
    [&ply[..at], comments, &ply[at..]].concat()
}

/// The bytes in which other tools look for words: those of a file, or of the meta.json of a SOG.
fn searched(path: &Path) -> Vec<u8> {
    let file = fs::read(path).unwrap();
    if path.extension().is_none_or(|extension| extension != "sog") {
        return file;
    }
    let mut archive = zip::ZipArchive::new(Cursor::new(file)).unwrap();
    let mut meta = Vec::new();
    archive.by_name("meta.json").unwrap().read_to_end(&mut meta).unwrap();
    meta
}

#[test]
fn written_tags_are_read_back_from_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let model = make::model(300, 1);
    for name in ["a.ply", "a.spz", "a.sog", "a.glb", "a.usda", "a.compressed.ply"] {
        let path = folder.path().join(name);
        let mut written = Vec::new();
        for mode in [RenderMode::AntiAliased, RenderMode::Plain] {
            formats::write(&path, &model, mode).unwrap();
            let loaded = formats::read(&path).unwrap();
            assert_eq!((loaded.mode, &loaded.doubt), (mode, &None), "{name}");
            written.push((fs::read(&path).unwrap(), loaded.gaussians));
        }
        assert!(written[0].0 != written[1].0 && written[0].1 == written[1].1, "{name}: the tag alone differs");
    }
    // Other tools look for these words, which plain files must not contain.
    let (ply, spz, sog) = ("a.ply", "a.spz", "a.sog");
    let contains = |bytes: &[u8], words: &str| bytes.windows(words.len()).any(|w| w == words.as_bytes());
    for (name, words) in [(ply, "\ncomment SplatRenderMode: mip\n"), (sog, "\"model\":\"antialiased\"")] {
        let path = folder.path().join(name);
        assert!(!contains(&searched(&path), words.trim_start_matches("\ncomment ").trim_end()), "{name}");
        formats::write(&path, &model, RenderMode::AntiAliased).unwrap();
        assert!(contains(&searched(&path), words), "{name}");
    }
    let path = folder.path().join(spz);
    formats::write(&path, &model, RenderMode::AntiAliased).unwrap();
    assert_eq!(fs::read(&path).unwrap()[14], 1, "flags of version 4");
    std::fs::write(&path, formats::spz(&model, RenderMode::AntiAliased, SpzVersion::Three, &path).unwrap()).unwrap();
    let mut plain = Vec::new();
    let packed = fs::read(&path).unwrap();
    flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut plain).unwrap();
    assert_eq!(plain[14], 1, "flags of version 3");
}

#[test]
fn comments_count_in_every_kind_of_ply() {
    let model = make::model(5, 1);
    let mut files = [Encoding::Little, Encoding::Big, Encoding::Ascii].map(|e| make::ply(&model, e, false)).to_vec();
    files.push(make::compressed_ply(300, 0x1234_5678, true));
    for file in &files {
        let plain = read(file, "m.ply").unwrap();
        assert_eq!((plain.mode, &plain.doubt), (RenderMode::Plain, &None));
        for tag in ["comment SplatRenderMode: mip\n", "comment antialiased 1\r\n"] {
            let tagged = read(&commented(file, tag.as_bytes()), "m.ply").unwrap();
            assert_eq!((tagged.mode, tagged.doubt), (RenderMode::AntiAliased, None), "{tag}");
            assert!(tagged.gaussians == plain.gaussians);
        }
        // A damaged tag loses the tag and not the model; comments in other encodings do no harm.
        let damaged = read(&commented(file, b"comment SplatRenderMode: m\xffp\n"), "m.ply").unwrap();
        assert_eq!(damaged.mode, RenderMode::Plain);
        assert!(damaged.doubt.unwrap().contains("not understood") && damaged.gaussians == plain.gaussians);
        for line in [b"comment K\xf6ln\n".as_slice(), b"obj_info K\xf6ln\n", b" \tcomment K\xf6ln\n"] {
            let latin = read(&commented(file, line), "m.ply").unwrap();
            assert_eq!((latin.mode, latin.doubt), (RenderMode::Plain, None));
        }
    }
}

#[test]
fn the_bit_of_spz_counts_in_every_version() {
    for version in 1..=4 {
        let mut file = make::spz(9, version, 1, false);
        assert_eq!(read(&file, "m.spz").unwrap().mode, RenderMode::Plain);
        file[14] |= 1;
        let tagged = read(&file, "m.spz").unwrap();
        assert_eq!((tagged.mode, tagged.doubt), (RenderMode::AntiAliased, None), "version {version}");
        // Unknown bits are ignored.
        file[14] = 0x80;
        assert_eq!(read(&file, "m.spz").unwrap().mode, RenderMode::Plain);
    }
}

#[test]
fn a_sog_with_a_damaged_tag_is_read_and_doubted() {
    for (key, value, antialiased, doubted) in [
        ("model", serde_json::json!("antialiased"), true, false),
        ("antialias", serde_json::json!(true), true, false),
        ("model", serde_json::json!("2dgs"), false, true),
        ("model", serde_json::json!(["antialiased"]), false, true),
        ("antialias", serde_json::json!(1), false, true),
    ] {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in make::sog_files(50, 2) {
            fs::write(folder.path().join(name), content).unwrap();
        }
        let meta = folder.path().join("meta.json");
        let mut json: serde_json::Value = serde_json::from_slice(&fs::read(&meta).unwrap()).unwrap();
        json[key] = value.clone();
        fs::write(&meta, json.to_string()).unwrap();
        let loaded = formats::read(folder.path()).unwrap();
        assert_eq!((loaded.mode.antialiased(), loaded.doubt.is_some()), (antialiased, doubted), "{key}: {value}");
        assert_eq!(loaded.gaussians.len(), 50);
    }
}
