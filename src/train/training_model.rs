//! A model in training, with all data stored per Gaussian.

use super::mean::Mean;
use super::moments::{self, Moments};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{Buffer, Device, Recording, Result, Ticket};
use crate::primitives::{Count, Scan};

/// A model in training, which density control replaces and a checkpoint stores.
pub struct TrainingModel {
    /// The model; its last rows may be a tail that is drawn and never changes.
    pub model: Resident,
    /// Adam's moments of the rows before the tail.
    pub moments: Moments,
    /// n x (sum of the norms of the gradients by the 2D mean, in NDC units; number of views that saw it), used by
    /// density control.
    pub growth: Buffer<[f32; 2]>,
    /// A method's arrays of the rows before the tail, while there are any.
    pub arrays: Vec<Array>,
    /// The mean of iterates, while one is taken.
    pub mean: Option<Mean>,
    pub(super) tail: Option<Tail>,
}

/// Description of a method's array: numbers of each trained Gaussian, which follow it through density control and
/// prunes, and are stored in checkpoints under the array's name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayKind {
    /// Its name; see [`TrainingModel::array`].
    pub name: &'static str,
    /// Numbers per Gaussian.
    pub width: usize,
    /// Initial value of all its numbers.
    pub first: f32,
    /// True if a new Gaussian begins with zeros; otherwise it inherits its source's numbers.
    pub restarts: bool,
}

/// An array of a method on the device.
pub struct Array {
    /// Its description.
    pub kind: ArrayKind,
    /// n x `kind.width` numbers.
    pub values: Buffer<f32>,
}

impl Array {
    /// Bytes of these arrays for `n` Gaussians.
    pub fn bytes(kinds: &[ArrayKind], n: usize) -> u64 {
        kinds.iter().map(|kind| Buffer::<f32>::bytes_of(n * kind.width)).sum()
    }

    /// An array with these numbers.
    pub fn with(device: &Device, kind: ArrayKind, values: &[f32]) -> Result<Self> {
        Ok(Self { kind, values: device.upload(kind.name, values)? })
    }
}

/// The rows at the end of a model that no step, density control, reset or prune touches.
pub(super) struct Tail {
    rows: usize,
    /// Number of rows before it, on the device.
    pub before: Count,
}

impl Tail {
    /// `None` if `rows` is 0; else the last `rows` of `n` Gaussians.
    ///
    /// # Panics
    /// If `rows` exceeds `n`.
    pub fn new(device: &Device, n: usize, rows: usize) -> Result<Option<Self>> {
        assert!(rows <= n, "a tail of {rows} rows in a model of {n}");
        let before = || Count::known(device, "trained Gaussians", (n - rows) as u32, &[Scan::block(device)]);
        (rows > 0).then(|| Ok(Self { rows, before: before()? })).transpose()
    }
}

impl TrainingModel {
    /// Bytes of a model in training of `n` Gaussians, the last `tail` of which have no moments.
    pub fn bytes(n: usize, tail: usize, degree: usize) -> u64 {
        let of = Buffer::<[f32; 2]>::bytes_of;
        let moments = Attributes::widths(degree).map(|width| of((n - tail) * width)).sum();
        Resident::bytes(n, degree) + moments + of(n)
    }

    /// A model before its first iteration: moments and growth are zero.
    pub fn new(device: &Device, model: &Gaussians) -> Result<Self> {
        Self::with_tail(device, model, 0)
    }

    /// Like [`TrainingModel::new`], for a model whose last `tail` rows are drawn and never change.
    ///
    /// # Panics
    /// If the tail is longer than the model.
    pub fn with_tail(device: &Device, model: &Gaussians, tail: usize) -> Result<Self> {
        let tail = Tail::new(device, model.len(), tail)?;
        let model = Resident::upload(device, model)?;
        let trained = model.len - tail.as_ref().map_or(0, |tail| tail.rows);
        let moments = moments::zeros_of(device, trained, model.degree)?;
        let growth = device.upload("growth", &vec![[0.0; 2]; model.len])?;
        Ok(Self { model, moments, growth, arrays: Vec::new(), mean: None, tail })
    }

