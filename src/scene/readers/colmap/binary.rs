//! COLMAP's binary files: little endian, a 64-bit count, then records of varying length.

use std::path::Path;

use glam::DVec2;

use super::super::files;
use super::{Cameras, ImageRow, Mark, PointRow, cameras_of, few, model_of};
use crate::scene::Error;
use crate::scene::lens::Lens;

/// Bytes still to read.
struct Cursor<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let rest = &self.all[self.at..];
        let Some(taken) = rest.get(..n) else {
            return Err(format!(
                "needs {n} bytes from byte {}, but {} are left: the file is cut short",
                self.at,
                rest.len()
            ));
        };
        self.at += n;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.array()?);
        }
        Ok(values)
    }

    /// Reads a count of items of at least `size` bytes each and checks it against the bytes left.
    fn count(&mut self, size: usize) -> Result<usize, String> {
        let claimed = self.u64()?;
        let left = self.all.len() - self.at;
        let most = (left / size) as u64;
        if claimed > most {
            return Err(format!(
                "claims {claimed} entries of at least {size} bytes, but {left} bytes are left: the file is cut short or damaged"
            ));
        }
        Ok(claimed as usize)
    }

    fn name(&mut self) -> Result<String, String> {
        let rest = &self.all[self.at..];
        let end = rest.iter().position(|&b| b == 0).ok_or("the name does not end: the file is cut short")?;
        self.at += end + 1;
        let name = std::str::from_utf8(&rest[..end]).map_err(|_| "the name is not UTF-8; rename the photo")?;
        if name.is_empty() { Err("the name is empty".to_owned()) } else { Ok(name.to_owned()) }
    }
}

/// Reads a file of records, called `what` in messages, of at least `size` bytes each: the count, the records, nothing
/// after.
fn records<T>(
    path: &Path,
    what: &str,
    size: usize,
    read: impl Fn(&mut Cursor) -> Result<T, String>,
) -> Result<Vec<T>, Error> {
    let bytes = files::read(path)?;
    let mut cursor = Cursor { all: &bytes, at: 0 };
    let count = cursor.count(size).map_err(|e| Error::malformed(path, "the count at its start", e))?;
    let mut rows = Vec::with_capacity(count);
    for i in 0..count {
        let row = read(&mut cursor);
        rows.push(row.map_err(|e| Error::malformed(path, format!("{what} {} of {count}", i + 1), e))?);
    }
    if cursor.at < bytes.len() {
        let what = format!("{} bytes follow the last of {count} entries: the count is wrong", bytes.len() - cursor.at);
        return Err(Error::malformed(path, "the end", what));
    }
    Ok(rows)
}

/// cameras.bin.
pub(super) fn cameras(path: &Path) -> Result<Cameras, Error> {
    const LEAST: usize = 24 + 2 * 8; // EQUIRECTANGULAR has the fewest parameters, 2
    let read = records(path, "camera", LEAST, |cursor| {
        let id = cursor.u32()?;
        let model = model_of(cursor.u32()? as i32)?;
        let (width, height) = (cursor.u64()?, cursor.u64()?);
        let parameters = cursor.take(8 * model.parameters())?.as_chunks::<8>().0;
        let parameters: Vec<f64> = parameters.iter().map(|b| f64::from_le_bytes(*b)).collect();
        Ok((id, Lens::from_colmap(model, width, height, &parameters)))
    })?;
    let count = read.len();
    let record = |number: usize| format!("camera {number} of {count}");
    cameras_of(path, read.into_iter().zip(1..).map(|((id, lens), number)| (record(number), id, lens)))
}

/// images.bin; its 2D points are kept if `marks` is set.
pub(super) fn images(path: &Path, marks: bool) -> Result<Vec<ImageRow>, Error> {
    records(path, "image", 74, |cursor| {
        let id = cursor.u32()?;
        let (quaternion, translation) = (cursor.f64s()?, cursor.f64s()?);
        let camera_id = cursor.u32()?;
        let name = cursor.name()?;
        let points = cursor.count(24)?;
        let points = cursor.take(24 * points)?.as_chunks::<24>().0;
        let marks = few(points.iter().filter(|_| marks).filter_map(mark).collect());
        Ok(ImageRow { id, quaternion, translation, camera_id, name, marks })
    })
}

/// A 2D point, if it names a point of the world: others have -1.
fn mark(bytes: &[u8; 24]) -> Option<Mark> {
    let [x, y, id] = std::array::from_fn(|i| std::array::from_fn(|k| bytes[8 * i + k]));
    let id = u64::from_le_bytes(id);
    (id != u64::MAX).then(|| (DVec2::new(f64::from_le_bytes(x), f64::from_le_bytes(y)), id))
}

/// points3D.bin.
pub(super) fn points(path: &Path) -> Result<Vec<PointRow>, Error> {
    records(path, "point", 51, |cursor| {
        let id = cursor.u64()?;
        let position = cursor.f64s()?;
        let colour = cursor.array()?;
        let [error] = cursor.f64s()?;
        let seen = cursor.count(8)?;
        let track = cursor.take(8 * seen)?.as_chunks::<8>().0; // image id, index of the 2D point
        let track = track.iter().map(|&[a, b, c, d, ..]| u32::from_le_bytes([a, b, c, d])).collect();
        Ok(PointRow { id, position, colour, error, track })
    })
}
