//! Time per named scope, from device timestamps.

use std::collections::BTreeMap;

/// Seconds and visits by scope name.
#[derive(Clone, Debug, Default)]
pub struct Timings {
    scopes: BTreeMap<&'static str, (f64, u64)>,
}

impl Timings {
    pub(super) fn add(&mut self, name: &'static str, seconds: f64) {
        let entry = self.scopes.entry(name).or_default();
        entry.0 += seconds;
        entry.1 += 1;
    }

    /// Total seconds of a scope; 0 if it never ran or the device has no timestamps.
    pub fn seconds(&self, name: &str) -> f64 {
        self.scopes.get(name).map_or(0.0, |s| s.0)
    }

    /// Seconds of all scopes together.
    pub fn total(&self) -> f64 {
        self.scopes.values().map(|s| s.0).sum()
    }

    /// (name, seconds, visits) by name.
    pub fn iter(&self) -> impl Iterator<Item = (&'static str, f64, u64)> + '_ {
        self.scopes.iter().map(|(name, (seconds, visits))| (*name, *seconds, *visits))
    }

    /// Adds another's scopes to these.
    pub fn merge(&mut self, other: &Self) {
        for (name, seconds, visits) in other.iter() {
            let entry = self.scopes.entry(name).or_default();
            entry.0 += seconds;
            entry.1 += visits;
        }
    }
}
