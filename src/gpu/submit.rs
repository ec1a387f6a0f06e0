//! Submitting a recording, and waiting for it.

use super::buffer::Buffer;
use super::device::{Context, Device, lock};
use super::encode::{Encoder, Scope};
use super::error::{During, Error};
use super::frame::Frame;
use super::pipeline::Pipeline;
use super::profiler::Timings;
use super::recording::Recording;
use ash::vk;
use bytemuck::Pod;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Pending work. Dropping it waits.
pub struct Ticket {
    context: Arc<Context>,
    frame: Option<Frame>,
    scopes: Vec<Scope>,
    _recording: Recording, // keeps the buffers alive
    _pipelines: Vec<Arc<Pipeline>>,
}

impl Device {
    /// Submits a recording and waits for it.
    ///
    /// # Errors
    /// Device errors.
    pub fn run(&self, recording: Recording) -> Result<Timings, Error> {
        let ticket = self.submit(recording)?;
        self.context().counters.round_trips.fetch_add(1, Ordering::Relaxed);
        ticket.wait()
    }

    /// A buffer of `len` elements whose bytes are zero.
    ///
    /// # Errors
    /// Errors of [`Device::buffer`]; device errors.
    pub fn zeros<T: Pod>(&self, name: &str, len: usize) -> Result<Buffer<T>, Error> {
        let buffer = self.buffer(name, len)?;
        let mut recording = Recording::new();
        recording.fill(&buffer, 0);
        self.run(recording)?;
        Ok(buffer)
    }

    /// Submits a recording. Recordings run in the order of their submission.
    ///
    /// # Errors
    /// Device errors.
    pub fn submit(&self, mut recording: Recording) -> Result<Ticket, Error> {
        let context = self.context();
        context.counters.submissions.fetch_add(1, Ordering::Relaxed);
        if context.queue.is_lost() {
            return Err(Error::Lost("queue submit")); // resources that a lost device still holds are never touched again
        }
        if context.disorder.is_some() {
            recording.loosen();
        }
        // Pipelines first: hazards must not advance for a recording that is never submitted.
        let mut pipelines = context.pipelines.of(context, &recording)?;
        if context.compile_only {
            let (context, scopes) = (Arc::clone(context), Vec::new());
            return Ok(Ticket { context, frame: None, scopes, _recording: recording, _pipelines: pipelines });
        }
        let room = context.binder.room(&recording);
        let frame = Frame::take(context, recording.scopes() as u32 * 2, room)?;
        // The queue's lock covers deriving barriers and submitting, so that barriers match the true order of
        // submissions.
        let queue = context.queue.lock();
        let barriers = context.ordered(&mut recording, &mut pipelines);
        let encoded = Encoder::new(context, &frame).encode(&recording, &barriers, &pipelines);
        let submitted = encoded.and_then(|scopes| {
            // SAFETY: the command buffer is complete, its buffers and pipelines are kept alive by the ticket, and the
            // queue is locked for the call.
            unsafe { context.queue.submit(&context.raw, *queue, frame.commands, frame.fence) }
                .during("queue submit")?;
            Ok(scopes)
        });
        if submitted.is_err() {
            lock(&context.hazards).doubt();
        }
        drop(queue);
        match submitted {
            Ok(scopes) => Ok(Ticket {
                context: Arc::clone(context),
                frame: Some(frame),
                scopes,
                _recording: recording,
                _pipelines: pipelines,
            }),
            Err(e) => {
                lock(&context.frames).push(frame); // never submitted: there is nothing to wait for
                Err(e)
            }
        }
    }
}

impl Ticket {
    /// Waits for the work and returns the time of its scopes.
    ///
    /// # Errors
    /// Device errors.
    pub fn wait(mut self) -> Result<Timings, Error> {
        self.finish()
    }

    fn finish(&mut self) -> Result<Timings, Error> {
        let Some(frame) = self.frame.take() else { return Ok(Timings::default()) };
        let timings = self.timings(&frame);
        // Its work is finished or lost: the next submission reuses it, or the context destroys it.
        lock(&self.context.frames).push(frame);
        timings
    }

    fn timings(&self, frame: &Frame) -> Result<Timings, Error> {
        let (device, queue) = (&self.context.raw, &self.context.queue);
        // SAFETY: the fence was submitted with this frame's work.
        unsafe { queue.wait(device, frame.fence) }.during("wait for the device")?;
        let mut timings = Timings::default();
        let period = f64::from(self.context.info.timestamp_period) * 1e-9;
        let queries = self.scopes.iter().map(|scope| scope.begin.max(scope.end) as usize + 1).max();
        if let Some(queries) = queries.filter(|_| period > 0.0) {
            let mut ticks = vec![0_u64; queries];
            // SAFETY: the queries were all written, since the fence has signalled.
            let read =
                unsafe { device.get_query_pool_results(frame.queries, 0, &mut ticks, vk::QueryResultFlags::TYPE_64) };
            queue.answered(read).during("read timestamps")?;
            for scope in &self.scopes {
                let span = ticks[scope.end as usize].saturating_sub(ticks[scope.begin as usize]);
                timings.add(scope.name, span as f64 * period);
            }
        }
        Ok(timings)
    }
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
