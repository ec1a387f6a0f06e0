//! Orders of work on which no result may depend, for tests. Commands that no barrier orders are permuted, workgroups
//! are numbered from the last one, and small dispatches get surplus workgroups as long ones do: a missing barrier then
//! changes results even on a device that runs its commands one by one. Barriers can be dropped, to show that this
//! works.

use crate::gpu::device::{Context, Device, lock};
use crate::gpu::hazards::{Barrier, Hazard, Hazards};
use crate::gpu::pipeline::Pipeline;
use crate::gpu::recording::{Command, Recording};
use crate::random::permutation;
use std::mem::take;
use std::str::FromStr;
use std::sync::{Arc, Mutex};

/// An order of the commands between two barriers of a submission. Scopes are empty, so their times mean nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// As recorded.
    Recorded,
    /// From the last to the first.
    Backwards,
    /// At random, from a seed.
    Shuffled(u64),
}

impl FromStr for Order {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "recorded" => Ok(Self::Recorded),
            "backwards" => Ok(Self::Backwards),
            seed => seed.parse().map(Self::Shuffled).map_err(|_| "'recorded', 'backwards' or a seed is wanted".into()),
        }
    }
}

/// A derived barrier.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Derived {
    /// The command after it: a kernel's name, or `fill`, `update`, `copy`.
    pub before: &'static str,
    /// The hazards that it prevents, each once.
    pub hazards: Vec<Hazard>,
    /// Whether it waits for earlier submissions alone.
    pub carried: bool,
}

/// The derived barriers to leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forget {
    /// None.
    Nothing,
    /// The one with this number, from 0, since the last [`Device::reorder`].
    Nth(usize),
    /// Those that prevent this hazard and no other.
    All(Hazard),
    /// Those that wait for earlier submissions.
    Carried,
}

impl Forget {
    fn leaves_out(self, number: usize, derived: &Derived) -> bool {
        match self {
            Self::Nothing | Self::Carried => false,
            Self::Nth(n) => n == number,
            Self::All(hazard) => derived.hazards == [hazard],
        }
    }
}

struct State {
    order: Order,
    forget: Forget,
    submissions: u64,
    derived: Vec<Derived>,
}

/// The order of a device that was opened with one.
pub(in crate::gpu) struct Disorder(Mutex<State>);

type Step = (Command, Option<Arc<Pipeline>>);

impl Disorder {
    pub fn new(order: Order) -> Self {
        Self(Mutex::new(State { order, forget: Forget::Nothing, submissions: 0, derived: Vec::new() }))
    }

    /// Permutes a recording with its pipelines, one per dispatch; returns the barriers before its commands.
    pub fn permute(
        &self,
        recording: &mut Recording,
        pipelines: &mut Vec<Arc<Pipeline>>,
        hazards: &mut Hazards,
    ) -> Vec<Option<Barrier>> {
        let mut state = lock(&self.0);
        state.submissions += 1;
        let mut of_dispatches = take(pipelines).into_iter();
        let mut own = Hazards::default();
        let mut parts: Vec<(Option<Barrier>, Vec<Step>)> = vec![(None, Vec::new())];
        let (scopes, work): (Vec<_>, Vec<_>) =
            take(&mut recording.commands).into_iter().partition(|c| matches!(c, Command::Begin(_) | Command::End));
        recording.commands = scopes;
        let mut barriers = vec![None; recording.commands.len()];
        let mut uses = Vec::new();
        for command in work {
            command.uses(&recording.arguments, &mut uses);
            let mut prevented: Vec<Hazard> = hazards.conflicts(&uses).map(|(a, b)| Hazard::between(a, b)).collect();
            prevented.sort_unstable();
            prevented.dedup();
            let (mut barrier, within) = (hazards.next(&uses), own.next(&uses));
            let carried = within.is_none();
            if state.forget == Forget::Carried {
                barrier = within;
            }
            if barrier.is_some() {
                let derived = Derived { before: command.name(), hazards: prevented, carried };
                if !state.forget.leaves_out(state.derived.len(), &derived) {
                    parts.push((barrier, Vec::new()));
                }
                state.derived.push(derived);
            }
            let pipeline = matches!(command, Command::Dispatch(_)).then(|| of_dispatches.next()).flatten();
            parts.last_mut().expect("one at least").1.push((command, pipeline));
        }
        for (number, (barrier, steps)) in parts.into_iter().enumerate() {
            let steps = state.ordered(steps, number as u64);
            barriers.extend((0..steps.len()).map(|k| barrier.filter(|_| k == 0)));
            for (command, pipeline) in steps {
                recording.commands.push(command);
                pipelines.extend(pipeline);
            }
        }
        barriers
    }
}

impl State {
    fn ordered(&self, mut steps: Vec<Step>, part: u64) -> Vec<Step> {
        match self.order {
            Order::Recorded => {}
            Order::Backwards => steps.reverse(),
            Order::Shuffled(seed) => {
                let mut keyed: Vec<_> =
                    permutation(steps.len(), &[seed, self.submissions, part]).into_iter().zip(steps).collect();
                keyed.sort_unstable_by_key(|(key, _)| *key);
                steps = keyed.into_iter().map(|(_, step)| step).collect();
            }
        }
        steps
    }
}

impl Context {
    /// Derives the barriers of a recording, whose commands may be permuted with their pipelines.
    pub(in crate::gpu) fn ordered(
        &self,
        recording: &mut Recording,
        pipelines: &mut Vec<Arc<Pipeline>>,
    ) -> Vec<Option<Barrier>> {
        let hazards = &mut lock(&self.hazards);
        match &self.disorder {
            None => recording.barriers(hazards),
            Some(disorder) => disorder.permute(recording, pipelines, hazards),
        }
    }
}

impl Device {
    /// Sets another order, and the barriers to leave out from here on. Returns the barriers derived since the last
    /// call.
    ///
    /// # Panics
    /// If the device was opened without [`crate::gpu::Harness::order`].
    pub fn reorder(&self, order: Order, forget: Forget) -> Vec<Derived> {
        let disorder = self.context().disorder.as_ref().expect("the device was opened with an order");
        let mut state = lock(&disorder.0);
        (state.order, state.forget, state.submissions) = (order, forget, 0);
        take(&mut state.derived)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_orders() {
        assert_eq!("backwards".parse(), Ok(Order::Backwards));
        assert_eq!("7".parse(), Ok(Order::Shuffled(7)));
        assert!("sideways".parse::<Order>().is_err());
    }

    #[test]
    fn what_is_left_out() {
        let derived = |hazards: &[Hazard]| Derived { before: "copy", hazards: hazards.to_vec(), carried: false };
        let (one, two) =
            (derived(&[Hazard::WriteAfterRead]), derived(&[Hazard::ReadAfterWrite, Hazard::WriteAfterRead]));
        assert!(Forget::Nth(3).leaves_out(3, &one) && !Forget::Nth(3).leaves_out(2, &one));
        let all = Forget::All(Hazard::WriteAfterRead);
        assert!(all.leaves_out(0, &one) && !all.leaves_out(0, &two), "another hazard needs the second");
    }
}
