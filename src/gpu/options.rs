//! Options for opening a device, and the environment variables from which programs and tests take them.

use super::descriptors::Descriptors;
use super::error::Error;
use super::harness::Harness;
use super::tuning::choice::TuningChoice;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

/// Options for opening a device. The default is the best device present; [`DeviceOptions::from_env`] lets the
/// environment choose.
#[derive(Clone, Debug, Default)]
pub struct DeviceOptions {
    /// Index, part of the name, `uuid:UUID`, `pci:ADDRESS`, or `free` for one that no other process holds by a lease.
    /// Default: the best device present.
    pub device: Option<String>,
    /// True to enable the validation layers.
    pub validation: bool,
    /// Bytes of device memory that this program may use. Default: the free memory of a GPU (all of it if the driver
    /// does not report it), and all memory of a CPU device.
    pub memory_limit: Option<u64>,
    /// The tuning. Default: the one stored for this device ([`super::Device::store_tuning`]), else its class's row.
    pub tuning: Option<TuningChoice>,
    /// The way to bind buffers to kernels. Default: the best one that the device has.
    pub descriptors: Option<Descriptors>,
    /// The folder of leases, by which processes share a machine's devices. Default: one in the system's temporary
    /// folder.
    pub leases: Option<PathBuf>,
    /// The longest time of one submission: recordings are cut where kernels would take longer, by their last times. For
    /// slow devices on systems that reset a busy driver. Default: 1 s for GPUs on Windows; elsewhere each
    /// recording is one submission.
    pub max_submission: Option<Duration>,
    /// True to create pipelines and run nothing, to learn how the driver compiles them: see
    /// [`super::Device::compiled`]. All reads return zeros.
    pub compile_only: bool,
    /// Options for tests only.
    #[doc(hidden)]
    pub harness: Harness,
}

impl DeviceOptions {
    /// The options that the environment sets: `QIRF_DEVICE`, `QIRF_VALIDATION`, `QIRF_TUNING` (empty: the row of the
    /// device's own class), `QIRF_DESCRIPTORS`, `QIRF_LEASES`, `QIRF_MAX_SUBMISSION` (milliseconds), and for tests `QIRF_LIMITS`, `QIRF_SUBGROUP`,
    /// `QIRF_SHADERS`, `QIRF_DEVICE_FAULT` and `QIRF_ORDER`.
    ///
    /// # Errors
    /// [`Error::Variable`] for an invalid text.
    pub fn from_env() -> Result<Self, Error> {
        let empty = std::env::var("QIRF_TUNING").is_ok_and(|text| text.is_empty());
        Ok(Self {
            device: text("QIRF_DEVICE"),
            validation: text("QIRF_VALIDATION").is_some_and(|text| text != "0"),
            memory_limit: None,
            tuning: if empty { Some(TuningChoice::default()) } else { parsed("QIRF_TUNING")? },
            descriptors: parsed("QIRF_DESCRIPTORS")?,
            leases: text("QIRF_LEASES").map(PathBuf::from),
            max_submission: parsed::<Milliseconds>("QIRF_MAX_SUBMISSION")?.map(|ms| ms.0),
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

/// A time as the command line and the environment have it.
#[derive(Clone, Copy, Debug)]
pub struct Milliseconds(pub Duration);

impl FromStr for Milliseconds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = text.parse::<u32>().ok().filter(|ms| *ms > 0);
        let ms = number.ok_or_else(|| "give whole milliseconds, such as 500".to_owned())?;
        Ok(Self(Duration::from_millis(ms.into())))
    }
}

/// A variable's text, unless it is empty.
fn text(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|text| !text.is_empty())
}

/// The value parsed from a variable's text.
fn parsed<T: FromStr<Err = String>>(name: &'static str) -> Result<Option<T>, Error> {
    let Some(text) = text(name) else { return Ok(None) };
    text.parse().map(Some).map_err(|what| Error::Variable { name, text, what })
}
