//! Times of rungs, taken in turn, so that other work on the machine affects all of them alike.

use crate::gpu::{Device, Timings};
use crate::job::{Error, Watcher};
use serde::Serialize;
use std::time::Instant;

/// Smallest and largest number of rounds; a first round, which also compiles, is not counted.
const ROUNDS: (usize, usize) = (3, 48);
/// A rung that takes this many times as long as the median one is skipped after the smallest number of rounds.
const SLOW: f64 = 4.0;

/// Seconds of one turn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// By the device's own timestamps; `None` if it has none, or did nothing.
    pub device: Option<f64>,
    /// By the host's clock.
    pub wall: f64,
}

impl Sample {
    /// The time of a body that runs on the host.
    pub fn host<T>(body: impl FnOnce() -> T) -> (T, Self) {
        let started = Instant::now();
        let result = body();
        (result, Self { device: None, wall: started.elapsed().as_secs_f64() })
    }

    /// The time of the given scopes in a recording that started at `started`.
    pub fn of(device: &Device, timings: &Timings, scopes: &[&str], started: Instant) -> Self {
        let there = device.info().timestamp_period > 0.0;
        Self {
            device: there.then(|| scopes.iter().map(|s| timings.seconds(s)).sum()),
            wall: started.elapsed().as_secs_f64(),
        }
    }

    /// Both times multiplied by a factor.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self { device: self.device.map(|d| d * factor), wall: self.wall * factor }
    }
}

/// Median and quartiles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// The median.
    pub median: f64,
    /// The lower quartile.
    pub q1: f64,
    /// The upper quartile.
    pub q3: f64,
    /// Number of values.
    pub samples: usize,
}

impl Spread {
    /// Returns true if the interquartile ranges overlap: the difference of the medians may then be noise.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.q1 <= other.q3 && other.q1 <= self.q3
    }

    /// The spread of at least one value; `None` for an empty list.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |share: f64| {
            let place = share * last as f64;
            let below = values[place.floor() as usize];
            below + (values[place.ceil() as usize] - below) * place.fract()
        };
        Some(Self { median: at(0.5), q1: at(0.25), q3: at(0.75), samples: values.len() })
    }
}

/// A rung's times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timed {
    /// By the device's timestamps.
    pub device: Option<Spread>,
    /// By the host's clock.
    pub wall: Option<Spread>,
}

/// Runs `rungs` bodies in turn, round after round: once unmeasured, then as often as fits into about `budget` seconds,
/// but at least `least` times. Every other round goes backward, so that a machine that slows down or speeds up favours
/// none. A body receives the index of its rung and the number of the round.
pub fn interleaved(
    rungs: usize,
    budget: f64,
    least: usize,
    watcher: &dyn Watcher,
    mut body: impl FnMut(usize, usize) -> Result<Sample, Error>,
) -> Result<Vec<Timed>, Error> {
    let mut samples: Vec<Vec<Sample>> = vec![Vec::new(); rungs];
    let mut once = vec![0.0; rungs];
    for (rung, once) in once.iter_mut().enumerate() {
        let begun = Instant::now();
        body(rung, 0)?;
        *once = begun.elapsed().as_secs_f64().max(1e-6);
        watcher.unless_stopped()?;
    }
    let least = least.max(ROUNDS.0);
    let middle = Spread::of(once.clone()).map_or(0.0, |s| s.median);
    let slow: Vec<bool> = once.iter().map(|s| *s > SLOW * middle).collect();
    let of = |which: bool| once.iter().zip(&slow).filter(|(_, slow)| **slow == which).map(|(s, _)| s).sum::<f64>();
    let left = (budget - ROUNDS.0 as f64 * of(true)).max(0.0);
    let rounds = ((left / of(false).max(1e-6)) as usize).clamp(least, ROUNDS.1.max(least));
    for round in 0..rounds {
        for k in 0..rungs {
            let rung = if round % 2 == 0 { k } else { rungs - 1 - k };
            if slow[rung] && round >= ROUNDS.0 {
                continue;
            }
            samples[rung].push(body(rung, round)?);
            watcher.unless_stopped()?;
        }
    }
    let timed = |samples: Vec<Sample>| Timed {
        device: Spread::of(samples.iter().filter_map(|s| s.device).collect()),
        wall: Spread::of(samples.iter().map(|s| s.wall).collect()),
    };
    Ok(samples.into_iter().map(timed).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Silent;

    #[test]
    fn rungs_take_turns_and_slow_ones_sit_out() {
        let mut turns = Vec::new();
        let timed = interleaved(3, 0.0, 5, &Silent, |rung, round| {
            turns.push((round, rung));
            if rung == 1 {
                std::thread::sleep(std::time::Duration::from_millis(30));
            }
            Ok(Sample { device: None, wall: rung as f64 })
        })
        .unwrap();
        let samples: Vec<usize> = timed.iter().map(|t| t.wall.unwrap().samples).collect();
        assert_eq!(samples, [5, 3, 5]);
        assert_eq!(turns[..9], [(0, 0), (0, 1), (0, 2), (0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0)]);
    }

    #[test]
    fn spreads() {
        assert_eq!(Spread::of(Vec::new()), None);
        let of = |values: &[f64]| Spread::of(values.to_vec()).unwrap();
        assert_eq!(of(&[3.0]), Spread { median: 3.0, q1: 3.0, q3: 3.0, samples: 1 });
        assert_eq!(of(&[5.0, 1.0, 3.0, 2.0, 4.0]), Spread { median: 3.0, q1: 2.0, q3: 4.0, samples: 5 });
        assert_eq!(of(&[1.0, 2.0]).median, 1.5);
    }
}