    /// A method's array by its name.
    pub fn array(&self, name: &str) -> Option<&Buffer<f32>> {
        self.arrays.iter().find(|array| array.kind.name == name).map(|array| &array.values)
    }

    /// The arrays in the order in which a change replaces them: moments, parameters, then a method's. Of each the floats in a row,
    /// the rows that it lacks at the end, and its bytes.
    fn layouts(&self) -> impl Iterator<Item = (usize, usize, u64)> {
        let (widths, degree, tail) = (Attributes::widths(self.model.degree), self.model.degree, self.tail());
        let moments = widths.zip(self.moments.each_ref()).up_to(degree);
        let moments = moments.map(move |(width, values)| (2 * width, tail, values.bytes()));
        let parameters = widths.zip(self.model.parameters.each_ref()).up_to(degree);
        let parameters = parameters.map(|(width, values)| (width, 0, values.bytes()));
        let others = self.arrays.iter().map(move |array| (array.kind.width, tail, array.values.bytes()));
        moments.chain(parameters).chain(others)
    }

    /// Largest number of additional bytes during a change to arrays for `rows` Gaussians, if each replaces the old one before
    /// the next is made.
    pub(super) fn bytes_of_arrays(&self, rows: usize) -> u64 {
        let (mut more, mut most) = (0_i64, 0_i64);
        for (width, less, old) in self.layouts() {
            let new = Buffer::<f32>::bytes_of((rows - less) * width);
            most = most.max(more + new as i64);
            more += new as i64 - old as i64;
        }
        most.max(more) as u64
    }

    /// Number of rows for which all arrays have memory.
    pub(super) fn room(&self) -> usize {
        let rows = |(width, less, bytes): (usize, usize, u64)| bytes as usize / (width * size_of::<f32>()) + less;
        self.layouts().map(rows).fold(self.growth.room(), usize::min)
    }

    /// Floats in a row of the widest array.
    pub(super) fn widest_row(&self) -> usize {
        self.layouts().map(|(width, ..)| width).max().unwrap_or(0)
    }

    /// Sets the number of Gaussians, and records it on the device.
    pub(super) fn set_len(&mut self, recording: &mut Recording, n: usize) {
        self.model.len = n;
        self.model.count.set(recording, n as u32);
        if let Some(tail) = &self.tail {
            tail.before.set(recording, (n - tail.rows) as u32);
        }
    }

    /// Number of rows that never change, at the model's end.
    pub fn tail(&self) -> usize {
        self.tail.as_ref().map_or(0, |tail| tail.rows)
    }

    /// Number of trained rows.
    pub fn trained(&self) -> usize {
        self.model.len - self.tail()
    }

    /// The same number on the device.
    pub fn count(&self) -> &Count {
        self.tail.as_ref().map_or(&self.model.count, |tail| &tail.before)
    }

    /// Adds an SH band of zeros to the model. Returns the work that writes the zeros.
    ///
    /// # Errors
    /// Device memory; device errors. The model is then unchanged.
    pub fn raise_degree(&mut self, device: &Device) -> Result<Ticket> {
        let l = self.model.degree + 1;
        let (name, width, room) = (Attributes::NAMES.sh[l], Gaussians::band_width(l), self.room());
        let band = device.buffer(name, room * width)?.of_len(self.model.len * width);
        let moments = device.buffer(&format!("{name}.moments"), (room - self.tail()) * width)?;
        let moments = moments.of_len(self.trained() * width);
        let mut recording = Recording::new();
        recording.fill(&band, 0);
        recording.fill(&moments, 0);
        let zeros = device.submit(recording)?;
        self.model.parameters.sh[l] = band;
        self.moments.sh[l] = moments;
        self.model.degree = l;
        self.mean = None;
        Ok(zeros)
    }
}
