//! Mutants: each derived barrier is dropped in turn, in orders that swap the commands it separated.

use super::{BEFORE, all_effects, capture, new_trainer, respond_and_assemble, train, words};
use crate::device::watch::unwatched;
use crate::support::{opened, skip};
use qirf_vk::gpu::{Derived, Device, Forget, Hazard, Order};
use qirf_vk::train::Trainer;
use qirf_vk::train::checkpoint::Snapshot;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::Command;

const ORDERS: [Order; 3] = [Order::Backwards, Order::Shuffled(1), Order::Shuffled(2)];

/// Few, so that a pass over them is short.
const PHOTOS: usize = 2;

/// Work between two undisturbed steps; returns its results.
type Work = fn(&Device, &mut Trainer) -> Vec<u32>;

struct Part {
    name: &'static str,
    /// Iterations done before.
    at: u32,
    work: Work,
}

/// Two iterations, the second of which is submitted before the first has finished.
fn iterate(_: &Device, trainer: &mut Trainer) -> Vec<u32> {
    train(trainer, trainer.iteration() + 2);
    words(&trainer.snapshot().unwrap())
}

fn prune(device: &Device, trainer: &mut Trainer) -> Vec<u32> {
    let mut all = respond_and_assemble(device, trainer);
    let keep: Vec<bool> = (0..trainer.len()).map(|i| i % 3 > 0).collect();
    trainer.keep(&keep, None).unwrap();
    all.extend(words(&trainer.snapshot().unwrap()));
    all
}

const ITERATION: Part = Part { name: "two iterations", at: BEFORE - 4, work: iterate };
const DENSITY: Part = Part { name: "two iterations with density control", at: 17, work: iterate };
const PRUNE: Part = Part { name: "prune", at: BEFORE - 1, work: prune };

/// A state from which each mutant starts.
struct Bench<'a> {
    device: &'a Device,
    part: &'a Part,
    state: Snapshot,
}

impl<'a> Bench<'a> {
    fn new(device: &'a Device, part: &'a Part) -> Self {
        device.reorder(Order::Recorded, Forget::Nothing);
        let mut trainer = new_trainer(device, PHOTOS);
        train(&mut trainer, part.at);
        Self { device, part, state: trainer.snapshot().unwrap() }
    }

    /// Runs an iteration, so that every buffer has contents, and then the work in this order without those barriers;
    /// returns its results and the derived barriers.
    fn run(&self, order: Order, forget: Forget) -> (Vec<u32>, Vec<Derived>) {
        let c = capture();
        self.device.reorder(Order::Recorded, Forget::Nothing);
        let photos = c.train[..PHOTOS].to_vec();
        let mut trainer = Trainer::resume(self.device, &self.state, photos, c.extent, all_effects()).unwrap();
        train(&mut trainer, self.part.at + 1);
        self.device.reorder(order, forget);
        let result = (self.part.work)(self.device, &mut trainer);
        (result, self.device.reorder(Order::Recorded, Forget::Nothing))
    }

    /// The number of orders in which results differ, and of validation messages, without these barriers.
    fn killed(&self, forget: Forget, right: &[u32]) -> (usize, usize) {
        let before = Device::validation_messages();
        let differing = ORDERS.iter().filter(|order| self.run(**order, forget).0 != right).count();
        (differing, Device::validation_messages() - before)
    }
}

#[derive(Default)]
struct Row {
    all: usize,
    by_bits: usize,
    by_validation: usize,
    survived: usize,
}

fn kind(derived: &Derived) -> String {
    let mut name = if derived.carried { "carried over: ".to_owned() } else { String::new() };
    for (k, hazard) in derived.hazards.iter().enumerate() {
        let _ = write!(name, "{}{hazard:?}", if k > 0 { ", " } else { "" });
    }
    name
}

/// Every dropped barrier changes bits or raises a validation message. Runs in its own process, because messages fail
/// other tests.
#[test]
fn a_forgotten_barrier_is_noticed() {
    if unwatched() {
        return skip("no validation layers");
    }
    let name = "device::order::barriers::some_forgotten_barriers";
    let program = Command::new(std::env::current_exe().unwrap()).args(["--exact", name, "--ignored"]).output().unwrap();
    let text = String::from_utf8_lossy(&program.stdout);
    assert!(program.status.success() && text.contains("1 passed"), "{text}");
}

#[test]
#[ignore = "validation messages are wanted: a_forgotten_barrier_is_noticed runs it"]
fn some_forgotten_barriers() {
    let device = in_recorded_order();
    let bench = Bench::new(&device, &ITERATION);
    let (right, derived) = bench.run(Order::Recorded, Forget::Nothing);
    assert!(derived.len() > 60, "{} barriers", derived.len());
    for (n, barrier) in derived.iter().enumerate().step_by(10).filter(|(_, b)| !b.carried) {
        assert_ne!(bench.killed(Forget::Nth(n), &right), (0, 0), "{n}, before {}: {}", barrier.before, kind(barrier));
    }
    assert_eq!(bench.killed(Forget::All(Hazard::ReadAfterWrite), &right).0, ORDERS.len());
    // Software devices run submissions one after the other: only the validation layers detect these.
    assert!(bench.killed(Forget::Carried, &right).1 > 0, "what earlier submissions left to wait for");
}

fn in_recorded_order() -> Device {
    let order = Some(Order::Recorded);
    opened(|options| options.harness.order = order)
}

/// Prints which dropped barriers were detected; `make mutants` runs it.
#[test]
#[ignore = "minutes, and validation messages that are wanted"]
fn each_derived_barrier() {
    let device = in_recorded_order();
    for part in [ITERATION, DENSITY, PRUNE] {
        let bench = Bench::new(&device, &part);
        let (right, derived) = bench.run(Order::Recorded, Forget::Nothing);
        let mut table: BTreeMap<String, Row> = BTreeMap::new();
        for (n, barrier) in derived.iter().enumerate() {
            eprintln!("{} {n} of {}: before {}, {}", part.name, derived.len(), barrier.before, kind(barrier));
            let (orders, messages) = bench.killed(Forget::Nth(n), &right);
            let row = table.entry(kind(barrier)).or_default();
            row.all += 1;
            row.by_bits += usize::from(orders > 0);
            row.by_validation += usize::from(messages > 0);
            if orders + messages == 0 {
                row.survived += 1;
                println!("survived: {} {n}, before {}, {}", part.name, barrier.before, kind(barrier));
            }
        }
        println!("| {} | barriers | changed bits | validation messages | survived |", part.name);
        for (kind, r) in table {
            println!("| {kind} | {} | {} | {} | {} |", r.all, r.by_bits, r.by_validation, r.survived);
        }
        for hazard in Hazard::ALL {
            let (orders, messages) = bench.killed(Forget::All(hazard), &right);
            println!("all of {hazard:?} alone: {orders} of {} orders changed bits, {messages} messages", ORDERS.len());
        }
        let (orders, messages) = bench.killed(Forget::Carried, &right);
        println!("carried over: {orders} of {} orders changed bits, {messages} messages", ORDERS.len());
    }
}
