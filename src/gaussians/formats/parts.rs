//! Sizes of the parts of a file.

use super::{sog, spz};

/// Bytes of each attribute in a whole file, under its name, and of what is left under "rest"; nothing for formats that keep the
/// attributes of a Gaussian together.
pub fn parts(bytes: &[u8]) -> Vec<(&'static str, u64)> {
    let mut parts = match bytes {
        [b'P', b'K', 3, 4, ..] => sog::parts(bytes),
        [b'N', b'G', b'S', b'P', ..] => spz::parts(bytes),
        _ => Vec::new(),
    };
    if !parts.is_empty() {
        let known: u64 = parts.iter().map(|(_, bytes)| bytes).sum();
        parts.push(("rest", (bytes.len() as u64).saturating_sub(known)));
    }
    parts
}
