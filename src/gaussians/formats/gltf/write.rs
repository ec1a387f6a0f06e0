//! Writing GLB, and glTF with its buffer in base64: one primitive, one buffer view for each attribute, floats throughout.
//!
//! `COLOR_0`, in bytes, is for programs that show points where they do not know splats; its colours are linear.

use std::io::{self, Write};

use base64::engine::general_purpose::STANDARD;
use base64::write::EncoderWriter;
use serde_json::{Map, Value, json};

use super::super::axes::{LEFT_UP_FRONT, RIGHT_DOWN_FRONT, convert, convert_place};
use super::super::bytes::SH_C0;
use super::super::fault::Fault;
use super::super::{Gaussians, RenderMode, linear};
use super::{EXTENSION, TAG};

/// Bytes of the file's header, and of a chunk's.
const HEADERS: usize = 12 + 8 + 8;
/// URI of a text's buffer, up to its content.
const URI: &str = "data:application/octet-stream;base64,";
const FLOAT: u32 = 5126;
const BYTE: u32 = 5121;
/// Gaussians between two writes.
const BLOCK: usize = 4096;

/// An attribute of the primitive.
struct Attribute {
    name: String,
    /// Type in the file and bytes of one element.
    kind: &'static str,
    bytes: usize,
    /// Appends the element of a Gaussian.
    element: fn(&Gaussians, usize, [usize; 2], &mut Vec<u8>),
    /// Degree and coefficient of spherical harmonics.
    coefficient: [usize; 2],
}

/// Writes a whole file, as JSON if `text`, or says why glTF cannot hold the model.
pub(in super::super) fn write(
    model: &Gaussians,
    (mode, origin): (RenderMode, [f64; 3]),
    text: bool,
) -> Result<impl FnOnce(&mut dyn Write) -> io::Result<()>, Fault> {
    let mut model = model.clone();
    convert(&mut model, RIGHT_DOWN_FRONT, LEFT_UP_FRONT);
    let attributes = if model.is_empty() { Vec::new() } else { attributes(model.degree()) };
    let size = attributes.iter().map(|a| a.bytes).sum::<usize>() * model.len();
    let place = convert_place(origin.into(), RIGHT_DOWN_FRONT, LEFT_UP_FRONT).to_array();
    let mut document = document(&model, (mode, place), &attributes);
    if text && !model.is_empty() {
        document["buffers"][0]["uri"] = URI.into();
    }
    let mut json = document.to_string();
    json.extend(std::iter::repeat_n(' ', json.len().wrapping_neg() % 4));
    let length = HEADERS + json.len() + size;
    if !text && u32::try_from(length).is_err() {
        return Err(Fault::Unsupported("larger than the 4 GiB of a GLB; write .ply".into()));
    }
    Ok(move |out: &mut dyn Write| {
        if text {
            let Some((before, after)) = json.split_once(URI) else { return out.write_all(json.as_bytes()) };
            out.write_all(before.as_bytes())?;
            out.write_all(URI.as_bytes())?;
            let mut encoder = EncoderWriter::new(&mut *out, &STANDARD);
            binary(&model, &attributes, &mut encoder)?;
            return encoder.finish()?.write_all(after.as_bytes());
        }
        let word = |value: usize| (value as u32).to_le_bytes();
        out.write_all(&[*b"glTF", word(2), word(length), word(json.len()), *b"JSON"].concat())?;
        out.write_all(json.as_bytes())?;
        out.write_all(&[word(size), *b"BIN\0"].concat())?;
        binary(&model, &attributes, out)
    })
}

/// Writes the content of the buffer.
fn binary(model: &Gaussians, attributes: &[Attribute], out: &mut dyn Write) -> io::Result<()> {
    let mut block = Vec::new();
    for attribute in attributes {
        for start in (0..model.len()).step_by(BLOCK) {
            block.clear();
            for i in start..model.len().min(start + BLOCK) {
                (attribute.element)(model, i, attribute.coefficient, &mut block);
            }
            out.write_all(&block)?;
        }
    }
    Ok(())
}

fn push(out: &mut Vec<u8>, values: &[f32]) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

fn rotation(model: &Gaussians, i: usize, _: [usize; 2], out: &mut Vec<u8>) {
    let [w, x, y, z] = linear::unit(model.rotations[i]);
    push(out, &[x, y, z, w]);
}

