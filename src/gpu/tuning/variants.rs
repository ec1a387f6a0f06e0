//! Tunings worth measuring on a device: its class's row, and rows that differ from it in one respect.

use crate::gpu::info::DeviceInfo;
use crate::gpu::tuning::Tuning;
use serde_json::Value;

/// A tuning, named after its difference from the class's row.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Its name.
    pub name: String,
    /// The tuning.
    pub tuning: Tuning,
}

/// The row of the device's class, and its variants that fit the device.
pub fn variants(info: &DeviceInfo) -> Vec<Variant> {
    let own = Tuning::new(info.class, info.subgroup_size, info.max_workgroup);
    let others = if own.rasterise_batch == 0 { alone(&own) } else { together(&own) };
    let others = others.into_iter().filter(|(_, tuning)| *tuning != own && tuning.check(info).is_ok());
    let named = |(name, tuning): (&str, Tuning)| Variant { name: name.to_owned(), tuning };
    std::iter::once(("the usual tuning", own.clone())).chain(others).map(named).collect()
}

/// Variants of rows whose rasterisers use one subgroup per tile: CPU devices.
fn alone(own: &Tuning) -> Vec<(&'static str, Tuning)> {
    let own = || own.clone();
    vec![
        ("tiles of 16", Tuning { tile: 16, ..own() }),
        ("rows of tiles in order", Tuning { row_stride: 1, ..own() }),
        ("sorts of 4 workgroups", Tuning { sort_workgroups: 4, ..own() }),
        ("sorts of 8 workgroups", Tuning { sort_workgroups: 8, ..own() }),
        ("sorts of 32 workgroups", Tuning { sort_workgroups: 32, ..own() }),
        ("scans of 1024 words", Tuning { scan_rows: (1024 / own().subgroup).max(1), ..own() }),
        ("scans of 8192 words", Tuning { scan_rows: 8192 / own().subgroup, ..own() }),
        ("adam by blocks", Tuning { adam_block: 64, ..own() }),
        ("runs of 22 in the loss", Tuning { loss_rounds: 3, loss_tile: 0, ..own() }),
    ]
}

/// Variants of rows whose rasterisers stage splats in shared memory: GPUs.
fn together(own: &Tuning) -> Vec<(&'static str, Tuning)> {
    let subgroup = own.subgroup;
    let own = || own.clone();
    let forward = |n: u32| Tuning { rasterise_workgroup: n.max(subgroup), rasterise_batch: n.max(subgroup), ..own() };
    let backward = |n: u32, batch: u32| Tuning { backward_workgroup: n, backward_batch: batch, ..own() };
    let small =
        Tuning { tile: 8, backward_workgroup: subgroup.max(32), backward_batch: subgroup.max(32), ..forward(64) };
    vec![
        ("tiles of 8", small),
        ("64 invocations forward", forward(64)),
        ("128 invocations forward", forward(128)),
        ("64 invocations backward", backward(64, subgroup.max(64))),
        ("256 invocations backward", backward(256, subgroup)),
        ("batches of a subgroup backward", backward(own().backward_workgroup, subgroup)),
        ("one subgroup backward", backward(subgroup, 0)),
        ("loss in runs", Tuning { loss_tile: 0, ..own() }),
        ("sorts of 64 workgroups", Tuning { sort_workgroups: 64, ..own() }),
        ("sorts of 1024 workgroups", Tuning { sort_workgroups: 1024, ..own() }),
        ("scans of 16 rows", Tuning { scan_rows: 16, ..own() }),
    ]
}

impl Tuning {
    /// This tuning with every field in which others differ from it; if two others differ in the same field, the first
    /// one's.
    #[must_use]
    pub fn with_differences<'a>(&self, others: impl DoubleEndedIterator<Item = &'a Self>) -> Self {
        let fields = |tuning: &Self| match serde_json::to_value(tuning) {
            Ok(Value::Object(fields)) => fields,
            _ => serde_json::Map::new(),
        };
        let own = fields(self);
        let mut all = own.clone();
        for other in others.rev() {
            all.extend(fields(other).into_iter().filter(|(name, value)| own.get(name) != Some(value)));
        }
        serde_json::from_value(Value::Object(all)).unwrap_or_else(|_| self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::DeviceClass;

    #[test]
    fn differences_add_up_and_the_first_has_precedence() {
        let own = Tuning::new(DeviceClass::Gpu, 32, 1024);
        let (a, b) =
            (Tuning { tile: 8, adam_block: 16, ..own.clone() }, Tuning { adam_block: 32, scan_rows: 8, ..own.clone() });
        let both = Tuning { tile: 8, adam_block: 16, scan_rows: 8, ..own.clone() };
        assert_eq!(own.with_differences([&a, &b].into_iter()), both);
        assert_eq!(own.with_differences(std::iter::empty()), own);
    }
}
