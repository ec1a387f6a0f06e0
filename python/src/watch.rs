//! Follows a job for Python. The job runs in a thread of its own; the thread that called waits for it, calls the callbacks, writes notes to
//! the log, and looks for Ctrl-C.

use crate::arrays::loads;
use crate::errors::{raised, warn};
use crate::fork;
use crate::words::in_python;
use engine::job::run_log::LogLine;
use engine::job::{Error, Stage, Watcher};
use engine::scene::Skipped;
use engine::train::Progress;
use pyo3::exceptions::{PyException, PyTypeError};
use pyo3::prelude::*;
use std::panic::resume_unwind;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Time between two looks for Ctrl-C, and between two counts of loaded photos.
const EVERY: Duration = Duration::from_millis(100);
/// Bytes of the job's stack: those of a main thread.
const STACK: usize = 8 << 20;

/// The functions of Python that follow a job.
#[derive(Default)]
pub struct Callbacks {
    /// Gets a line of the log.
    pub on_step: Option<Py<PyAny>>,
    /// Gets a stage, the steps done and their total.
    pub on_progress: Option<Py<PyAny>>,
}

enum News {
    Progress(&'static str, usize, usize),
    /// A line of the log, as JSON.
    Step(String),
    /// A line for the log, and its level.
    Note(&'static str, String),
}

/// News, and what is dropped when Python has heard it.
type Letter = (News, Sender<()>);

/// Photos loaded, and their total.
#[derive(Clone, Copy, Default)]
struct Loaded {
    done: usize,
    total: usize,
    /// The number that Python was told.
    told: usize,
}

/// State that the job's threads share with the one that waits.
#[derive(Default)]
struct Shared {
    loaded: Mutex<Loaded>,
    /// True once the job has to end.
    ended: AtomicBool,
}

impl Shared {
    fn loaded(&self) -> MutexGuard<'_, Loaded> {
        self.loaded.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The job's side.
struct Reporter<'a> {
    shared: &'a Shared,
    letters: Sender<Letter>,
    steps: bool,
    progress: bool,
}

impl Reporter<'_> {
    /// Tells Python, and waits until it has heard.
    fn tell(&self, news: News) {
        let (heard, wait) = mpsc::channel();
        if self.letters.send((news, heard)).is_ok() {
            // Nothing is sent: the other end is dropped.
            let _ = wait.recv();
        }
    }

    fn count(&self, stage: &'static str, done: usize, total: usize) {
        if self.progress {
            self.tell(News::Progress(stage, done, total));
        }
    }
}

impl Watcher for Reporter<'_> {
    fn progress(&self, stage: Stage, done: usize, total: usize) {
        if stage != Stage::Photos {
            return self.count(stage.name(), done, total);
        }
        // Threads that load photos do not wait for Python: it is told the latest count.
        let mut loaded = self.shared.loaded();
        if done > loaded.done {
            (loaded.done, loaded.total) = (done, total);
        }
    }
    fn training(&self, progress: &Progress, until: u32) {
        self.count("training", progress.iteration as usize, until as usize);
    }
    fn logged(&self, line: &LogLine) {
        if self.steps
            && let Ok(line) = serde_json::to_string(line)
        {
            self.tell(News::Step(line));
        }
    }
    fn note(&self, line: &str) {
        self.tell(News::Note("info", in_python(line)));
    }
    fn lost(&self, line: &str) {
        self.tell(News::Note("warning", in_python(line)));
    }
    fn stop(&self) -> bool {
        self.shared.ended.load(Ordering::Relaxed)
    }
}

/// The side of the thread that called.
struct Listener<'a> {
    callbacks: Callbacks,
    shared: &'a Shared,
    /// The first exception, which ends the job.
    raised: Option<PyErr>,
    looked: Instant,
    /// The stage that was told of last, and its count.
    told: (&'static str, usize),
}

