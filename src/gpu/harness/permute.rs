//! Permutes the commands of a recording: see [`super::Order`].

use super::order::{Derived, Disorder, Forget};
use crate::gpu::context::Context;
use crate::gpu::hazards::{Barrier, Hazard, Hazards};
use crate::gpu::pipeline::Pipeline;
use crate::gpu::recording::{Command, Recording};
use crate::lock::lock;
use std::mem::take;
use std::sync::Arc;

type Step = (Command, Option<Arc<Pipeline>>);

impl Disorder {
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
