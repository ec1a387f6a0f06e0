//! glTF files in the forms that other programs write, built from the specification and not by the code under test.

use base64::Engine;
use qirf_vk::gaussians::Gaussians;
use serde_json::{Value, json};

/// Layout of the numbers in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// One buffer view for each attribute.
    Planar,
    /// All attributes of a Gaussian side by side in one view.
    Interleaved,
    /// Zeros, all of which a sparse accessor replaces.
    Sparse,
    /// Rotations, scales and opacities in integers.
    Quantised,
}

/// An attribute: name, numbers per element, values.
struct Column {
    name: String,
    width: usize,
    values: Vec<f32>,
}

/// A model's attributes in glTF's axes: x and y mirrored, and accordingly the coefficients of odd m.
fn columns(model: &Gaussians) -> Vec<Column> {
    let own = |name: &str| format!("KHR_gaussian_splatting:{name}");
    let column = |name: String, width: usize, values: Vec<f32>| Column { name, width, values };
    let mut all = vec![
        column("POSITION".into(), 3, model.means.iter().flat_map(|[x, y, z]| [-x, -y, *z]).collect()),
        column(own("ROTATION"), 4, model.rotations.iter().flat_map(|q| turned(*q)).collect()),
        column(own("SCALE"), 3, model.log_scales.as_flattened().iter().map(|s| s.exp()).collect()),
        column(own("OPACITY"), 1, model.opacity_logits.iter().map(|o| 1.0 / (1.0 + (-o).exp())).collect()),
    ];
    for (l, band) in model.sh.iter().enumerate() {
        for k in 0..=2 * l {
            let sign = if (k + l) % 2 == 1 { -1.0 } else { 1.0 };
            let values = band.chunks_exact(3).skip(k).step_by(2 * l + 1).flatten().map(|c| sign * c).collect();
            all.push(column(own(&format!("SH_DEGREE_{l}_COEF_{k}")), 3, values));
        }
    }
    all
}

