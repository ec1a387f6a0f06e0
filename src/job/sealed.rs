//! JSON documents that end with a checksum of what comes before it.

use crate::checksum::crc32;
use serde::Serialize;
use serde_json::Value;

/// The fault of a file whose content does not have its checksum.
pub const DAMAGED: &str = "its checksum does not match its content: it is damaged";

/// A document as its text has it: a float32 of 0.1 is 0.1, not 0.10000000149011612.
pub fn value(document: &impl Serialize) -> serde_json::Result<Value> {
    serde_json::from_str(&serde_json::to_string(document)?)
}

/// CRC-32 of a document, whatever its white space.
fn checksum(document: &Value) -> u32 {
    crc32([document.to_string().as_bytes()])
}

/// An object with its checksum.
pub fn seal(mut document: Value) -> Value {
    document["crc32"] = checksum(&document).into();
    document
}

/// A sealed object without its checksum, or what is wrong with it.
pub fn open(bytes: &[u8]) -> Result<Value, String> {
    let mut document: Value = serde_json::from_slice(bytes).map_err(|e| format!("it is damaged: {e}"))?;
    let sealed = document.as_object_mut().and_then(|document| document.remove("crc32"));
    if sealed == Some(checksum(&document).into()) { Ok(document) } else { Err(DAMAGED.to_owned()) }
}
