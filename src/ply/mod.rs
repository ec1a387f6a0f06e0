//! PLY files: headers, and elements' rows as tables. Models and point clouds are read through it.

mod header;
mod table;

pub(crate) use header::{Element, Encoding, Header, Kind};
pub(crate) use table::{Slot, Table, tables};

/// A contradiction in a file.
#[derive(Debug)]
pub(crate) struct Fault {
    /// The line, element or row, with its byte offset if there is one.
    pub record: String,
    /// The fault, then the remedy.
    pub what: String,
}

/// A contradiction in `record`.
pub(crate) fn malformed(record: impl Into<String>, what: impl Into<String>) -> Fault {
    Fault { record: record.into(), what: what.into() }
}
