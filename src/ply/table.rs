//! An element's rows as a table of fixed stride, for any encoding of the file.

use std::borrow::Cow;

use super::header::{Element, Encoding, Header, Kind, Property, by_kind};
use super::{Fault, malformed};

/// Position of a property in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slot {
    offset: usize,
    kind: Kind,
    big: bool,
}

impl Slot {
    /// A number of this type at the beginning of little-endian bytes.
    pub(crate) fn first(kind: Kind) -> Self {
        Self { offset: 0, kind, big: false }
    }

    /// The value.
    #[inline]
    #[allow(clippy::useless_conversion)] // of doubles alone
    pub(crate) fn value(self, row: &[u8]) -> f64 {
        by_kind!(self.kind, T => f64::from(T::from_le_bytes(self.bytes(row))))
    }

    /// The value as f32 (doubles and 32-bit integers are rounded).
    #[inline]
    pub(crate) fn float(self, row: &[u8]) -> f32 {
        if self.kind == Kind::F32 { f32::from_le_bytes(self.bytes(row)) } else { self.value(row) as f32 }
    }

    /// Its type.
    pub(crate) fn kind(self) -> Kind {
        self.kind
    }

    /// The number that stands for white: by the type of a whole number; floats are shares of it, or count to 255 if `brightest` is
    /// more than a share.
    pub(crate) fn white(self, brightest: f32) -> f32 {
        match self.kind {
            Kind::U16 | Kind::I16 => 65535.0,
            kind if kind.is_integer() || brightest > 2.0 => 255.0,
            _ => 1.0,
        }
    }

    /// The bits of a 32-bit value.
    #[inline]
    pub(crate) fn bits(self, row: &[u8]) -> u32 {
        u32::from_le_bytes(self.bytes(row))
    }

    /// The value's bytes, least significant first.
    #[inline]
    fn bytes<const N: usize>(self, row: &[u8]) -> [u8; N] {
        let mut bytes = [0; N];
        bytes.copy_from_slice(&row[self.offset..self.offset + N]);
        if self.big {
            bytes.reverse();
        }
        bytes
    }
}

/// The rows of one element.
pub(crate) struct Table<'a> {
    element: &'a Element,
    rows: Cow<'a, [u8]>,
    big: bool,
    /// Bytes of a row, at least 1.
    pub(crate) stride: usize,
}

/// Names that tools give to the columns of red, green and blue, the usual ones first.
const COLOURS: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

impl Table<'_> {
    /// The columns of these names, if all three are there.
    pub(crate) fn three(&self, names: [&str; 3]) -> Option<[Slot; 3]> {
        let [Some(a), Some(b), Some(c)] = names.map(|name| self.find(name)) else { return None };
        Some([a, b, c])
    }

    /// The columns of red, green and blue, whatever they are called.
    pub(crate) fn colours(&self) -> Option<[Slot; 3]> {
        COLOURS.into_iter().find_map(|names| self.three(names))
    }

    /// The element's name in the header.
    pub(crate) fn name(&self) -> &str {
        &self.element.name
    }

    /// Number of rows.
    pub(crate) fn len(&self) -> usize {
        self.rows.len() / self.stride
    }

    /// All rows, `stride` bytes each.
    pub(crate) fn rows(&self) -> &[u8] {
        &self.rows
    }

    /// The scalar properties' names.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.element.properties.iter().filter(|p| p.list.is_none()).map(|p| p.name.as_str())
    }

    /// The position of the scalar property `name`, if there is one.
    pub(crate) fn find(&self, name: &str) -> Option<Slot> {
        let mut offset = 0;
        for property in self.element.properties.iter().filter(|p| p.list.is_none()) {
            if property.name == name {
                return Some(Slot { offset, kind: property.kind, big: self.big });
            }
            offset += property.kind.size();
        }
        None
    }

    /// The position of a property that must exist.
    pub(crate) fn slot(&self, name: &str) -> Result<Slot, Fault> {
        self.find(name).ok_or_else(|| {
            malformed(
                format!("element {}", self.name()),
                format!("no property `{name}`; this is not a 3DGS model (perhaps a point cloud), give a trained one"),
            )
        })
    }

    /// The position of a 32-bit integer property that must exist.
    pub(crate) fn packed(&self, name: &str) -> Result<Slot, Fault> {
        let slot = self.slot(name)?;
        if matches!(slot.kind, Kind::U32 | Kind::I32) {
            return Ok(slot);
        }
        Err(malformed(
            format!("element {}", self.name()),
            format!("property `{name}` is not of type uint as compressed PLY needs; export the file again"),
        ))
    }
}

/// The tables of the elements named in `wanted`, in file order, and the number of bytes after the last element.
pub(crate) fn tables<'a>(bytes: &'a [u8], header: &'a Header, wanted: &[&str]) -> Result<(Vec<Table<'a>>, u64), Fault> {
    let mut found: Vec<Table<'a>> = Vec::new();
    let mut body = Body { bytes, at: header.body };
    let big = header.encoding == Encoding::Big;
    for element in &header.elements {
        let keep = wanted.contains(&element.name.as_str()) && !found.iter().any(|t| t.name() == element.name);
        let rows = match header.encoding {
            Encoding::Ascii => Cow::Owned(body.text(element, keep)?),
            _ if element.is_fixed() => Cow::Borrowed(body.fixed(element)?),
            _ => Cow::Owned(body.lists(element, big, keep)?),
        };
        if keep {
            found.push(Table { element, rows, big, stride: element.stride().max(1) });
        }
    }
    let rest = &bytes[body.at.min(bytes.len())..];
    let blank = rest.iter().all(u8::is_ascii_whitespace);
    Ok((found, if blank { 0 } else { rest.len() as u64 }))
}

