//! PLY: the standard 3DGS layout and PlayCanvas' compressed layout, read and written.

mod compressed;
mod pack;
mod standard;
mod write;

use super::fault::{Fault, malformed};
use super::render_mode::Tag;
use super::{Format, Parsed};
use crate::ply::{Header, tables};
pub(super) use pack::write as write_compressed;
pub(super) use write::write;

/// Reads a whole PLY file of either layout; elements that neither knows are skipped.
pub(super) fn read(bytes: &[u8]) -> Result<Parsed, Fault> {
    let header = Header::parse(bytes)?;
    let (tables, trailing_bytes) = tables(bytes, &header, &["chunk", "vertex", "sh"])?;
    let table = |name: &str| tables.iter().find(|table| table.name() == name);
    let Some(vertex) = table("vertex") else {
        return Err(malformed("header", "no `element vertex`; this PLY holds no Gaussians, give another file"));
    };
    let mut tag = Tag::default();
    for comment in &header.comments {
        tag.comment(&comment.split(' ').collect::<Vec<_>>());
    }
    let (gaussians, format) = match table("chunk") {
        Some(chunk) if vertex.find("packed_position").is_some() => {
            (compressed::gaussians(chunk, vertex, table("sh"))?, Format::CompressedPly)
        }
        _ => (standard::gaussians(vertex, &mut tag.origin)?, Format::Ply),
    };
    if format == Format::Ply && standard::is_flat(vertex) {
        tag.thickened();
    }
    if format == Format::Ply && vertex.find(standard::FILTER).is_some() {
        tag.smoothed();
    }
    Ok(Parsed { gaussians, format, tag, trailing_bytes })
}
