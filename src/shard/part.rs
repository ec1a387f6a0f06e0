//! The file of a chunk's responses: rows of the Gaussians that its views show, with the plan's hash and a checksum.

use super::sealed;
use crate::gaussians::formats::crc32;
use crate::job::Error;
use crate::job::sealed::DAMAGED;
use crate::response::{CHANNELS, Responses, Score};
use bytemuck::{cast_slice, cast_slice_mut, pod_collect_to_vec};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::HashMap;

/// Words of a score.
const SCORES: usize = size_of::<Score>() / size_of::<u32>();

/// A part as stored in its file.
#[derive(Debug)]
pub(super) struct Stored {
    /// Numbers of the Gaussians that have rows, rising.
    index: Vec<u32>,
    /// Their rows, one after the other; empty if not requested.
    channels: Vec<u32>,
    scores: Vec<u32>,
}

impl Stored {
    /// The responses of all `n` Gaussians.
    pub fn responses(&self, n: usize) -> Responses {
        let Self { index, channels, scores } = self;
        let mut responses = Responses::default();
        if !channels.is_empty() {
            responses.channels = vec![[0.0; CHANNELS]; n];
            for (i, row) in index.iter().zip(channels.chunks_exact(CHANNELS)) {
                cast_slice_mut::<f32, u32>(&mut responses.channels[*i as usize]).copy_from_slice(row);
            }
        }
        if !scores.is_empty() {
            responses.scores = vec![Score::default(); n];
            for (i, row) in index.iter().zip(scores.chunks_exact(SCORES)) {
                let i = *i as usize;
                cast_slice_mut::<Score, u32>(&mut responses.scores[i..=i]).copy_from_slice(row);
            }
        }
        responses
    }
}

/// CRC-32 of names and contents.
fn checksum<'a>(content: impl Iterator<Item = (&'a str, &'a [u8])>) -> u32 {
    crc32(content.flat_map(|(name, bytes)| [name.as_bytes(), bytes]))
}

/// An array of words as a tensor.
fn view<'a>((name, bytes): (&'a str, &'a [u8])) -> Result<(&'a str, TensorView<'a>), SafeTensorError> {
    Ok((name, TensorView::new(Dtype::U32, vec![bytes.len() / 4], bytes)?))
}

fn seen(responses: &Responses) -> Vec<u32> {
    let n = responses.channels.len().max(responses.scores.len());
    let shows = |i: &u32| {
        let i = *i as usize;
        let channels = responses.channels.get(i).map_or(&[][..], |row| cast_slice::<f32, u32>(row));
        let scores = responses.scores.get(i..=i).map_or(&[][..], |row| cast_slice::<Score, u32>(row));
        channels.iter().chain(scores).any(|word| *word != 0)
    };
    (0..n as u32).filter(shows).collect()
}

