//! Devices.

use crate::errors::{number, raised, some_whole};
use crate::fork::{Kept, detached};
use engine::gpu::{self, DeviceOptions};
use engine::job::Error;
use pyo3::exceptions::PyOverflowError;
use pyo3::prelude::*;

/// A Vulkan device by its index, a part of its name, "uuid:..." or "pci:..."; by default $QIRF_DEVICE, else the best device.
///
/// memory_limit: limit on the bytes in use; by default the free memory of a GPU. Raises DeviceError.
#[pyclass(frozen, weakref, module = "qirf_vk")]
pub struct Device {
    inner: Kept<gpu::Device>,
}

/// A device's index, or a text.
struct Name(String);

impl<'py> FromPyObject<'_, 'py> for Name {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        match object.extract::<i64>() {
            Ok(index) => Ok(Self(index.to_string())),
            // No device has an index beyond 64 bits, and the error says so.
            Err(e) if e.is_instance_of::<PyOverflowError>(object.py()) => Ok(Self(object.str()?.extract()?)),
            Err(_) => object.extract().map(Self),
        }
    }
}

#[pymethods]
impl Device {
    /// Opens a device: by its index, a part of its name, "uuid:..." or "pci:...", else $QIRF_DEVICE, else the best there is.
    #[new]
    #[pyo3(signature = (name=None, *, memory_limit=None), text_signature = "(name=None, *, memory_limit=None)")]
    fn new(
        py: Python<'_>,
        name: Option<Name>,
        #[pyo3(from_py_with = some_whole)] memory_limit: Option<i64>,
    ) -> PyResult<Self> {
        let memory_limit = memory_limit.map(|bytes| number("memory_limit", bytes, 1)).transpose()?;
        let options = DeviceOptions::from_env().map_err(|e| raised(Error::from(e)))?;
        let options = DeviceOptions { device: name.map(|name| name.0).or(options.device), memory_limit, ..options };
        let inner = detached(py, || gpu::Device::open(&options))?.map_err(|e| raised(Error::from(e)))?;
        Ok(Self { inner: Kept::new(inner) })
    }

    /// Names of all devices, in the order of their indices.
    #[staticmethod]
    fn list(py: Python<'_>) -> PyResult<Vec<String>> {
        let all = detached(py, gpu::list)?.map_err(|e| raised(Error::from(e)))?;
        Ok(all.into_iter().map(|info| info.name).collect())
    }

    /// Its name, as the driver gives it.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.info().name
    }

    /// Bytes in its buffers now.
    #[getter]
    fn memory_used(&self) -> u64 {
        self.inner.memory_used().0
    }

    /// Bytes that may be used.
    #[getter]
    fn memory_limit(&self) -> u64 {
        self.inner.memory_limit()
    }

    fn __repr__(&self) -> String {
        format!("Device({:?})", self.name())
    }
}

/// The device of a job: the one given, else the usual one.
pub fn or_usual(py: Python<'_>, device: Option<&Bound<'_, Device>>) -> PyResult<gpu::Device> {
    match device {
        Some(device) => Ok(gpu::Device::clone(&device.get().inner)),
        None => Device::new(py, None, None).map(|device| gpu::Device::clone(&device.inner)),
    }
}
