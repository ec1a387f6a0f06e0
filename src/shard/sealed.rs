//! JSON files of tasks, with the plan's hash and a checksum of the content.

use crate::gaussians::formats::crc32;
use crate::job::Error;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;

#[derive(Debug, Serialize, Deserialize)]
struct Sealed {
    plan: String,
    task: String,
    crc32: u32,
    content: Value,
}

fn checksum(content: &Value) -> u32 {
    crc32([content.to_string().as_bytes()])
}

/// The bytes of a file with this content.
pub(super) fn bytes(plan: &str, task: &str, content: &impl Serialize) -> Result<Vec<u8>, Error> {
    let encoding = |e| Error::encoding("a task's figures", e);
    let content = serde_json::to_value(content).map_err(encoding)?;
    let sealed = Sealed { plan: plan.to_owned(), task: task.to_owned(), crc32: checksum(&content), content };
    serde_json::to_vec_pretty(&sealed).map_err(encoding)
}

/// The content of a file that task `task` of plan `plan` wrote.
///
/// # Errors
/// [`Error::Read`]; [`Error::Part`] if it is damaged or belongs to another plan or task.
pub(super) fn read<T: DeserializeOwned>(path: &Path, plan: &str, task: &str) -> Result<T, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    parse(&bytes, plan, task).map_err(|what| Error::Part { path: path.to_owned(), what, task: task.to_owned() })
}

fn parse<T: DeserializeOwned>(bytes: &[u8], plan: &str, task: &str) -> Result<T, String> {
    let sealed: Sealed = serde_json::from_slice(bytes).map_err(|e| format!("it is damaged: {e}"))?;
    if sealed.plan != plan {
        return Err("it belongs to another plan".to_owned());
    }
    if sealed.task != task {
        return Err(format!("it is the part of {}", sealed.task));
    }
    if sealed.crc32 != checksum(&sealed.content) {
        return Err("its checksum is not that of its content: it is damaged".to_owned());
    }
    serde_json::from_value(sealed.content).map_err(|e| format!("it is damaged: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers keep all their bits, or the checksum would not match.
    #[test]
    fn numbers_come_back() {
        let content: Vec<f64> = (1..5000).map(|i| f64::from(i).sin() * 10f64.powi(i % 40 - 20)).collect();
        let sealed = bytes("abc", "score/0001", &content).unwrap();
        assert_eq!(parse::<Vec<f64>>(&sealed, "abc", "score/0001"), Ok(content));
    }

    #[test]
    fn seals_hold() {
        let content = vec![1.25, -3.0e-7, 17.125];
        let good = bytes("abc", "score/0001", &content).unwrap();
        let read = |bytes: &[u8]| parse::<Vec<f64>>(bytes, "abc", "score/0001");
        assert_eq!(read(&good).as_ref(), Ok(&content));
        for at in 0..good.len() {
            let mut damaged = good.clone();
            damaged[at] ^= 1;
            // A flipped bit of white space or of a name's last letter may still have the same meaning.
            assert!(read(&damaged).is_err() || read(&damaged).as_ref() == Ok(&content), "byte {at}");
        }
        assert!(parse::<Vec<f64>>(&good, "abd", "score/0001").is_err_and(|e| e.contains("another plan")));
        assert!(parse::<Vec<f64>>(&good, "abc", "score/0002").is_err_and(|e| e.contains("score/0001")));
    }
}
