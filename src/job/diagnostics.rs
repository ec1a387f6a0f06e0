//! Diagnostics of a prune, a file that the viewer shows: block, score and fate of each Gaussian of the model before it.

use crate::gaussians::Gaussians;
use crate::gaussians::formats::{crc32, write_atomically};
use crate::job::Error;
use crate::qirf::pairs::{NO_CLUSTER, Pairs};
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Choice;
use crate::qirf::study::Study;
use crate::response::Responses;
use bytemuck::cast_slice;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// It was kept.
pub const KEPT: u8 = 1;
/// A kept Gaussian stands for it.
pub const MERGED: u8 = 1 << 1;
/// No view shows it.
pub const UNSEEN: u8 = 1 << 2;
/// The metric of its block was not positive definite, and its canonical form was used.
pub const CANONICAL: u8 = 1 << 3;
/// Its block had overlaps or responses that were not finite.
pub const REPAIRED: u8 = 1 << 4;
/// The detail safeguard kept it.
pub const DETAIL: u8 = 1 << 5;
/// All flags of this version.
const KNOWN: u8 = KEPT | MERGED | UNSEEN | CANONICAL | REPAIRED | DETAIL;

/// Block of a Gaussian that belongs to none.
pub const NO_BLOCK: u32 = NO_CLUSTER;

/// Name of the record of participations, which only prunes by blocks have.
const PARTICIPATION: &str = "participation";

/// Key of the notes in the file's header.
const NOTES: &str = "qirf-vk diagnostics";

/// Facts about each Gaussian of a model that was pruned, n each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Diagnostics {
    /// The rule that chose.
    pub selector: Selector,
    /// The block that it was chosen from; for pairs, the cluster that became one Gaussian. [`NO_BLOCK`] for none.
    pub block: Vec<u32>,
    /// Its worth by the selector, comparable across blocks; for pairs, the sum of T alpha over all pixels.
    pub score: Vec<f32>,
    /// [`KEPT`] and the other flags.
    pub flags: Vec<u8>,
    /// Its participation in the leading modes of its block; empty if no eigenproblem was solved.
    pub participation: Vec<f32>,
}

/// Header of a file of diagnostics.
#[derive(Serialize, Deserialize)]
struct Notes {
    selector: Selector,
    gaussians: usize,
    /// Checksum of the model.
    model: u32,
    /// Checksum of the records.
    crc32: u32,
}

/// Whether a view shows Gaussian `i`.
fn seen(Responses { channels, scores, .. }: &Responses, i: usize) -> bool {
    channels.get(i).is_some_and(|row| row.iter().any(|x| *x != 0.0))
        || scores.get(i).is_some_and(|s| s.contribution > 0.0)
}

fn flag(set: bool, flag: u8) -> u8 {
    if set { flag } else { 0 }
}

impl Diagnostics {
    /// Diagnostics of a choice from blocks.
    pub fn of_blocks(selector: Selector, study: &Study, choice: &Choice, responses: &Responses) -> Self {
        let n = choice.keep.len();
        let gain = study.rankings.iter().find(|(s, _)| *s == selector).map_or(&[][..], |(_, ranking)| &ranking.gain);
        let (mut block, mut flags) = (vec![NO_BLOCK; n], vec![0; n]);
        for ((members, guards), number) in study.partitioned.blocks.iter().zip(&study.collected.guards).zip(0..) {
            for i in members.iter().map(|i| *i as usize) {
                block[i] = number;
                flags[i] = flag(choice.keep[i], KEPT)
                    | flag(choice.saved.get(i) == Some(&true), DETAIL)
                    | flag(!seen(responses, i), UNSEEN)
                    | flag(guards.canonical, CANONICAL)
                    | flag(guards.repaired, REPAIRED);
            }
        }
        let participation = study.solver.map_or_else(Vec::new, |_| study.collected.participation.clone());
        Self { selector, block, score: gain.iter().map(|g| *g as f32).collect(), flags, participation }
    }

    /// Diagnostics of a merging by pairs.
    pub fn of_pairs(Pairs { keep, cluster, .. }: &Pairs, responses: &Responses) -> Self {
        let fate = |i: usize| flag(keep[i], KEPT) | flag(!keep[i] && cluster[i] != NO_CLUSTER, MERGED);
        Self {
            selector: Selector::Pairs,
            block: cluster.clone(),
            score: responses.scores.iter().map(|s| s.contribution).collect(),
            flags: (0..keep.len()).map(|i| fate(i) | flag(!seen(responses, i), UNSEEN)).collect(),
            participation: Vec::new(),
        }
    }

    /// The records by name, with the bytes of one entry.
    fn records(&self) -> Vec<(&'static str, Dtype, &[u8])> {
        let mut records = vec![
            ("block", Dtype::U32, cast_slice(&self.block)),
            ("flags", Dtype::U8, &self.flags[..]),
            ("score", Dtype::F32, cast_slice(&self.score)),
        ];
        if !self.participation.is_empty() {
            records.push((PARTICIPATION, Dtype::F32, cast_slice(&self.participation)));
        }
        records
    }

