//! The parts of a glTF file: JSON, binary chunk, and the files and data URIs that its buffers name.

use std::borrow::Cow;
use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::super::bytes::u32_at;
use super::super::fault::{Fault, malformed};
use super::super::stays_within;
use super::AGAIN;
use super::document::{Document, View};
use crate::percent::percent_decoded;
use crate::wording::shown;

const JSON: u32 = u32::from_le_bytes(*b"JSON");
const BINARY: u32 = u32::from_le_bytes(*b"BIN\0");
/// Padding of base64 occurs and is missed in data URIs.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The parts of a file.
pub(super) struct Parts<'a> {
    pub json: &'a [u8],
    /// The binary chunk.
    pub binary: Option<&'a [u8]>,
    /// Bytes after the last chunk.
    pub trailing: u64,
}

/// Finds the parts of a file.
pub(super) fn parts(bytes: &[u8]) -> Result<Parts<'_>, Fault> {
    if !bytes.starts_with(b"glTF") {
        return Ok(Parts { json: bytes, binary: None, trailing: 0 }); // a .gltf is the JSON itself
    }
    let (Some(version), Some(length)) = (u32_at(bytes, 4), u32_at(bytes, 8)) else {
        return Err(malformed("header", format!("the file ends within its 12 bytes; {AGAIN}")));
    };
    if version != 2 {
        return Err(Fault::Unsupported(format!("GLB version {version}; version 2 is read; export it as that")));
    }
    let whole = bytes.get(..length as usize).filter(|whole| whole.len() >= 12).ok_or_else(|| {
        malformed("header, byte 8", format!("{length} bytes claimed, the file has {}; {AGAIN}", bytes.len()))
    })?;
    let (mut json, mut binary, mut at) = (None, None, 12);
    while let (Some(size), Some(kind)) = (u32_at(whole, at), u32_at(whole, at + 4)) {
        let chunk = (at + 8).checked_add(size as usize).and_then(|end| whole.get(at + 8..end));
        let chunk = chunk.ok_or_else(|| {
            malformed(format!("chunk at byte {at}"), format!("{size} bytes claimed, beyond the end; {AGAIN}"))
        })?;
        match kind {
            JSON if json.is_none() => json = Some(chunk),
            BINARY if binary.is_none() => binary = Some(chunk),
            _ => {} // chunks of extensions
        }
        at += 8 + chunk.len();
    }
    let json = json.ok_or_else(|| malformed("header", format!("no JSON chunk; {AGAIN}")))?;
    Ok(Parts { json, binary, trailing: (bytes.len() - whole.len()) as u64 })
}

/// A document with the bytes of its buffers.
pub(super) struct Store<'a> {
    pub document: &'a Document<'a>,
    contents: Vec<Cow<'a, [u8]>>,
    /// Number in `contents` of each buffer: several may name one file.
    which: Vec<Option<usize>>,
    /// Bytes of all buffers.
    pub bytes: usize,
}

/// Loads the buffers.
pub(super) fn load<'a>(
    document: &'a Document<'a>,
    binary: Option<&'a [u8]>,
    folder: Option<&Path>,
) -> Result<Store<'a>, Fault> {
    let mut contents: Vec<Cow<[u8]>> = Vec::new();
    let mut known: HashMap<&str, usize> = HashMap::new();
    let mut which = Vec::new();
    for (i, buffer) in document.buffers.iter().enumerate() {
        let content = match buffer.uri.as_deref() {
            // Only the first buffer may be the chunk; others without a name are filled by extensions.
            None if i == 0 => binary.map(Cow::Borrowed),
            None => None,
            Some(uri) => match known.get(uri) {
                Some(&k) => {
                    which.push(Some(k));
                    continue;
                }
                None => Some(Cow::Owned(fetch(uri, buffer.byte_length, folder, i)?)),
            },
        };
        let Some(content) = content else {
            which.push(None);
            continue;
        };
        if let Some(uri) = buffer.uri.as_deref() {
            known.insert(uri, contents.len());
        }
        which.push(Some(contents.len()));
        contents.push(content);
    }
    let bytes = contents.iter().map(|content| content.len()).sum();
    Ok(Store { document, contents, which, bytes })
}

/// The content of a buffer with a URI: base64, or a file in `folder` that must not leave it.
fn fetch(uri: &str, length: usize, folder: Option<&Path>, i: usize) -> Result<Vec<u8>, Fault> {
    let record = format!("buffer {i}");
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data.split_once(',').filter(|(kind, _)| kind.ends_with(";base64"));
        let (_, encoded) =
            encoded.ok_or_else(|| malformed(&record, format!("a data URI that is not base64; {AGAIN}")))?;
        return BASE64.decode(encoded).map_err(|error| malformed(record, format!("{error} in its base64; {AGAIN}")));
    }
    let shown = shown(uri, 80);
    let name = PathBuf::from(percent_decoded(uri));
    if !stays_within(&name) || uri.contains([':', '\\']) {
        let what =
            format!("its file `{shown}` is not in the folder of the glTF; put it there and name it without a path");
        return Err(malformed(record, what));
    }
    let Some(folder) = folder else {
        return Err(Fault::Unsupported(format!(
            "buffer {i} is the file `{shown}` beside this one; give the glTF by its path"
        )));
    };
    let path = folder.join(name);
    let io = |source| Fault::Io { path: path.clone(), source };
    // Links may leave the folder, too.
    let real = path.canonicalize().map_err(io)?;
    let home = if folder.as_os_str().is_empty() { Path::new(".") } else { folder }.canonicalize().map_err(io)?;
    if !real.starts_with(home) || !real.is_file() {
        return Err(malformed(
            record,
            format!("its file `{shown}` is not a file in the folder of the glTF; put it there"),
        ));
    }
    let mut content = Vec::new();
    File::open(&real).and_then(|file| file.take(length as u64).read_to_end(&mut content)).map_err(io)?;
    Ok(content)
}

impl<'a> Store<'a> {
    /// A buffer view and its bytes.
    pub(super) fn view(&self, index: usize) -> Result<(&'a View, &[u8]), Fault> {
        let record = || format!("bufferView {index}");
        let view = self.document.buffer_views.get(index);
        let view = view.ok_or_else(|| malformed(record(), format!("does not exist; {AGAIN}")))?;
        if view.extensions.meshopt.is_some() {
            return Err(Fault::Unsupported("compressed by meshopt; export it without".into()));
        }
        let content = self.which.get(view.buffer).copied().flatten().map(|k| &self.contents[k]);
        let content = content
            .ok_or_else(|| malformed(record(), format!("its buffer {} does not exist; {AGAIN}", view.buffer)))?;
        let end = view.byte_offset.checked_add(view.byte_length);
        let bytes = end.and_then(|end| content.get(view.byte_offset..end)).ok_or_else(|| {
            let (from, length) = (view.byte_offset, view.byte_length);
            malformed(record(), format!("{length} bytes from {from} on of a buffer of {}; {AGAIN}", content.len()))
        })?;
        Ok((view, bytes))
    }
}
