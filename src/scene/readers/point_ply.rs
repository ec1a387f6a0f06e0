//! Point clouds in PLY files, which nerfstudio puts beside its transforms.json: positions, normals and colours.

use std::path::Path;

use glam::DVec3;

use super::files;
use crate::kernels::constants::sh::float64::SH_C0;
use crate::ply::{Fault, Header, Slot, Table, malformed, tables};
use crate::scene::{Error, Point};

/// Reads the vertices of a PLY file.
pub(super) fn read(path: &Path) -> Result<Vec<Point>, Error> {
    points(&files::read(path)?).map_err(|fault| Error::malformed(path, fault.record, fault.what))
}

fn points(bytes: &[u8]) -> Result<Vec<Point>, Fault> {
    if !bytes.starts_with(b"ply") {
        return Err(malformed("the beginning", "is not a PLY file; convert the point cloud to PLY"));
    }
    let header = Header::parse(bytes)?;
    let (tables, _) = tables(bytes, &header, &["vertex"])?;
    let Some(vertices) = tables.first() else { return Err(malformed("the header", "has no element vertex")) };
    let Some([x, y, z]) = vertices.three(["x", "y", "z"]) else {
        return Err(malformed("the header", "its vertices have no x, y and z"));
    };
    let normal = vertices.three(["nx", "ny", "nz"]);
    let colour = Colour::of(vertices);
    let rows = || vertices.rows().chunks_exact(vertices.stride);
    let shown: Vec<[f64; 3]> = rows().map(|row| colour.shown(row)).collect();
    // Floats are shares of white, or count to 255 as bytes do; so do numbers of 16 bits at times.
    let brightest = shown.as_flattened().iter().copied().fold(0.0, f64::max);
    let white = match colour {
        Colour::Three(_, most) if most > 255.0 && brightest * most <= 255.0 => most,
        _ if brightest > MOST_SHARE => 1.0,
        _ => 255.0,
    };
    let point = |(row, shown): (&[u8], [f64; 3])| Point {
        position: DVec3::new(x.value(row), y.value(row), z.value(row)),
        // Models of Gaussians have zeros here.
        normal: normal.and_then(|columns| DVec3::from_array(columns.map(|c| c.value(row))).try_normalize()),
        colour: shown.map(|c| (c * white).round() as u8), // saturates; NaN gives 0
        error: 0.0,
        track: Vec::new(),
    };
    Ok(rows().zip(shown).map(point).collect())
}

/// Above this, a colour in floats is no share of white, even of a bright one.
const MOST_SHARE: f64 = 2.0;

/// The columns of colours, under the names that tools give them.
enum Colour {
    None,
    /// Three columns, and what is white in whole numbers; 1 in floats.
    Three([Slot; 3], f64),
    /// Bytes of blue, green, red and alpha in the bits of one number.
    Packed(Slot),
    /// The zeroth coefficients of a model of Gaussians.
    Harmonics([Slot; 3]),
}

impl Colour {
    fn of(vertices: &Table<'_>) -> Self {
        if let Some(columns) = vertices.colours() {
            return Self::Three(columns, columns[0].white(0.0).into());
        }
        let packed = ["rgb", "rgba"].into_iter().find_map(|name| vertices.find(name));
        match (vertices.three(["f_dc_0", "f_dc_1", "f_dc_2"]), packed.filter(|slot| slot.kind().size() == 4)) {
            (Some(columns), _) => Self::Harmonics(columns),
            (None, Some(slot)) => Self::Packed(slot),
            (None, None) => Self::None,
        }
    }

    /// Red, green and blue of a row as shares of white, or floats as they are; grey without a colour.
    fn shown(&self, row: &[u8]) -> [f64; 3] {
        match *self {
            Self::None => [0.5; 3],
            Self::Three(columns, white) => columns.map(|c| c.value(row) / white),
            Self::Harmonics(columns) => columns.map(|c| (c.value(row) * SH_C0 + 0.5).clamp(0.0, 1.0)),
            Self::Packed(slot) => [16, 8, 0].map(|shift| f64::from((slot.bits(row) >> shift) as u8) / 255.0),
        }
    }
}
