//! glTF 2.0 with `KHR_gaussian_splatting`: `.glb`, or `.gltf` with the files that it names.
//!
//! A splat is a point of a primitive of mode 0: `POSITION`, and, with the extension's name as prefix, `ROTATION` (x, y,
//! z, w, unit), `SCALE` (linear), `OPACITY` (0 to 1) and `SH_DEGREE_l_COEF_k` (red, green, blue; k = m + l; the constants
//! and signs of 3DGS). Axes are left-up-front, ours turned by 180 degrees about z. The extension knows neither dilation nor
//! anti-aliasing: the tag lies in the primitive's `extras`. The local origin of means is the node's translation. Facts: github.com/KhronosGroup/glTF at 77b44be7.

mod accessor;
mod container;
mod document;
mod place;
mod splats;
mod write;

use std::path::Path;

use super::axes::{LEFT_UP_FRONT, RIGHT_DOWN_FRONT, convert, convert_place};
use super::fault::{Fault, malformed};
use super::limit::fits;
use super::{Format, Gaussians, Parsed, Tag, turn};
use crate::wording::shown;
pub(super) use write::write;

/// Name of the extension, and prefix of its attributes.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Key of the tag in a primitive's `extras`; values are those of PLY's comment.
const TAG: &str = "SplatRenderMode";
/// Extensions that a file may require for its Gaussians.
const KNOWN: [&str; 7] = [
    EXTENSION,
    "KHR_gaussian_splatting_compression_spz",
    "KHR_gaussian_splatting_compression_spz_2",
    "KHR_spz_gaussian_splats_compression",
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
    "KHR_node_visibility",
];
/// Most primitives that nodes may place: a short file may place a long list many times.
const MOST_PLACED: usize = 1 << 16;
const AGAIN: &str = "fetch or export the file again";

/// Reads a whole `.glb` or `.gltf`; `folder` is where the files lie that it names, if they may be read.
pub(super) fn read(bytes: &[u8], folder: Option<&Path>) -> Result<Parsed, Fault> {
    let parts = container::parts(bytes)?;
    let document = document::parse(parts.json)?;
    let store = container::load(&document, parts.binary, folder)?;
    let mut model = Gaussians::zeroed(0, 0);
    let mut tags = Vec::new();
    let (mut found, mut visits, mut origin) = (false, 0, None);
    for placed in place::meshes(&document)? {
        let primitives = &document.meshes[placed.mesh].primitives;
        let copies = if primitives.iter().any(splats::holds) { placed.copies(&store)? } else { vec![placed.map] };
        visits = primitives.len().max(1).saturating_mul(copies.len()).saturating_add(visits);
        if visits > MOST_PLACED {
            return Err(malformed(
                format!("mesh {}", placed.mesh),
                format!("more than {MOST_PLACED} primitives placed; {AGAIN}"),
            ));
        }
        for (k, primitive) in primitives.iter().enumerate() {
            let record = format!("mesh {}, primitive {k}", placed.mesh);
            let Some((part, mut tag)) = splats::read(&store, primitive, &record)? else { continue };
            for (mut part, map) in std::iter::repeat_n(part, copies.len()).zip(&copies) {
                // A small file may place a mesh many times.
                if !fits(model.len() + part.len(), model.degree().max(part.degree()), store.bytes) {
                    let what = format!("placed too often for a file of {} bytes; {AGAIN}", store.bytes);
                    return Err(malformed(record, what));
                }
                if let Some(doubt) = turn::place(&mut part, map, &mut origin, &format!("node {}", placed.node))? {
                    tag.add_doubt(doubt);
                }
                if found {
                    model.append(&part);
                } else {
                    model = part;
                }
                found = true;
            }
            tags.push(tag);
        }
    }
    let mut tag = Tag::of_parts(tags);
    let unknown = document.required.iter().find(|name| !KNOWN.contains(&name.as_ref()));
    tag.add_first(unknown.map(|other| {
        format!("the file requires {}, which is not known; the Gaussians are read without it", shown(other, 60))
    }));
    if !found && document.meshes.iter().flat_map(|mesh| mesh.primitives.iter()).any(splats::holds) {
        let why = if document.nodes.iter().any(document::Node::is_hidden) {
            format!("no visible primitive with {EXTENSION}: KHR_node_visibility hides its node; show it")
        } else {
            "its Gaussians are in a mesh that no node of the scene places; add such a node".to_owned()
        };
        return Err(Fault::Unsupported(format!("{why} in the program that made the file")));
    }
    if !found && !document.used.iter().any(|name| name == EXTENSION) {
        return Err(Fault::Unsupported(format!(
            "no primitive with {EXTENSION}: this glTF holds meshes or points, no Gaussians; give another file"
        )));
    }
    convert(&mut model, LEFT_UP_FRONT, RIGHT_DOWN_FRONT);
    tag.origin = convert_place(origin.unwrap_or_default(), LEFT_UP_FRONT, RIGHT_DOWN_FRONT).to_array();
    Ok(Parsed { gaussians: model, format: Format::Gltf, tag, trailing_bytes: parts.trailing })
}
