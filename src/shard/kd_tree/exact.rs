//! Serialisation of floats as the integers with their bits: text would round them.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    value.to_bits().serialize(serializer)
}

pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    u64::deserialize(deserializer).map(f64::from_bits)
}

/// Like [`serialize`] and [`deserialize`], for three numbers.
pub mod three {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(values: &[f64; 3], serializer: S) -> Result<S::Ok, S::Error> {
        values.map(f64::to_bits).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
        <[u64; 3]>::deserialize(deserializer).map(|bits| bits.map(f64::from_bits))
    }
}

/// Like [`three`], for many rows.
pub mod rows {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(rows: &[[f64; 3]], serializer: S) -> Result<S::Ok, S::Error> {
        rows.iter().map(|row| row.map(f64::to_bits)).collect::<Vec<_>>().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 3]>, D::Error> {
        Ok(Vec::<[u64; 3]>::deserialize(deserializer)?.into_iter().map(|row| row.map(f64::from_bits)).collect())
    }
}
