//! Submitting a recording, and waiting for it.

use super::buffer::Buffer;
use super::context::Context;
use super::device::Device;
use super::encode::{Encoded, Encoder, Scope};
use super::error::{During, Error};
use super::frame::Frame;
use super::pace::Work;
use super::pipeline::Pipeline;
use super::profiler::Timings;
use super::recording::Recording;
use crate::lock::lock;
use ash::vk;
use bytemuck::Pod;
use std::sync::Arc;

/// Pending work. Dropping it waits.
pub struct Ticket {
    context: Arc<Context>,
    frame: Option<Frame>,
    scopes: Vec<Scope>,
    /// The dispatches of each submission, where submissions are limited.
    dispatches: Vec<Vec<(Work, Scope)>>,
    _recording: Recording, // keeps the buffers alive
    _pipelines: Vec<Arc<Pipeline>>,
}

impl Device {
    /// Submits a recording and waits for it.
    pub fn run(&self, recording: Recording) -> Result<Timings, Error> {
        if self.counted().is_some() {
            return Ok(Timings::default());
        }
        let ticket = self.submit(recording)?;
        lock(&self.context().traffic).round_trips += 1;
        ticket.wait()
    }

    /// A buffer of `len` elements whose bytes are zero.
    pub fn zeros<T: Pod>(&self, name: &str, len: usize) -> Result<Buffer<T>, Error> {
        let buffer = self.buffer(name, len)?;
        let mut recording = Recording::new();
        recording.fill(&buffer, 0);
        self.run(recording)?;
        Ok(buffer)
    }

    /// Submits a recording. Recordings run in the order of their submission.
    pub fn submit(&self, mut recording: Recording) -> Result<Ticket, Error> {
        let context = self.context();
        if context.queue.is_lost() {
            return Err(Error::Lost("queue submit")); // resources that a lost device still holds are never touched again
        }
        if context.disorder.is_some() {
            recording.loosen();
        }
        // Pipelines first: hazards must not advance for a recording that is never submitted.
        let shaders = recording.dispatches().map(|d| (d.shader, recording.arguments.constants(d)));
        let mut pipelines = context.pipelines.of(&context.logical, shaders)?;
        if context.logical.compile_only {
            let (context, scopes, dispatches) = (Arc::clone(context), Vec::new(), Vec::new());
            return Ok(Ticket {
                context,
                frame: None,
                scopes,
                dispatches,
                _recording: recording,
                _pipelines: pipelines,
            });
        }
        let room = context.logical.binder.room(recording.dispatches().map(|d| d.shader.bindings.len()));
        let timed = recording.scopes() + if context.pace.is_some() { pipelines.len() } else { 0 };
        let mut frame = context.frames.take(&context.logical.raw, context.queue.family, timed as u32 * 2, room)?;
        // The queue's lock covers deriving barriers and submitting, so that barriers match the true order of
        // submissions.
        let queue = context.queue.lock();
        let barriers = context.ordered(&mut recording, &mut pipelines);
        let encoded = Encoder::new(context, &mut frame).encode(&recording, &barriers, &pipelines);
        let mut under_way = false;
        let submitted = encoded.and_then(|encoded| {
            let pieces = &frame.commands[..encoded.pieces];
            for (at, commands) in pieces.iter().enumerate() {
                // The last one's fence covers those before it.
                let fence = if at + 1 == pieces.len() { frame.fence } else { vk::Fence::null() };
                // SAFETY: the command buffer is complete, its buffers and pipelines are kept alive by the ticket, and
                // the queue is locked for the call.
                unsafe { context.queue.submit(&context.logical.raw, *queue, *commands, fence) }
                    .during("queue submit")?;
                lock(&context.traffic).submissions += 1;
                under_way = true;
            }
            Ok(encoded)
        });
        if submitted.is_err() {
            lock(&context.hazards).doubt();
        }
        drop(queue);
        match submitted {
            Ok(Encoded { scopes, dispatches, .. }) => Ok(Ticket {
                context: Arc::clone(context),
                frame: Some(frame),
                scopes,
                dispatches,
                _recording: recording,
                _pipelines: pipelines,
            }),
            Err(e) => {
                if under_way {
                    let _ = context.queue.idle(&context.logical.raw); // the error above says more
                }
                context.frames.give_back(frame); // nothing of it is under way
                Err(e)
            }
        }
    }
}

impl Ticket {
    /// Waits for the work and returns the time of its scopes.
    pub fn wait(mut self) -> Result<Timings, Error> {
        self.finish()
    }

    fn finish(&mut self) -> Result<Timings, Error> {
        let Some(frame) = self.frame.take() else { return Ok(Timings::default()) };
        let timings = self.timings(&frame);
        // Its work is finished or lost: the next submission reuses it, or the context destroys it.
        self.context.frames.give_back(frame);
        timings
    }

    fn timings(&self, frame: &Frame) -> Result<Timings, Error> {
        let context = &self.context;
        let (device, queue) = (&context.logical.raw, &context.queue);
        // SAFETY: the fence was submitted with this frame's work.
        unsafe { queue.wait(device, frame.fence) }.during("wait for the device")?;
        let mut timings = Timings::default();
        let period = f64::from(context.logical.info.timestamp_period) * 1e-9;
        let queries = self
            .scopes
            .iter()
            .chain(self.dispatches.iter().flatten().map(|(_, scope)| scope))
            .map(|scope| scope.begin.max(scope.end) as usize + 1)
            .max();
        if let Some(queries) = queries.filter(|_| period > 0.0) {
            let mut ticks = vec![0_u64; queries];
            // SAFETY: the queries were all written, since the fence has signalled.
            let read =
                unsafe { device.get_query_pool_results(frame.queries, 0, &mut ticks, vk::QueryResultFlags::TYPE_64) };
            match queue.answered(read) {
                Ok(()) => {}
                Err(e) if queue.is_lost() => return Err(e).during("read timestamps"),
                Err(e) => {
                    tracing::debug!("no times of this submission: {e}");
                    return Ok(timings);
                }
            }
            let seconds = |scope: &Scope| {
                elapsed(ticks[scope.begin as usize], ticks[scope.end as usize]).map(|ticks| ticks as f64 * period)
            };
            for scope in &self.scopes {
                if let Some(seconds) = seconds(scope) {
                    timings.add(scope.name, seconds);
                }
            }
            if let Some(pace) = &context.pace {
                for dispatches in &self.dispatches {
                    pace.learn(dispatches.iter().filter_map(|(work, scope)| Some((*work, seconds(scope)?))));
                }
            }
        }
        Ok(timings)
    }
}

/// Ticks between two timestamps; none if either is missing: MoltenVK leaves some at 0, though the work is done.
fn elapsed(begin: u64, end: u64) -> Option<u64> {
    end.checked_sub(begin).filter(|_| begin > 0)
}

impl Drop for Ticket {
    fn drop(&mut self) {
        // Only the first observer of a device loss reports it.
        let known = self.context.queue.is_lost();
        if let Err(e) = self.finish()
            && !known
        {
            tracing::error!("{e}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::elapsed;

    #[test]
    fn missing_timestamps_tell_nothing() {
        let cases = [((5, 7), Some(2)), ((5, 5), Some(0)), ((0, 7), None), ((5, 0), None), ((0, 0), None)];
        for ((begin, end), ticks) in cases {
            assert_eq!(elapsed(begin, end), ticks);
        }
    }
}
