//! The tuning that a user asks for: a row of the table, with individual fields replaced.

use crate::gpu::error::Error;
use crate::gpu::info::DeviceInfo;
use crate::gpu::tuning::{DeviceClass, Tuning};
use serde_json::Value;
use std::str::FromStr;

/// A choice of tuning. By default it is the row of the device's own class.
///
/// Its text, in `--tuning` and `QIRF_TUNING`: a class, fields, or both, such as `gpu`, `tile=8` or
/// `nvidia,tile=8,sort_rows_max=8`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TuningChoice {
    class: Option<DeviceClass>,
    fields: Vec<(String, Value)>,
}

impl TuningChoice {
    /// The row of a class.
    pub fn class(class: DeviceClass) -> Self {
        Self { class: Some(class), fields: Vec::new() }
    }

    /// The tuning of a device under this choice.
    pub(in crate::gpu) fn on(&self, info: &DeviceInfo) -> Result<Tuning, Error> {
        let row = Tuning::new(self.class.unwrap_or(info.class), info.subgroup_size, info.max_workgroup);
        let tuning = self.over(&row).map_err(Error::Tuning)?;
        tuning.check(info).map_err(Error::Tuning)?;
        Ok(tuning)
    }

    /// A row with the chosen fields replaced.
    fn over(&self, row: &Tuning) -> Result<Tuning, String> {
        let mut fields = serde_json::to_value(row).map_err(|e| e.to_string())?;
        for (name, value) in &self.fields {
            match fields.get_mut(name) {
                Some(field) => *field = value.clone(),
                None => return Err(format!("no field is called '{name}'; `qirf-vk device` lists them")),
            }
        }
        serde_json::from_value(fields).map_err(|e| e.to_string())
    }
}

impl FromStr for TuningChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut choice = Self::default();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            match part.split_once('=') {
                Some((name, value)) => {
                    let value = serde_json::from_str(value.trim()).map_err(|e| format!("{part}: {e}"))?;
                    choice.fields.push((name.trim().to_owned(), value));
                }
                None => choice.class = Some(part.parse()?),
            }
        }
        Ok(choice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_choices() {
        let row = Tuning::new(DeviceClass::Gpu, 32, 1024);
        let chosen = |text: &str| text.parse::<TuningChoice>().and_then(|choice| choice.over(&row));
        assert_eq!(chosen(""), Ok(row.clone()));
        let three = chosen("sort_rows_max=8, tile=8,sort_serial=true").expect("three fields");
        assert_eq!(three, Tuning { sort_rows_max: 8, tile: 8, sort_serial: true, ..row.clone() });
        let both: TuningChoice = "amd,tile=8".parse().expect("a class and a field");
        assert_eq!((both.class, both.fields.len()), (Some(DeviceClass::Amd), 1));
        for (wrong, named) in
            [("tiles=8", "'tiles'"), ("tile=eight", "tile=eight"), ("tile=true", "u32"), ("riva", "'riva'")]
        {
            let error = chosen(wrong).expect_err(wrong);
            assert!(error.contains(named), "{error}");
        }
    }
}
