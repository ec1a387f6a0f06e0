//! Follows a job for Python: callbacks, Ctrl-C, and notes in the log.

use crate::arrays::dictionary;
use engine::job::Watcher;
use engine::job::run_log::LogLine;
use engine::train::Progress;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Time between two looks for Ctrl-C.
const EVERY: Duration = Duration::from_millis(100);

/// Follows a job.
pub struct Follower {
    on_step: Option<Py<PyAny>>,
    on_progress: Option<Py<PyAny>>,
    /// The first exception, which ends the job.
    raised: Mutex<Option<PyErr>>,
    looked: Mutex<Instant>,
}

impl Follower {
    pub fn new(on_step: Option<Py<PyAny>>, on_progress: Option<Py<PyAny>>) -> Self {
        Self { on_step, on_progress, raised: Mutex::new(None), looked: Mutex::new(Instant::now()) }
    }

    /// The job's outcome; the callback's own exception comes first, even if the job was done by then.
    pub fn result<T>(&self, result: Result<T, engine::job::Error>) -> PyResult<T> {
        match self.raised.lock().map(|mut raised| raised.take()) {
            Ok(Some(exception)) => Err(exception),
            _ => result.map_err(crate::errors::raised),
        }
    }

    fn keep(&self, result: PyResult<()>) {
        if let (Err(exception), Ok(mut raised)) = (result, self.raised.lock()) {
            raised.get_or_insert(exception);
        }
    }

    fn progress(&self, stage: &str, done: usize, total: usize) {
        if let Some(callback) = &self.on_progress {
            self.keep(Python::attach(|py| callback.call1(py, (stage, done, total)).map(|_| ())));
        }
    }
}

impl Watcher for Follower {
    fn loading(&self, done: usize, total: usize) {
        self.progress("photos", done, total);
    }
    fn training(&self, progress: &Progress, until: u32) {
        self.progress("training", progress.iteration as usize, until as usize);
    }
    fn logged(&self, line: &LogLine) {
        if let Some(callback) = &self.on_step {
            self.keep(Python::attach(|py| callback.call1(py, (dictionary(py, line)?,)).map(|_| ())));
        }
    }
    fn responding(&self, done: usize, total: usize) {
        self.progress("responses", done, total);
    }
    fn evaluating(&self, done: usize, total: usize) {
        self.progress("scores", done, total);
    }
    fn trying(&self, done: usize, total: usize) {
        self.progress("files", done, total);
    }
    fn note(&self, line: &str) {
        Python::attach(|py| {
            let write = || -> PyResult<()> {
                let logger = py.import("logging")?.call_method1("getLogger", ("qirf_vk",))?;
                logger.call_method1("info", ("%s", line)).map(|_| ())
            };
            // A log that cannot be written ends no job; a Ctrl-C that arrives meanwhile does.
            self.keep(write().or_else(|e| if e.is_instance_of::<PyException>(py) { Ok(()) } else { Err(e) }));
        });
    }
    fn stop(&self) -> bool {
        if let Ok(mut looked) = self.looked.try_lock()
            && looked.elapsed() >= EVERY
        {
            *looked = Instant::now();
            #[expect(clippy::redundant_closure_for_method_calls, reason = "the method alone has one lifetime, not any")]
            let heard = Python::attach(|py| py.check_signals());
            self.keep(heard);
        }
        self.raised.lock().is_ok_and(|raised| raised.is_some())
    }
}
