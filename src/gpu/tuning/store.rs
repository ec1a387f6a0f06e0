//! The fastest tuning measured on a device, stored in the cache folder for later runs.

use crate::gpu::cache;
use crate::gpu::device::Device;
use crate::gpu::info::DeviceInfo;
use crate::gpu::tuning::Tuning;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::{fs, io};

/// Contents of the file: the tuning, and the device and driver that it was measured on.
#[derive(Serialize, Deserialize)]
struct Stored {
    device: String,
    driver: String,
    tuning: Tuning,
}

/// The file of a device; `None` if the system has no cache folder.
fn file(info: &DeviceInfo) -> Option<PathBuf> {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let name: String = info.name.chars().map(plain).collect();
    dirs::cache_dir().map(|folder| folder.join("qirf-vk").join(format!("tuning-{name}.json")))
}

/// The tuning stored for a device; `None` if there is none, if it was measured with another driver, or if it does not
/// fit.
pub(in crate::gpu) fn read(info: &DeviceInfo) -> Option<Tuning> {
    let path = file(info)?;
    let text = fs::read_to_string(&path).ok()?;
    let stored = serde_json::from_str::<Stored>(&text).map_err(|e| e.to_string()).and_then(|stored| {
        let same = stored.device == info.name && stored.driver == info.driver;
        let same = if same { Ok(()) } else { Err(format!("it was measured on {}, {}", stored.device, stored.driver)) };
        same.and_then(|()| stored.tuning.check(info)).map(|()| stored.tuning)
    });
    stored.map_err(|e| tracing::warn!("{} is not used: {e}; `qirf-vk device --tune` replaces it", path.display())).ok()
}

impl Device {
    /// The tuning stored by an earlier [`Device::store_tuning`] for this device and driver.
    pub fn stored_tuning(&self) -> Option<Tuning> {
        read(self.info())
    }

    /// Stores a tuning for this device and driver: later devices opened without a tuning use it. Returns the file.
    ///
    /// # Errors
    /// No cache folder; a file that cannot be written.
    pub fn store_tuning(&self, tuning: &Tuning) -> io::Result<PathBuf> {
        let info = self.info();
        let path = file(info).ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no cache folder"))?;
        let (device, driver) = (info.name.clone(), info.driver.clone());
        let text = serde_json::to_string_pretty(&Stored { device, driver, tuning: tuning.clone() })?;
        cache::replace(&path, (text + "\n").as_bytes())?;
        Ok(path)
    }

    /// Removes the stored tuning, if any.
    pub fn forget_tuning(&self) -> io::Result<()> {
        match file(self.info()).map(fs::remove_file) {
            Some(Err(e)) if e.kind() != io::ErrorKind::NotFound => Err(e),
            _ => Ok(()),
        }
    }
}