impl Listener<'_> {
    /// Hears the job's news until it is done.
    fn listen(&mut self, letters: Receiver<Letter>) {
        loop {
            match letters.recv_timeout(EVERY) {
                Ok((news, heard)) => {
                    self.hear_of_photos();
                    // A later set of photos is counted anew.
                    *self.shared.loaded() = Loaded::default();
                    self.hear(&news);
                    drop(heard);
                }
                Err(RecvTimeoutError::Timeout) => self.hear_of_photos(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self.looked.elapsed() >= EVERY {
                self.looked = Instant::now();
                #[expect(clippy::redundant_closure_for_method_calls, reason = "the method has one lifetime, not any")]
                self.keep(Python::attach(|py| py.check_signals()));
            }
        }
        self.hear_of_photos();
    }

    fn keep(&mut self, result: PyResult<()>) {
        if let Err(exception) = result {
            self.raised.get_or_insert(exception);
            self.shared.ended.store(true, Ordering::Relaxed);
        }
    }

    fn hear_of_photos(&mut self) {
        let Loaded { done, total, told } = *self.shared.loaded();
        if done > told {
            self.shared.loaded().told = done;
            self.hear(&News::Progress("photos", done, total));
        }
    }

    /// The count of a stage and its total, raised to the last count if it is less: stages such as searches end early or begin anew.
    fn rising(&mut self, stage: &'static str, done: usize, total: usize) -> (usize, usize) {
        let least = if self.told.0 == stage { self.told.1 } else { 0 };
        let risen = done.max(least);
        self.told = (stage, risen);
        (risen, if done == total { risen } else { total.max(risen) })
    }

    fn hear(&mut self, news: &News) {
        if self.raised.is_some() {
            return;
        }
        let (done, total) = match news {
            News::Progress(stage, done, total) => self.rising(stage, *done, *total),
            News::Step(_) | News::Note(..) => (0, 0),
        };
        let heard = Python::attach(|py| match (news, &self.callbacks) {
            (News::Progress(stage, ..), Callbacks { on_progress: Some(callback), .. }) => {
                callback.call1(py, (*stage, done, total)).map(drop)
            }
            (News::Step(line), Callbacks { on_step: Some(callback), .. }) => {
                callback.call1(py, (loads(py, line)?,)).map(drop)
            }
            (News::Note(level, line), _) => log(py, level, line),
            _ => Ok(()),
        });
        self.keep(heard);
    }
}

/// Writes a line to the log, at a level such as "info". A log that cannot be written is no error; a Ctrl-C that arrives meanwhile is.
pub fn log(py: Python<'_>, level: &str, line: &str) -> PyResult<()> {
    let logger = py.import("logging").and_then(|logging| logging.call_method1("getLogger", ("qirf_vk",)));
    match logger.and_then(|logger| logger.call_method1(level, ("%s", line))) {
        Err(exception) if !exception.is_instance_of::<PyException>(py) => Err(exception),
        _ => Ok(()),
    }
}

/// Warns of what the readers of a scene left out, and writes their choices to the log.
pub fn tell_skipped(py: Python<'_>, scene: &Path, skipped: &Skipped) -> PyResult<()> {
    let told = |line: &str| format!("{}: {}", scene.display(), in_python(line));
    for line in skipped.losses() {
        warn(py, &told(&line))?;
    }
    for line in skipped.chosen() {
        log(py, "info", &told(&line))?;
    }
    Ok(())
}

/// The result of a job, which gets its watcher. The exception of a callback comes first, even if the job was done by then.
pub fn followed<T: Send>(
    py: Python<'_>,
    callbacks: Callbacks,
    job: impl FnOnce(&(dyn Watcher + Sync)) -> Result<T, Error> + Send,
) -> PyResult<T> {
    fork::check()?;
    for (name, callback) in [("on_step", &callbacks.on_step), ("on_progress", &callbacks.on_progress)] {
        if callback.as_ref().is_some_and(|callback| !callback.bind(py).is_callable()) {
            return Err(PyTypeError::new_err(format!("{name} should be a function")));
        }
    }
    let shared = Shared::default();
    let (letters, inbox) = mpsc::channel();
    let (steps, progress) = (callbacks.on_step.is_some(), callbacks.on_progress.is_some());
    let reporter = Reporter { shared: &shared, letters, steps, progress };
    let mut listener = Listener { callbacks, shared: &shared, raised: None, looked: Instant::now(), told: ("", 0) };
    let listening = &mut listener;
    let done = py.detach(|| {
        // The inbox ends with the listening, even by a panic: the job must not wait for an answer then.
        thread::scope(move |scope| {
            let work = move || job(&reporter);
            let worker =
                thread::Builder::new().name("qirf_vk".to_owned()).stack_size(STACK).spawn_scoped(scope, work)?;
            listening.listen(inbox);
            Ok::<_, std::io::Error>(worker.join().unwrap_or_else(|panic| resume_unwind(panic)))
        })
    });
    match listener.raised {
        Some(exception) => Err(exception),
        None => done?.map_err(raised),
    }
}
