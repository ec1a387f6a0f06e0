//! How to open a device, and the variables of the environment that programs and tests let speak for these options.

use super::descriptors::Descriptors;
use super::error::Error;
use super::harness::Harness;
use super::tuning::TuningChoice;
use std::path::PathBuf;
use std::str::FromStr;

/// How to open a device. The default is the best device there is; [`DeviceOptions::from_env`] lets the environment choose.
#[derive(Clone, Debug, Default)]
pub struct DeviceOptions {
    /// Index, part of the name, `uuid:UUID`, `pci:ADDRESS`, or `free` for one that no other process holds by a lease; else
    /// the best there is.
    pub device: Option<String>,
    /// Switch the validation layers on.
    pub validation: bool,
    /// Bytes of device memory that this program may use; where absent, what is free of a GPU's memory (all of it where the
    /// driver does not tell), and all of a CPU device's.
    pub memory_limit: Option<u64>,
    /// The tuning; else the one stored for this device ([`super::Device::store_tuning`]); else the row of its own class.
    pub tuning: Option<TuningChoice>,
    /// How kernels get their buffers; else the best way that the device has.
    pub descriptors: Option<Descriptors>,
    /// The folder of leases, by which processes share the devices of a machine; else one in the system's temporary folder.
    pub leases: Option<PathBuf>,
    /// Make pipelines and run nothing, to learn what the driver's compiler makes of them: see [`super::Device::compiled`]. All
    /// reads give zeros.
    pub compile_only: bool,
    /// What only tests ask of a device.
    #[doc(hidden)]
    pub harness: Harness,
}

impl DeviceOptions {
    /// The options that the environment asks for: `QIRF_DEVICE`, `QIRF_VALIDATION`, `QIRF_TUNING` (empty: the row of the device's
    /// own class), `QIRF_DESCRIPTORS`, `QIRF_LEASES`, and for tests `QIRF_LIMITS`, `QIRF_SUBGROUP`, `QIRF_SHADERS`,
    /// `QIRF_DEVICE_FAULT` and `QIRF_ORDER`.
    ///
    /// # Errors
    /// [`Error::Variable`] for a text that its variable cannot have.
    pub fn from_env() -> Result<Self, Error> {
        let empty = std::env::var("QIRF_TUNING").is_ok_and(|text| text.is_empty());
        Ok(Self {
            device: text("QIRF_DEVICE"),
            validation: text("QIRF_VALIDATION").is_some_and(|text| text != "0"),
            memory_limit: None,
            tuning: if empty { Some(TuningChoice::default()) } else { parsed("QIRF_TUNING")? },
            descriptors: parsed("QIRF_DESCRIPTORS")?,
            leases: text("QIRF_LEASES").map(PathBuf::from),
            compile_only: false,
            harness: Harness {
                limits: parsed("QIRF_LIMITS")?,
                claim: parsed("QIRF_SUBGROUP")?,
                shaders: text("QIRF_SHADERS").map(PathBuf::from),
                guarded: false,
                fault: parsed("QIRF_DEVICE_FAULT")?,
                order: parsed("QIRF_ORDER")?,
            },
        })
    }
}

/// A variable's text, unless it is empty.
fn text(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|text| !text.is_empty())
}

/// The value of a variable's text.
fn parsed<T: FromStr<Err = String>>(name: &'static str) -> Result<Option<T>, Error> {
    let Some(text) = text(name) else { return Ok(None) };
    text.parse().map(Some).map_err(|what| Error::Variable { name, text, what })
}
