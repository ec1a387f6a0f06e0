//! Lower bounds of times: bytes over the device's bandwidth, operations over its rate, both measured.

use super::measured::{Bench, Measured};

/// Best rates of a device.
pub struct Rates {
    /// For each copy, bytes of both buffers, and bytes moved per second.
    copies: Vec<[f64; 2]>,
    /// float32 operations per second.
    pub operations: f64,
}

/// Lower bound of a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    pub ms: f64,
    /// The limit of the time: `bytes`, `operations` or `both`.
    pub by: &'static str,
}

impl Rates {
    /// From the fastest samples of the group `device`, since a bound must not be too long.
    ///
    /// # Errors
    /// A benchmark that was not run, by name.
    pub fn of(bench: &Bench) -> Result<Self, String> {
        let rate = |m: &Measured, name: &str| m.number(name) / (1e-3 * m.ms[0]);
        let multiply_add = bench.get("device/multiply-add")?;
        let copies: Vec<[f64; 2]> = bench
            .group("device")
            .filter(|(name, _)| name.starts_with("copy"))
            .map(|(_, m)| [m.number("buffers"), rate(m, "bytes")])
            .collect();
        if copies.is_empty() {
            return Err("no copy of the group 'device' was measured; run all groups: make figures".to_owned());
        }
        Ok(Self { copies, operations: rate(multiply_add, "operations") })
    }

    /// Best bytes per second for moving `bytes`: from copies of as many or more, since smaller ones may stay in a
    /// cache.
    pub fn bandwidth(&self, bytes: f64) -> f64 {
        let most = self.copies.iter().map(|c| c[0]).fold(0.0, f64::max);
        let alike = self.copies.iter().filter(|c| c[0] >= bytes.min(most));
        alike.map(|c| c[1]).fold(0.0, f64::max)
    }

    /// A benchmark's bound; none without its bytes and operations. A sum of stages is bounded as one.
    pub fn bound(&self, m: &Measured) -> Option<Bound> {
        let (bytes, operations) = (m.number("bytes"), m.number("operations"));
        let [moving, computing] = [bytes / self.bandwidth(bytes), operations / self.operations].map(|s| 1e3 * s);
        let bound = if moving >= computing {
            Bound { ms: moving, by: "bytes" }
        } else {
            Bound { ms: computing, by: "operations" }
        };
        (bound.ms.is_finite() && bound.ms > 0.0).then_some(bound)
    }
}
