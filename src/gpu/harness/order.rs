//! Orders of work on which no result may depend, for tests. Commands that no barrier orders are permuted, workgroups
//! are numbered from the last one, and small dispatches get surplus workgroups as long ones do: a missing barrier then
//! changes results even on a device that runs its commands one by one. Barriers can be dropped, to show that this
//! works.

use crate::gpu::hazards::Hazard;
use crate::lock::lock;
use crate::random::permutation;
use std::mem::take;
use std::str::FromStr;
use std::sync::Mutex;

/// An order of the commands between two barriers of a submission. Scopes are empty, so their times mean nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Order in which they were recorded.
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
    /// No barrier.
    Nothing,
    /// The one with this number, from 0, since the last [`crate::gpu::Device::reorder`].
    Nth(usize),
    /// Barriers that prevent this hazard and no other.
    All(Hazard),
    /// Barriers that wait for earlier submissions.
    Carried,
}

impl Forget {
    pub(super) fn leaves_out(self, number: usize, derived: &Derived) -> bool {
        match self {
            Self::Nothing | Self::Carried => false,
            Self::Nth(n) => n == number,
            Self::All(hazard) => derived.hazards == [hazard],
        }
    }
}

pub(super) struct State {
    order: Order,
    pub forget: Forget,
    pub submissions: u64,
    pub derived: Vec<Derived>,
}

/// The order of a device that was opened with one.
pub(in crate::gpu) struct Disorder(pub(super) Mutex<State>);

impl Disorder {
    pub fn new(order: Order) -> Self {
        Self(Mutex::new(State { order, forget: Forget::Nothing, submissions: 0, derived: Vec::new() }))
    }

    /// Sets another order, and the barriers to leave out from here on. Returns the barriers derived since the last call.
    pub fn reorder(&self, order: Order, forget: Forget) -> Vec<Derived> {
        let mut state = lock(&self.0);
        (state.order, state.forget, state.submissions) = (order, forget, 0);
        take(&mut state.derived)
    }
}

impl State {
    /// Steps between two barriers in their order.
    pub fn ordered<T>(&self, mut steps: Vec<T>, part: u64) -> Vec<T> {
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
