//! JSON files of tasks: sealed content with the plan's hash and the task's name; and figures for readers, sealed with
//! the plan's hash.

use crate::job::Error;
use crate::job::sealed::{open, seal, value};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

pub(super) fn bytes(plan: &str, task: &str, content: &impl Serialize) -> Result<Vec<u8>, Error> {
    let content = value(content).map_err(|e| Error::encoding("a task's figures", e))?;
    Ok(format!("{:#}", seal(json!({ "plan": plan, "task": task, "content": content }))).into_bytes())
}

/// The bytes of figures that readers know, an object, with the plan's hash and a checksum of what comes before it.
pub(super) fn stamped(mut figures: Value, plan: &str) -> Vec<u8> {
    figures["plan"] = plan.into();
    format!("{:#}\n", seal(figures)).into_bytes()
}

/// Checks the bytes of figures; or what is wrong with them.
pub(super) fn check_stamped(bytes: &[u8], plan: &str) -> Result<(), String> {
    check([open(bytes)?["plan"].as_str().unwrap_or_default(), ""], [plan, ""])
}

/// Checks the plan and the task that a file names.
pub(super) fn check(named: [&str; 2], wanted: [&str; 2]) -> Result<(), String> {
    if named[0] != wanted[0] {
        return Err("it belongs to another plan".to_owned());
    }
    if named[1] != wanted[1] {
        return Err(format!("it is the part of {}", named[1]));
    }
    Ok(())
}

/// The content of a file that task `task` of plan `plan` wrote, or what is wrong with it.
pub(super) fn parse<T: DeserializeOwned>(bytes: &[u8], plan: &str, task: &str) -> Result<T, String> {
    let mut document = open(bytes)?;
    check(["plan", "task"].map(|name| document[name].as_str().unwrap_or_default()), [plan, task])?;
    serde_json::from_value(document["content"].take()).map_err(|e| format!("it is damaged: {e}"))
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
    fn figures_are_checked() {
        let good = stamped(serde_json::json!({ "psnr": 28.5e-3, "views": [1.0, null] }), "abc");
        assert_eq!(check_stamped(&good, "abc"), Ok(()));
        assert!(check_stamped(&good, "abd").is_err_and(|e| e.contains("another plan")));
        let text = String::from_utf8(good).unwrap();
        for bad in [
            text.replace("28", "29"),
            text.replace("0.0285", "0.0295"),
            text[..20].to_owned(),
            String::new(),
            "[]".into(),
        ] {
            assert!(check_stamped(bad.as_bytes(), "abc").is_err(), "{bad}");
        }
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