fn scale(model: &Gaussians, i: usize, _: [usize; 2], out: &mut Vec<u8>) {
    push(out, &model.log_scales[i].map(linear::scale));
}

fn coefficient(model: &Gaussians, i: usize, [l, k]: [usize; 2], out: &mut Vec<u8>) {
    let at = i * Gaussians::band_width(l) + 3 * k;
    push(out, &model.sh[l][at..at + 3]);
}

/// Linear colour without bands above 0, and opacity.
fn fallback(model: &Gaussians, i: usize, _: [usize; 2], out: &mut Vec<u8>) {
    let decoded = |shown: f32| if shown <= 0.04045 { shown / 12.92 } else { ((shown + 0.055) / 1.055).powf(2.4) };
    let byte = |value: f32| (value * 255.0).round() as u8;
    let colour = &model.sh[0][3 * i..3 * i + 3];
    out.extend(colour.iter().map(|c| byte(decoded((c * SH_C0 + 0.5).clamp(0.0, 1.0)))));
    out.push(byte(linear::opacity(model.opacity_logits[i])));
}

fn attributes(degree: usize) -> Vec<Attribute> {
    let of =
        |name: &str, kind, bytes, element| Attribute { name: name.into(), kind, bytes, element, coefficient: [0, 0] };
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let mut all = vec![
        of("POSITION", "VEC3", 12, |model, i, _, out| push(out, &model.means[i])),
        of(&own("ROTATION"), "VEC4", 16, rotation),
        of(&own("SCALE"), "VEC3", 12, scale),
        of(&own("OPACITY"), "SCALAR", 4, |model, i, _, out| push(out, &[linear::opacity(model.opacity_logits[i])])),
        of("COLOR_0", "VEC4", 4, fallback),
    ];
    for l in 0..=degree {
        for k in 0..=2 * l {
            let name = own(&format!("SH_DEGREE_{l}_COEF_{k}"));
            all.push(Attribute { coefficient: [l, k], ..of(&name, "VEC3", 12, coefficient) });
        }
    }
    all
}

/// The JSON chunk; `place` is the local origin of the means.
fn document(model: &Gaussians, (mode, place): (RenderMode, [f64; 3]), attributes: &[Attribute]) -> Value {
    let n = model.len();
    let mut document = json!({
        "asset": { "version": "2.0", "generator": concat!("qirf-vk ", env!("CARGO_PKG_VERSION")) },
        "extensionsUsed": [EXTENSION],
        "scene": 0,
    });
    if attributes.is_empty() {
        document["scenes"] = json!([{}]);
        return document;
    }
    let (mut views, mut accessors, mut names, mut at) = (Vec::new(), Vec::new(), Map::new(), 0);
    for (k, attribute) in attributes.iter().enumerate() {
        let length = attribute.bytes * n;
        views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": length, "target": 34962 }));
        at += length;
        let is_byte = attribute.name == "COLOR_0";
        let component = if is_byte { BYTE } else { FLOAT };
        let mut accessor = json!({ "bufferView": k, "componentType": component, "count": n, "type": attribute.kind });
        if is_byte {
            accessor["normalized"] = true.into();
        }
        if k == 0 {
            let (low, high) = model.bounds().unwrap_or_default();
            accessor["min"] = json!(low);
            accessor["max"] = json!(high);
        }
        accessors.push(accessor);
        names.insert(attribute.name.clone(), k.into());
    }
    let splats = json!({
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    let mut primitive = json!({ "attributes": names, "mode": 0, "extensions": { EXTENSION: splats } });
    if mode.antialiased() {
        primitive["extras"] = json!({ TAG: "mip" });
    }
    let mut node = json!({ "mesh": 0 });
    if place != [0.0; 3] {
        node["translation"] = json!(place);
    }
    for (key, value) in [
        ("scenes", json!([{ "nodes": [0] }])),
        ("nodes", json!([node])),
        ("meshes", json!([{ "primitives": [primitive] }])),
        ("accessors", json!(accessors)),
        ("bufferViews", json!(views)),
        ("buffers", json!([{ "byteLength": at }])),
    ] {
        document[key] = value;
    }
    document
}