/// The bytes of the file of a task's responses; rows of Gaussians that no view shows are zero and not stored.
pub(super) fn bytes(plan: &str, task: &str, responses: &Responses) -> Result<Vec<u8>, Error> {
    let Responses { channels, scores, .. } = responses;
    let index = seen(responses);
    let picked = index.iter().map(|i| *i as usize);
    let channels: Vec<[f32; CHANNELS]> = picked.clone().filter_map(|i| channels.get(i).copied()).collect();
    let scores: Vec<Score> = picked.filter_map(|i| scores.get(i).copied()).collect();
    let arrays: [(&str, &[u8]); 3] =
        [("channels", cast_slice(&channels)), ("index", cast_slice(&index)), ("scores", cast_slice(&scores))];
    let sum = checksum(arrays.into_iter().chain([("plan", plan.as_bytes()), ("task", task.as_bytes())]));
    let notes = [("plan", plan.to_owned()), ("task", task.to_owned()), ("crc32", sum.to_string())];
    // Sorted, because a map's order changes from run to run.
    let notes: HashMap<String, String> =
        [("part".to_owned(), serde_json::to_string(&notes).map_err(|e| Error::encoding("a part", e))?)].into();
    let views: Vec<(&str, TensorView<'_>)> =
        arrays.into_iter().map(view).collect::<Result<_, _>>().map_err(|e| Error::encoding("a part", e))?;
    safetensors::serialize(views, Some(notes)).map_err(|e| Error::encoding("a part", e))
}

/// The content of a part for `n` Gaussians that task `task` of plan `plan` wrote, or what is wrong with it.
pub(super) fn parse(bytes: &[u8], n: usize, plan: &str, task: &str) -> Result<Stored, String> {
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("it is damaged: {e}"))?;
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format!("it is damaged: {e}"))?;
    let notes = header.metadata().as_ref().and_then(|notes| notes.get("part")).ok_or("it has no notes")?;
    let notes: Vec<(String, String)> = serde_json::from_str(notes).map_err(|e| format!("its notes: {e}"))?;
    let note = |name: &str| notes.iter().find(|(n, _)| n == name).map_or("", |(_, text)| text);
    sealed::check([note("plan"), note("task")], [plan, task])?;
    let array = |name: &str| file.tensor(name).map(|t| t.data()).map_err(|e| format!("{name}: {e}"));
    let arrays = [("channels", array("channels")?), ("index", array("index")?), ("scores", array("scores")?)];
    let sum = checksum(arrays.into_iter().chain([("plan", plan.as_bytes()), ("task", task.as_bytes())]));
    if note("crc32") != sum.to_string() {
        return Err(DAMAGED.to_owned());
    }
    let [channels, index, scores] = arrays.map(|(_, bytes)| pod_collect_to_vec::<u8, u32>(bytes));
    let fits = |rows: &[u32], width: usize| rows.is_empty() || rows.len() == width * index.len();
    if index.iter().any(|i| *i as usize >= n) || !fits(&channels, CHANNELS) || !fits(&scores, SCORES) {
        return Err("its arrays do not agree".to_owned());
    }
    Ok(Stored { index, channels, scores })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn responses() -> Responses {
        let mut responses =
            Responses { channels: vec![[0.0; CHANNELS]; 5], scores: vec![Score::default(); 5], ..Responses::default() };
        responses.channels[1][3] = 0.25;
        responses.scores[4] = Score { peak: 0.5, behind: [1.0, -0.0, 3.0], ..Score::default() };
        responses
    }

    #[test]
    fn parts_come_back() {
        let responses = responses();
        let file = || bytes("abc", "evidence/0003", &responses).unwrap();
        assert_eq!(file(), file(), "the same bytes every time");
        let back = parse(&file(), 5, "abc", "evidence/0003").unwrap();
        assert_eq!(back.responses(5), responses);
        assert_eq!(seen(&responses), [1, 4]);
    }

    /// Whichever byte changes, the part is refused or read correctly.
    #[test]
    fn damage_is_noticed() {
        let responses = responses();
        let bytes = bytes("abc", "evidence/0003", &responses).unwrap();
        for at in 0..bytes.len() {
            for bit in [0, 7] {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                if let Ok(read) = parse(&damaged, 5, "abc", "evidence/0003") {
                    assert_eq!(read.responses(5), responses, "byte {at}, bit {bit}");
                }
            }
        }
        assert!((0..bytes.len()).all(|end| parse(&bytes[..end], 5, "abc", "evidence/0003").is_err()));
    }

    #[test]
    fn foreign_parts_are_named() {
        let bytes = bytes("abc", "evidence/0003", &responses()).unwrap();
        let refused = |plan: &str, task: &str| parse(&bytes, 5, plan, task).err().unwrap_or_default();
        assert!(refused("other", "evidence/0003").contains("another plan"));
        assert!(refused("abc", "evidence/0004").contains("evidence/0003"));
        assert!(parse(&bytes, 4, "abc", "evidence/0003").is_err(), "of a larger model");
    }
}
