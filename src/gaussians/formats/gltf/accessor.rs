//! Accessors as floats: any component type, normalised or not, interleaved, sparse.

use rayon::prelude::*;

use super::super::fault::{Fault, malformed};
use super::super::limit::fits;
use super::AGAIN;
use super::container::Store;
use super::document::{Accessor, Place, Shape};
use crate::ply::{Kind, Slot};

/// The type of numbers with this code, and its greatest number.
fn component(code: u32) -> Option<(Kind, f32)> {
    Some(match code {
        5120 => (Kind::I8, 127.0),
        5121 => (Kind::U8, 255.0),
        5122 => (Kind::I16, 32767.0),
        5123 => (Kind::U16, 65535.0),
        5125 => (Kind::U32, u32::MAX as f32),
        5126 => (Kind::F32, 1.0),
        _ => return None,
    })
}

/// Numbers of one element.
fn width(shape: Shape) -> usize {
    match shape {
        Shape::Scalar => 1,
        Shape::Vec2 => 2,
        Shape::Vec3 => 3,
        Shape::Vec4 => 4,
        Shape::Matrix => 16,
    }
}

/// Elements of one shape in the bytes of a view.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    kind: Kind,
    /// For normalised integers, the number that means 1.
    one: Option<f32>,
}

impl Rows<'_> {
    fn read(&self, i: usize, out: &mut [f32]) {
        for (k, out) in out.iter_mut().enumerate() {
            let value = Slot::first(self.kind).float(&self.bytes[i * self.stride + k * self.kind.size()..]);
            *out = self.one.map_or(value, |one| (value / one).max(-1.0));
        }
    }

    /// The first number of an element as a whole number, which float32 might not hold.
    fn whole(&self, i: usize) -> usize {
        Slot::first(self.kind).value(&self.bytes[i * self.stride..]) as usize
    }
}

impl Store<'_> {
    fn accessor(&self, index: usize) -> Result<&Accessor, Fault> {
        let accessor = self.document.accessors.get(index);
        accessor.ok_or_else(|| malformed(format!("accessor {index}"), format!("does not exist; {AGAIN}")))
    }

    /// The number of elements that an accessor claims, perhaps without data.
    pub(super) fn claimed(&self, index: usize) -> Result<usize, Fault> {
        self.accessor(index).map(|accessor| accessor.count)
    }

    /// The number of elements of an accessor that has data: one without any may claim as many as it likes.
    pub(super) fn count(&self, index: usize) -> Result<usize, Fault> {
        let accessor = self.accessor(index)?;
        let Some(view) = accessor.buffer_view else {
            if accessor.sparse.is_some() && fits(accessor.count, 0, self.bytes) {
                return Ok(accessor.count);
            }
            return Err(malformed(format!("accessor {index}"), format!("has no data; {AGAIN}")));
        };
        self.rows(index, view, accessor.byte_offset, accessor.count)?;
        Ok(accessor.count)
    }

    /// The numbers of elements, below `n`, in an accessor of indices.
    pub(super) fn indices(&self, index: usize, n: usize) -> Result<Vec<usize>, Fault> {
        let accessor = self.accessor(index)?;
        let view = accessor.buffer_view.filter(|_| width(accessor.shape) == 1 && accessor.sparse.is_none());
        let view =
            view.ok_or_else(|| malformed(format!("accessor {index}"), format!("is not a list of indices; {AGAIN}")))?;
        let rows = self.rows(index, view, accessor.byte_offset, accessor.count)?;
        let below = |i: usize| Some(rows.whole(i)).filter(|row| *row < n);
        (0..accessor.count).map(below).collect::<Option<_>>().ok_or_else(|| {
            malformed(format!("accessor {index}"), format!("has an index beyond the {n} elements; {AGAIN}"))
        })
    }

    /// All values of an accessor of `n` elements with `columns` numbers each, row-major; zeros where it has no data.
    pub(super) fn floats(&self, index: usize, columns: usize, n: usize) -> Result<Vec<f32>, Fault> {
        let accessor = self.accessor(index)?;
        let record = || format!("accessor {index}");
        if width(accessor.shape) != columns || accessor.count != n {
            let (is, count) = (width(accessor.shape), accessor.count);
            return Err(malformed(
                record(),
                format!("{count} elements of {is} numbers, {n} of {columns} expected; {AGAIN}"),
            ));
        }
        let rows = match accessor.buffer_view {
            Some(view) => Some(self.rows(index, view, accessor.byte_offset, n)?),
            None => None,
        };
        let mut out = vec![0.0; n * columns];
        if let Some(rows) = rows {
            out.par_chunks_exact_mut(columns).enumerate().for_each(|(i, out)| rows.read(i, out));
        }
        if let Some(sparse) = &accessor.sparse {
            if sparse.count > n {
                return Err(malformed(record(), format!("{} values replaced of {n}; {AGAIN}", sparse.count)));
            }
            let places = self.packed(index, &sparse.indices, sparse.indices.component_type, 1, sparse.count)?;
            let values = self.rows(index, sparse.values.buffer_view, sparse.values.byte_offset, sparse.count)?;
            for k in 0..sparse.count {
                let at = places.whole(k);
                let row = out.chunks_exact_mut(columns).nth(at);
                let row = row.ok_or_else(|| malformed(record(), format!("replaces element {at} of {n}; {AGAIN}")))?;
                values.read(k, row);
            }
        }
        Ok(out)
    }

    /// `n` elements of an accessor's type in a view, from `offset` on.
    fn rows(&self, index: usize, view: usize, offset: usize, n: usize) -> Result<Rows<'_>, Fault> {
        let accessor = self.accessor(index)?;
        let place = Place { buffer_view: view, byte_offset: offset, component_type: None };
        let rows = self.packed(index, &place, Some(accessor.component_type), width(accessor.shape), n)?;
        let (_, greatest) = component(accessor.component_type).filter(|_| accessor.normalized).unzip();
        Ok(Rows { one: greatest.filter(|_| rows.kind != Kind::F32), ..rows })
    }

    /// `n` elements of `columns` numbers of the type `code` at a place, whose view says how far apart they are.
    fn packed(
        &self,
        index: usize,
        place: &Place,
        code: Option<u32>,
        columns: usize,
        n: usize,
    ) -> Result<Rows<'_>, Fault> {
        let record = || format!("accessor {index}");
        let found = code.and_then(component);
        let (kind, _) =
            found.ok_or_else(|| malformed(record(), format!("component type {code:?} does not exist; {AGAIN}")))?;
        let (view, bytes) = self.view(place.buffer_view)?;
        let element = kind.size() * columns;
        let stride = view.byte_stride.unwrap_or(element);
        let need = n.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(element));
        let bytes = bytes.get(place.byte_offset..).filter(|rest| need.is_some_and(|need| need <= rest.len()));
        match bytes {
            Some(bytes) if stride >= element => Ok(Rows { bytes, stride, kind, one: None }),
            Some(_) => Err(malformed(record(), format!("elements of {element} bytes, {stride} apart; {AGAIN}"))),
            None => Err(malformed(
                record(),
                format!(
                    "{n} elements of {element} bytes reach beyond the end of bufferView {}; {AGAIN}",
                    place.buffer_view
                ),
            )),
        }
    }
}
