//! PLY: the standard 3DGS layout and PlayCanvas' compressed layout, read and written.

mod compressed;
mod pack;
mod standard;
mod write;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use super::fault::{Fault, malformed};
use super::render_mode::Tag;
use super::{Format, Gaussians, Parsed};
use crate::ply::{Element, Encoding, Header, Kind, Table, tables};
pub(super) use pack::write as write_compressed;
pub(super) use write::write;

/// Greatest magnitude of SH coefficients above band 0 in the compressed layout.
pub(super) const SH_LIMIT: f32 = compressed::SH_RANGE / 2.0;

/// Reads a whole PLY file of either layout; elements that neither knows are skipped.
pub(super) fn read(bytes: &[u8]) -> Result<Parsed, Fault> {
    let header = Header::parse(bytes)?;
    let (tables, trailing_bytes) = tables(bytes, &header, &["chunk", "vertex", "sh"])?;
    let table = |name: &str| tables.iter().find(|table| table.name() == name);
    let Some(vertex) = table("vertex") else {
        return Err(malformed("header", "no `element vertex`; this PLY holds no Gaussians: give another file"));
    };
    let mut tag = tag(&header);
    let (gaussians, format) = match table("chunk") {
        Some(chunk) if vertex.find("packed_position").is_some() => {
            (compressed::gaussians(chunk, vertex, table("sh"))?, Format::CompressedPly)
        }
        _ => (standard::gaussians(vertex, &mut tag.origin)?, Format::Ply),
    };
    if format == Format::Ply {
        changed(&mut tag, vertex);
    }
    Ok(Parsed { gaussians, format, tag, trailing_bytes })
}

/// Longest header of a file that is read in blocks, and about the bytes of a block.
const HEADER: u64 = 1 << 16;
const BLOCK: usize = 1 << 22;

/// Reads a file of `length` bytes in the standard layout block by block, so that it is never in memory beside its model. None for
/// any other file, also a damaged one: [`read`] takes it whole, and says what is wrong.
pub(super) fn read_file(path: &Path, length: u64) -> io::Result<Option<Parsed>> {
    let mut file = File::open(path)?;
    let mut start = Vec::new();
    file.by_ref().take(HEADER).read_to_end(&mut start)?;
    if !start.starts_with(b"ply") {
        return Ok(None);
    }
    let Ok(header) = Header::parse(&start) else { return Ok(None) };
    let Some(n) = plain_rows(&header, length) else { return Ok(None) };
    file.seek(SeekFrom::Start(header.body as u64))?;
    let vertex = &header.elements[0];
    let (stride, mut tag) = (vertex.stride(), tag(&header));
    let mut model: Option<Gaussians> = None;
    let mut bytes = Vec::new();
    let mut left = n;
    while left > 0 {
        let count = left.min((BLOCK / stride).max(1));
        bytes.resize(count * stride, 0);
        file.read_exact(&mut bytes)?;
        let element = Element { count: count as u64, ..vertex.clone() };
        let part = Header { elements: vec![element], body: 0, comments: Vec::new(), ..header };
        let Ok((tables, _)) = tables(&bytes, &part, &["vertex"]) else { return Ok(None) };
        let Ok(gaussians) = standard::gaussians(&tables[0], &mut tag.origin) else { return Ok(None) };
        let all = model.get_or_insert_with(|| {
            changed(&mut tag, &tables[0]);
            let mut all = Gaussians::zeroed(0, gaussians.degree());
            all.reserve(n);
            all
        });
        all.append(&gaussians);
        left -= count;
    }
    Ok(model.map(|gaussians| Parsed { gaussians, format: Format::Ply, tag, trailing_bytes: 0 }))
}

/// The number of rows of a binary file with one element, each of whose rows is read alone: colours in red, green and blue, and doubles, are
/// read by all rows together.
fn plain_rows(header: &Header, length: u64) -> Option<usize> {
    let [vertex] = &header.elements[..] else { return None };
    let alone = vertex.name == "vertex" && vertex.is_fixed() && header.encoding != Encoding::Ascii;
    let known = vertex.properties.iter().any(|p| p.name == "f_dc_0");
    let doubles = vertex.properties.iter().any(|p| p.kind == Kind::F64);
    let bytes = vertex.count.checked_mul(vertex.stride() as u64)?.checked_add(header.body as u64)?;
    (alone && known && !doubles && bytes == length).then(|| usize::try_from(vertex.count).ok()).flatten()
}

/// The tag that the comments of a header give.
fn tag(header: &Header) -> Tag {
    let mut tag = Tag::default();
    for comment in &header.comments {
        tag.comment(&comment.split(' ').collect::<Vec<_>>());
    }
    tag
}

/// Notes in the tag that flat Gaussians were thickened, that a 3D filter was applied, and that opacities are whole numbers.
fn changed(tag: &mut Tag, vertex: &Table) {
    if standard::is_flat(vertex) {
        tag.thickened();
    }
    if vertex.find(standard::FILTER).is_some() {
        tag.smoothed();
    }
    if vertex.find("opacity").is_some_and(|slot| slot.kind().is_integer()) {
        tag.add_doubt(
            "its opacities are whole numbers, which are taken as logits; if they mean 0 to 255, export them as logits in floats",
        );
    }
}
