//! Point clouds in PLY files, which nerfstudio puts beside its transforms.json: positions and colours only.

use std::path::Path;

use glam::DVec3;

use super::{ListedPoint, files};
use crate::kernels::constants::sh::float64::SH_C0;
use crate::scene::Error;

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// A property's type: size in bytes, floating or integer, signed or unsigned.
#[derive(Clone, Copy)]
struct Kind {
    size: usize,
    float: bool,
    signed: bool,
}

impl Kind {
    fn named(name: &str) -> Option<Self> {
        let (size, float, signed) = match name {
            "char" | "int8" => (1, false, true),
            "uchar" | "uint8" => (1, false, false),
            "short" | "int16" => (2, false, true),
            "ushort" | "uint16" => (2, false, false),
            "int" | "int32" => (4, false, true),
            "uint" | "uint32" => (4, false, false),
            "float" | "float32" => (4, true, true),
            "double" | "float64" => (8, true, true),
            _ => return None,
        };
        Some(Self { size, float, signed })
    }

    /// The value of exactly `size` bytes.
    fn decode(self, bytes: &[u8], big: bool) -> f64 {
        let mut all = [0; 8]; // little endian, zero above
        for (i, byte) in all[..self.size].iter_mut().enumerate() {
            *byte = bytes[if big { self.size - 1 - i } else { i }];
        }
        let bits = u64::from_le_bytes(all);
        match (self.float, self.size) {
            (true, 4) => f64::from(f32::from_bits(bits as u32)),
            (true, _) => f64::from_bits(bits),
            (false, size) if self.signed => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            (false, _) => bits as f64,
        }
    }
}

struct Header {
    encoding: Encoding,
    vertices: u64,
    properties: Vec<(String, Kind)>,
    /// Byte offset of the body.
    body: usize,
}

/// Reads the vertices of a PLY file.
pub(super) fn read(path: &Path) -> Result<Vec<ListedPoint>, Error> {
    let bytes = files::read(path)?;
    let header = header(&bytes).map_err(|what| Error::malformed(path, "the header", what))?;
    let body = &bytes[header.body..];
    let fault = |row: usize, what: &str| Error::malformed(path, format!("vertex {row} of {}", header.vertices), what);
    let column = |names: &[&str]| header.properties.iter().position(|(name, _)| names.contains(&name.as_str()));
    let (Some(x), Some(y), Some(z)) = (column(&["x"]), column(&["y"]), column(&["z"])) else {
        return Err(Error::malformed(path, "the header", "its vertices have no x, y and z"));
    };
    let colour = Colour::of(&header);
    let mut brightest: f64 = 0.0;
    let mut point = |row: &[f64]| {
        let shown = colour.shown(row);
        brightest = shown.iter().copied().fold(brightest, f64::max);
        (DVec3::new(row[x], row[y], row[z]), shown)
    };
    // Floats are shares of white, or count to 255 as bytes do.
    let finish = |points: Vec<(DVec3, [f64; 3])>, brightest: f64| {
        let bytes = if brightest > MOST_SHARE { 1.0 } else { 255.0 };
        let listed = |(position, shown): (DVec3, [f64; 3])| ListedPoint {
            position,
            colour: shown.map(|c| (c * bytes).round() as u8), // saturates; NaN gives 0
            error: 0.0,
            track: Vec::new(),
        };
        points.into_iter().map(listed).collect()
    };

    let mut points = Vec::new();
    let mut row = vec![0.0; header.properties.len()];
    if header.encoding == Encoding::Ascii {
        let text = std::str::from_utf8(body).map_err(|_| Error::malformed(path, "the body", "is not text"))?;
        let mut lines = text.lines().filter(|l| !l.trim().is_empty());
        for i in 1..=header.vertices as usize {
            let mut words = lines.next().ok_or_else(|| fault(i, "the file is cut short before it"))?.split_whitespace();
            for value in &mut row {
                let word = words.next().ok_or_else(|| fault(i, "has too few values"))?;
                *value = word.parse().map_err(|_| fault(i, "has a value that is no number"))?;
            }
            points.push(point(&row));
        }
        return Ok(finish(points, brightest));
    }
    let stride: usize = header.properties.iter().map(|(_, kind)| kind.size).sum();
    let there = body.len() / stride;
    if header.vertices > there as u64 {
        return Err(fault(there + 1, "the file is cut short before its end"));
    }
    for record in body.chunks_exact(stride).take(header.vertices as usize) {
        let mut rest = record;
        for (value, (_, kind)) in row.iter_mut().zip(&header.properties) {
            let (bytes, after) = rest.split_at(kind.size);
            *value = kind.decode(bytes, header.encoding == Encoding::Big);
            rest = after;
        }
        points.push(point(&row));
    }
    Ok(finish(points, brightest))
}

