//! The header of a PLY file: encoding, elements, properties.

use std::borrow::Cow;

use super::{Fault, malformed};

/// Encoding of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A scalar type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F16,
    F32,
    F64,
}

/// An expression in which `$T` is the type of the values of a kind.
macro_rules! by_kind {
    ($kind:expr, $T:ident => $what:expr) => {
        by_kind!($kind, $T => $what; I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, F16 half::f16, F32 f32, F64 f64)
    };
    ($kind:expr, $T:ident => $what:expr; $($Kind:ident $type:ty),*) => {
        match $kind {
            $($crate::ply::Kind::$Kind => {
                type $T = $type;
                $what
            })*
        }
    };
}
pub(super) use by_kind;

impl Kind {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "half" | "float16" => Self::F16,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of one value.
    pub(crate) fn size(self) -> usize {
        by_kind!(self, T => size_of::<T>())
    }

    /// True if values have no fraction.
    pub(crate) fn is_integer(self) -> bool {
        !matches!(self, Self::F16 | Self::F32 | Self::F64)
    }
}

/// One property of an element; `list` is the type of a list's count.
#[derive(Clone, Debug)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) list: Option<Kind>,
}

/// One element: `count` rows of `properties`.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

impl Element {
    /// True if every row has the same number of values.
    pub(crate) fn is_fixed(&self) -> bool {
        self.properties.iter().all(|property| property.list.is_none())
    }

    /// Bytes of a binary row, lists left out.
    pub(crate) fn stride(&self) -> usize {
        self.properties.iter().filter(|p| p.list.is_none()).map(|p| p.kind.size()).sum()
    }
}

/// A parsed header.
#[derive(Clone, Debug)]
pub(crate) struct Header {
    pub(crate) encoding: Encoding,
    pub(crate) elements: Vec<Element>,
    /// Each comment's words, one space between them.
    pub(crate) comments: Vec<String>,
    /// Byte offset of the body.
    pub(crate) body: usize,
}

impl Header {
    /// Parses the lines up to and with `end_header`; line ends may be LF or CR LF.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, Fault> {
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut comments = Vec::new();
        let mut at = 0;
        let mut number = 0;
        loop {
            let rest = &bytes[at..];
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(malformed(
                    format!("header, byte {at}"),
                    "the file ends before `end_header`; fetch or export it again",
                ));
            };
            number += 1;
            let record = || format!("header line {number}, byte {at}");
            let Some(line) = text(&rest[..end]) else {
                return Err(malformed(record(), "not text; the header is damaged, fetch or export the file again"));
            };
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let bad = |what: &str| Err(malformed(record(), format!("{what} in `{}`; repair the header", line.trim())));
            match words.as_slice() {
                ["ply"] if number == 1 => {}
                [] | ["obj_info", ..] => {}
                ["comment", words @ ..] => comments.push(words.join(" ")),
                ["format", name, ..] => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        _ => return bad("unknown encoding"),
                    });
                }
                ["element", name, count] => match count.parse() {
                    Ok(count) => elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() }),
                    Err(_) => return bad("no valid count"),
                },
                ["property", rest @ ..] => {
                    let property = match *rest {
                        ["list", count, kind, name] => {
                            let count = Kind::parse(count).filter(|kind| kind.is_integer());
                            Kind::parse(kind).zip(count).map(|(kind, count)| (name, kind, Some(count)))
                        }
                        [kind, name] => Kind::parse(kind).map(|kind| (name, kind, None)),
                        _ => None,
                    };
                    let Some((name, kind, list)) = property else { return bad("unknown type or form of property") };
                    let Some(element) = elements.last_mut() else { return bad("no element before the property") };
                    element.properties.push(Property { name: name.to_owned(), kind, list });
                }
                ["end_header"] => {
                    let Some(encoding) = encoding else { return bad("no `format` line before the end") };
                    return Ok(Self { encoding, elements, comments, body: at + end + 1 });
                }
                _ => return bad("unknown keyword"),
            }
            at += end + 1;
        }
    }
}

/// A line of the header; comments and `obj_info` lines may be in any encoding.
fn text(line: &[u8]) -> Option<Cow<'_, str>> {
    let words = line.trim_ascii_start();
    if words.starts_with(b"comment") || words.starts_with(b"obj_info") {
        return Some(String::from_utf8_lossy(line));
    }
    std::str::from_utf8(line).ok().map(Cow::Borrowed)
}
