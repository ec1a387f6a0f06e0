//! Forked processes, in which the engine's threads do not exist: work is refused there, and devices are left as they are, instead of
//! waiting without end.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, Ordering};

/// True once this process has asked the engine for work, which starts its threads.
static USED: AtomicBool = AtomicBool::new(false);
/// True in a child that was forked after that.
static FORKED: AtomicBool = AtomicBool::new(false);

/// Called by Python in every forked child.
#[pyfunction]
fn forked() {
    if USED.load(Ordering::Relaxed) {
        FORKED.store(true, Ordering::Relaxed);
    }
}

/// Lets Python tell of forks, where there are any.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let os = module.py().import("os")?;
    if !os.hasattr("register_at_fork")? {
        return Ok(());
    }
    let options = pyo3::types::PyDict::new(module.py());
    options.set_item("after_in_child", wrap_pyfunction!(forked, module)?)?;
    os.call_method("register_at_fork", (), Some(&options)).map(drop)
}

/// Refuses work in a forked child.
pub fn check() -> PyResult<()> {
    if FORKED.load(Ordering::Relaxed) {
        return Err(PyRuntimeError::new_err(
            "this process was forked after qirf_vk had started threads, which do not exist in it: start processes with \
             multiprocessing.get_context(\"spawn\")",
        ));
    }
    USED.store(true, Ordering::Relaxed);
    Ok(())
}

/// What has a device behind it: a forked child does not drop it, which would wait for the device without end. The parent does.
pub struct Kept<T>(ManuallyDrop<T>);

impl<T> Kept<T> {
    pub fn new(value: T) -> Self {
        Self(ManuallyDrop::new(value))
    }
}

impl<T> Deref for Kept<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T> Drop for Kept<T> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        if FORKED.load(Ordering::Relaxed) {
            return;
        }
        // SAFETY: the value is dropped here and nowhere else, and nobody uses it afterwards.
        unsafe { ManuallyDrop::drop(&mut self.0) }
    }
}

/// Work of the engine, during which other Python threads run.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    check()?;
    Ok(py.detach(work))
}