/// The part of the file behind the header, consumed element by element.
struct Body<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Body<'a> {
    /// A binary element without lists: a slice of the file.
    fn fixed(&mut self, element: &Element) -> Result<&'a [u8], Fault> {
        let rest = &self.bytes[self.at..];
        let stride = element.stride();
        let need = element.count.checked_mul(stride as u64).and_then(|need| usize::try_from(need).ok());
        match need.and_then(|need| rest.get(..need)) {
            Some(rows) => {
                self.at += rows.len();
                Ok(rows)
            }
            None => Err(cut_short(element, rest.len() / stride.max(1), self.bytes.len())),
        }
    }

    /// A binary element with lists: its scalars copied row by row (if kept), its lists stepped over.
    fn lists(&mut self, element: &Element, big: bool, keep: bool) -> Result<Vec<u8>, Fault> {
        let mut rows = Vec::new();
        for row in 0..element.count {
            for property in &element.properties {
                let short = || cut_short(element, row as usize, self.bytes.len());
                let step = match property.list {
                    None => property.kind.size(),
                    Some(counter) => {
                        let count = self.bytes.get(self.at..self.at + counter.size()).ok_or_else(short)?;
                        self.at += counter.size();
                        list_length(count, big).checked_mul(property.kind.size()).ok_or_else(short)?
                    }
                };
                let end = self.at.checked_add(step).ok_or_else(short)?;
                let value = self.bytes.get(self.at..end).ok_or_else(short)?;
                if keep && property.list.is_none() {
                    rows.extend_from_slice(value);
                }
                self.at = end;
            }
        }
        Ok(rows)
    }

    /// A text element: one line per row, turned into little-endian binary (if kept).
    fn text(&mut self, element: &Element, keep: bool) -> Result<Vec<u8>, Fault> {
        let mut rows = Vec::new();
        if element.properties.is_empty() {
            return Ok(rows);
        }
        for row in 0..element.count {
            let Some((at, line)) = self.line() else {
                return Err(cut_short(element, row as usize, self.bytes.len()));
            };
            if keep {
                text_row(element, line, &mut rows).map_err(|what| {
                    malformed(
                        format!("element {}, row {row}, byte {at}", element.name),
                        format!("{what}; repair that line"),
                    )
                })?;
            }
        }
        Ok(rows)
    }

    /// The next line that is not blank, with its offset.
    fn line(&mut self) -> Option<(usize, &'a [u8])> {
        while self.at < self.bytes.len() {
            let rest = &self.bytes[self.at..];
            let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
            let start = self.at;
            self.at = (self.at + end + 1).min(self.bytes.len());
            if !rest[..end].iter().all(u8::is_ascii_whitespace) {
                return Some((start, &rest[..end]));
            }
        }
        None
    }
}

/// A list's count of 1, 2 or 4 bytes; negative counts become implausibly large.
fn list_length(bytes: &[u8], big: bool) -> usize {
    let push = |value: usize, byte: &u8| value << 8 | usize::from(*byte);
    if big { bytes.iter().fold(0, push) } else { bytes.iter().rev().fold(0, push) }
}

/// Appends a line's scalars as little-endian binary.
fn text_row(element: &Element, line: &[u8], rows: &mut Vec<u8>) -> Result<(), String> {
    let line = std::str::from_utf8(line).map_err(|_| "not text".to_owned())?;
    let mut words = line.split_ascii_whitespace();
    for property in &element.properties {
        let mut next = || words.next().ok_or_else(|| format!("no value for property `{}`", property.name));
        if property.list.is_some() {
            let count: u64 = next()?.parse().map_err(|_| format!("no list count for `{}`", property.name))?;
            for _ in 0..count {
                next()?;
            }
        } else {
            push_value(property, next()?, rows)?;
        }
    }
    match words.next() {
        None => Ok(()),
        Some(_) => Err(format!("more than the {} values that the header declares", element.properties.len())),
    }
}

fn push_value(property: &Property, word: &str, rows: &mut Vec<u8>) -> Result<(), String> {
    let bad = || format!("`{}` is not a value of property `{}`", word.escape_default(), property.name);
    // Zero may have a sign where the type has none.
    let zero = word.strip_prefix('-').is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b == b'0'));
    let word = if zero && property.kind.is_integer() { "0" } else { word };
    by_kind!(property.kind, T => rows.extend(word.parse::<T>().map_err(|_| bad())?.to_le_bytes()));
    Ok(())
}

fn cut_short(element: &Element, whole: usize, end: usize) -> Fault {
    malformed(
        format!("element {}, row {whole}", element.name),
        format!(
            "the file ends at byte {end} with {whole} whole rows of the {} that the header claims; fetch or export it \
             again",
            element.count
        ),
    )
}