/// The unit quaternion x, y, z, w after half a turn about z, in whose axes x and y are mirrored.
fn turned([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let length = [w, x, y, z].iter().map(|c| c * c).sum::<f32>().sqrt();
    [-x, -y, z, w].map(|c| c / length)
}

const KINDS: [&str; 5] = ["", "SCALAR", "", "VEC3", "VEC4"];

/// The bytes of a buffer, and its views and accessors.
#[derive(Default)]
struct Buffer {
    binary: Vec<u8>,
    views: Vec<Value>,
}

impl Buffer {
    /// Adds a view of bytes; returns its number.
    fn view(&mut self, bytes: &[u8]) -> usize {
        let start = self.binary.len();
        self.binary.extend(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": bytes.len() }));
        self.views.len() - 1
    }

    /// Adds all values of a column; returns its accessor.
    fn column(&mut self, c: &Column, integers: bool) -> Value {
        let mut accessor = json!({ "componentType": 5126, "count": c.values.len() / c.width, "type": KINDS[c.width] });
        let floats = || c.values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let (kind, bytes) = match c.width {
            4 if integers => {
                (5122, c.values.iter().flat_map(|v| ((v * 32767.0).round() as i16).to_le_bytes()).collect())
            }
            // Not normalised: scales in whole units.
            3 if integers => (5123, c.values.iter().flat_map(|v| (v.round() as u16).to_le_bytes()).collect()),
            1 if integers => (5121, c.values.iter().map(|v| (v * 255.0).round() as u8).collect()),
            _ => (5126, floats()),
        };
        accessor["componentType"] = kind.into();
        if integers && c.width != 3 {
            accessor["normalized"] = true.into();
        }
        accessor["bufferView"] = self.view(&bytes).into();
        accessor
    }
}

/// The document and its one buffer.
fn parts(model: &Gaussians, layout: Layout) -> (Value, Vec<u8>) {
    let (columns, n) = (columns(model), model.len());
    let (mut buffer, mut accessors, mut attributes) = (Buffer::default(), vec![], json!({}));
    if layout == Layout::Interleaved {
        let row = |i: usize| columns.iter().flat_map(move |c| c.values[i * c.width..][..c.width].iter());
        let bytes: Vec<u8> = (0..n).flat_map(row).flat_map(|v| v.to_le_bytes()).collect();
        buffer.view(&bytes);
        buffer.views[0]["byteStride"] = columns.iter().map(|c| 4 * c.width).sum::<usize>().into();
    }
    let mut within = 0;
    for (k, c) in columns.iter().enumerate() {
        let accessor = if layout == Layout::Interleaved {
            let kind = KINDS[c.width];
            let at = within;
            within += 4 * c.width;
            json!({ "componentType": 5126, "count": n, "type": kind, "bufferView": 0, "byteOffset": at })
        } else {
            buffer.column(c, layout == Layout::Quantised && (1..4).contains(&k))
        };
        accessors.push(accessor);
        if layout == Layout::Sparse && k > 0 {
            let indices: Vec<u8> = (0..n as u16).flat_map(u16::to_le_bytes).collect();
            let values = accessors[k]["bufferView"].take();
            accessors[k].as_object_mut().unwrap().remove("bufferView");
            accessors[k]["sparse"] = json!({
                "count": n,
                "indices": { "bufferView": buffer.view(&indices), "componentType": 5123 },
                "values": { "bufferView": values },
            });
        }
        attributes[&c.name] = k.into();
    }
    let Buffer { binary, views } = buffer;
    let splats = json!({ "kernel": "ellipse", "colorSpace": "srgb_rec709_display" });
    let document = json!({
        "asset": { "version": "2.0", "extras": [1, { "a": null }] },
        "extensionsUsed": ["KHR_gaussian_splatting"],
        "scene": 0, "scenes": [{ "nodes": [0] }],
        "nodes": [{ "children": [1], "name": "root" }, { "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "mode": 0, "extensions": { "KHR_gaussian_splatting": splats } }] }],
        "accessors": accessors, "bufferViews": views, "buffers": [{ "byteLength": binary.len() }],
    });
    (document, binary)
}

/// A GLB of a document and its buffer.
pub fn bundle(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF".to_vec();
    let word = |n: usize| (n as u32).to_le_bytes();
    out.extend([word(2), word(28 + json.len() + binary.len()), word(json.len()), *b"JSON"].concat());
    out.extend(&json);
    out.extend([word(binary.len()), *b"BIN\0"].concat());
    out.extend(binary);
    out
}

/// A GLB whose document `change` may alter.
pub fn glb_changed(model: &Gaussians, layout: Layout, change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let (mut document, binary) = parts(model, layout);
    change(&mut document);
    bundle(&document, &binary)
}

/// A GLB.
pub fn glb(model: &Gaussians, layout: Layout) -> Vec<u8> {
    glb_changed(model, layout, |_| {})
}

/// A `.gltf` whose buffer is a data URI, or the file `uri`.
pub fn gltf(model: &Gaussians, layout: Layout, uri: Option<&str>) -> (Vec<u8>, Vec<u8>) {
    let (mut document, binary) = parts(model, layout);
    let data = || {
        let encoded = base64::engine::general_purpose::STANDARD.encode(&binary);
        format!("data:application/octet-stream;base64,{encoded}")
    };
    document["buffers"][0]["uri"] = uri.map_or_else(data, str::to_owned).into();
    (document.to_string().into_bytes(), binary)
}

/// A GLB that contains an SPZ file, under the draft's name or an earlier one.
pub fn glb_of_spz(spz: &[u8], count: usize, early: bool) -> Vec<u8> {
    let packed = json!({ "bufferView": 0 });
    let extension = if early {
        json!({ "KHR_spz_gaussian_splats_compression": packed })
    } else {
        json!({ "KHR_gaussian_splatting": { "extensions": { "KHR_gaussian_splatting_compression_spz_2": packed } } })
    };
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": extension.as_object().unwrap().keys().collect::<Vec<_>>(),
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "mode": 0, "extensions": extension }] }],
        "accessors": [{ "componentType": 5126, "count": count, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": spz.len() }], "buffers": [{ "byteLength": spz.len() }],
    });
    bundle(&document, spz)
}