    /// Writes the file, whole or not at all. `model` is the one before the prune, as its file reads.
    pub fn write(&self, path: &Path, model: &Gaussians) -> Result<(), Error> {
        let encoding = |e: &dyn std::fmt::Display| Error::encoding("the diagnostics", e);
        let sum = crc32(self.records().into_iter().map(|(_, _, bytes)| bytes));
        let notes = Notes { selector: self.selector, gaussians: model.len(), model: crc32(model.bytes()), crc32: sum };
        let notes = serde_json::to_string(&notes).map_err(|e| encoding(&e))?;
        let tensor = |(name, dtype, bytes)| Ok((name, TensorView::new(dtype, vec![model.len()], bytes)?));
        let tensors: Result<Vec<_>, safetensors::SafeTensorError> = self.records().into_iter().map(tensor).collect();
        let tensors = tensors.map_err(|e| encoding(&e))?;
        // One note: a map's order changes from run to run.
        let notes = HashMap::from([(NOTES.to_owned(), notes)]);
        let bytes = safetensors::serialize(tensors, Some(notes)).map_err(|e| encoding(&e))?;
        write_atomically(path, |out| out.write_all(&bytes)).map_err(Error::writing)
    }

    /// Reads a file that was written about `model`.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Diagnostics`] for a damaged file and for one of another model.
    pub fn read(path: &Path, model: &Gaussians) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Self::parse(&bytes, model).map_err(|what| Error::Diagnostics { path: path.to_owned(), what })
    }

    fn parse(bytes: &[u8], model: &Gaussians) -> Result<Self, String> {
        let (_, header) =
            SafeTensors::read_metadata(bytes).map_err(|e| format!("it is not a complete safetensors file: {e}"))?;
        let notes = header.metadata().as_ref().and_then(|notes| notes.get(NOTES)).ok_or("it holds no diagnostics")?;
        let notes: Notes = serde_json::from_str(notes).map_err(|e| format!("record {NOTES}: {e}"))?;
        let (n, given) = (notes.gaussians, model.len());
        if n != given {
            return Err(format!("it belongs to another model: that has {n} Gaussians, this one {given}"));
        }
        if notes.model != crc32(model.bytes()) {
            return Err(format!("it belongs to another model, which also has {n} Gaussians"));
        }
        let file =
            SafeTensors::deserialize(bytes).map_err(|e| format!("it is not a complete safetensors file: {e}"))?;
        let record = |name: &str, dtype: Dtype| -> Result<Vec<u8>, String> {
            let record = file.tensor(name).map_err(|_| format!("record {name} is missing"))?;
            let fits = record.dtype() == dtype && record.shape() == [n];
            fits.then(|| record.data().to_vec()).ok_or_else(|| format!("record {name} is not {n} numbers of {dtype:?}"))
        };
        let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let words = |bytes: &[u8]| bytes.chunks_exact(4).map(word).collect::<Vec<u32>>();
        let numbers = |bytes: &[u8]| words(bytes).into_iter().map(f32::from_bits).collect::<Vec<f32>>();
        let read = Self {
            selector: notes.selector,
            block: words(&record("block", Dtype::U32)?),
            score: numbers(&record("score", Dtype::F32)?),
            flags: record("flags", Dtype::U8)?,
            participation: if file.names().contains(&PARTICIPATION) {
                numbers(&record(PARTICIPATION, Dtype::F32)?)
            } else {
                Vec::new()
            },
        };
        if crc32(read.records().into_iter().map(|(_, _, bytes)| bytes)) != notes.crc32 {
            return Err("its checksum does not match its records: it is damaged".to_owned());
        }
        match read.flags.iter().position(|flags| flags & !KNOWN != 0) {
            Some(i) => {
                Err(format!("record flags: Gaussian {i} has {:#04x}, which this version does not know", read.flags[i]))
            }
            None => Ok(read),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> (Gaussians, Diagnostics) {
        let mut model = Gaussians::zeroed(3, 1);
        model.means[1] = [1.0, 2.0, 3.0];
        let (block, score, flags) = (vec![0, 1, NO_BLOCK], vec![0.5, -1.0, f32::INFINITY], vec![KEPT, MERGED, UNSEEN]);
        let participation = vec![0.25, 0.0, 3.5];
        (model, Diagnostics { selector: Selector::Css, block, score, flags, participation })
    }

    fn written(diagnostics: &Diagnostics, model: &Gaussians) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.safetensors");
        diagnostics.write(&path, model).unwrap();
        assert_eq!(&Diagnostics::read(&path, model).unwrap(), diagnostics);
        std::fs::read(path).unwrap()
    }

    #[test]
    fn files_come_back_for_their_own_model_only() {
        let (model, diagnostics) = sample();
        let bytes = written(&diagnostics, &model);
        assert_eq!(bytes, written(&diagnostics, &model), "the same bytes each time");
        written(&Diagnostics { participation: Vec::new(), ..diagnostics.clone() }, &model);
        let mut other = model.clone();
        other.sh[1][5] = 0.25;
        assert!(Diagnostics::parse(&bytes, &other).is_err_and(|e| e.contains("another model")));
        let fewer = model.select(&[0, 1]);
        assert!(Diagnostics::parse(&bytes, &fewer).is_err_and(|e| e.contains("3 Gaussians, this one 2")));
        // A flag of a later version, in a file whose checksum is right.
        let later = Diagnostics { flags: vec![KEPT, 0x40, 0], ..diagnostics };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("later.safetensors");
        later.write(&path, &model).unwrap();
        let refused = Diagnostics::read(&path, &model).unwrap_err().to_string();
        assert!(refused.contains("later.safetensors") && refused.contains("flags: Gaussian 1 has 0x40"), "{refused}");
    }

    #[test]
    fn damage_is_found_and_never_panics() {
        let (model, diagnostics) = sample();
        let bytes = written(&diagnostics, &model);
        for end in 0..bytes.len() {
            assert!(Diagnostics::parse(&bytes[..end], &model).is_err(), "cut at {end}");
        }
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                // White space of the header may change without any effect.
                let read = Diagnostics::parse(&damaged, &model);
                assert!(read.is_err() || read.as_ref() == Ok(&diagnostics), "byte {at}, bit {bit}: {read:?}");
            }
        }
    }
}