/// Above this, a colour in floats is no share of white, even of a bright one.
const MOST_SHARE: f64 = 2.0;

/// The columns of colours, under the names that tools give them.
enum Colour {
    None,
    /// Three columns, and what is white in whole numbers; 1 in floats.
    Three([usize; 3], f64),
    /// Bytes of blue, green, red and alpha in one number, or in the bits of a float.
    Packed(usize, bool),
    /// The zeroth coefficients of a model of Gaussians.
    Harmonics([usize; 3]),
}

impl Colour {
    fn of(header: &Header) -> Self {
        let column = |name: &str| header.properties.iter().position(|(own, _)| own == name);
        let three = |names: [&str; 3]| {
            let [Some(red), Some(green), Some(blue)] = names.map(column) else { return None };
            Some([red, green, blue])
        };
        let names = [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];
        if let Some(columns) = names.into_iter().find_map(three) {
            let kind = header.properties[columns[0]].1;
            return Self::Three(columns, if kind.float { 1.0 } else { (1_u64 << (8 * kind.size)) as f64 - 1.0 });
        }
        let packed = || ["rgb", "rgba"].into_iter().find_map(column).filter(|c| header.properties[*c].1.size == 4);
        if let Some(columns) = three(["f_dc_0", "f_dc_1", "f_dc_2"]) {
            Self::Harmonics(columns)
        } else if let Some(column) = packed() {
            Self::Packed(column, header.properties[column].1.float)
        } else {
            Self::None
        }
    }

    /// Red, green and blue of a row as shares of white, or floats as they are; grey without a colour.
    fn shown(&self, row: &[f64]) -> [f64; 3] {
        match *self {
            Self::None => [0.5; 3],
            Self::Three(columns, white) => columns.map(|c| row[c] / white),
            Self::Harmonics(columns) => columns.map(|c| (row[c] * SH_C0 + 0.5).clamp(0.0, 1.0)),
            Self::Packed(column, is_float) => {
                let bits = if is_float { (row[column] as f32).to_bits() } else { row[column] as i64 as u32 };
                [16, 8, 0].map(|shift| f64::from((bits >> shift) as u8) / 255.0)
            }
        }
    }
}

fn header(bytes: &[u8]) -> Result<Header, String> {
    let mut at = 0;
    let mut encoding = None;
    let mut vertices = None;
    let mut properties = Vec::new();
    let mut in_vertices = false;
    loop {
        let length = bytes[at..].iter().position(|&b| b == b'\n').ok_or("has no end_header: is this a PLY file?")?;
        let line = std::str::from_utf8(&bytes[at..at + length]).map_err(|_| "is not text: is this a PLY file?")?;
        let words: Vec<&str> = line.split_whitespace().collect();
        if at == 0 && words != ["ply"] {
            return Err("does not begin with ply: is this a PLY file?".to_owned());
        }
        at += length + 1;
        match words.as_slice() {
            ["format", name, ..] => {
                encoding = Some(match *name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => return Err(format!("names the format {other}, which is unknown")),
                });
            }
            ["element", "vertex", count] => {
                vertices = Some(count.parse::<u64>().map_err(|_| format!("counts {count} vertices"))?);
                in_vertices = true;
            }
            ["element", name, ..] if vertices.is_none() => {
                return Err(format!("puts element {name} before vertex; write the vertices first"));
            }
            ["element", ..] => in_vertices = false,
            ["property", "list", ..] if in_vertices => return Err("gives vertices a list property".to_owned()),
            ["property", kind, name] if in_vertices => {
                let kind = Kind::named(kind).ok_or_else(|| format!("gives {name} the unknown type {kind}"))?;
                properties.push(((*name).to_owned(), kind));
            }
            ["end_header"] => break,
            _ => {}
        }
    }
    let encoding = encoding.ok_or("names no format")?;
    let vertices = vertices.ok_or("has no element vertex")?;
    if properties.is_empty() {
        return Err("gives its vertices no property".to_owned());
    }
    Ok(Header { encoding, vertices, properties, body: at })
}
