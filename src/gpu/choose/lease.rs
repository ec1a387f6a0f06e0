//! Leases of devices: a locked file for each device that a process of `--device free` holds.
//!
//! The lock belongs to the open file and is released when the process ends, however it ends.

use crate::gpu::info::DeviceInfo;
use crate::lock::{Attempt, attempt};
use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// A device that this process holds.
pub(in crate::gpu) struct Lease {
    /// Closing it releases the lock.
    _file: File,
}

impl Lease {
    /// Takes the lease called `name` in `folder`; `None` if another process holds it.
    pub fn take(folder: &Path, name: &str) -> io::Result<Option<Self>> {
        make_folder(folder)?;
        let file = open(&folder.join(name))?;
        match attempt(&file)? {
            Attempt::Locked => Ok(Some(Self { _file: file })),
            Attempt::Busy => Ok(None),
            Attempt::WithoutLocks => {
                Err(io::Error::new(io::ErrorKind::Unsupported, "the file system does not support locks"))
            }
        }
    }
}

/// The folder of leases in the system's temporary folder.
pub(in crate::gpu) fn folder() -> PathBuf {
    std::env::temp_dir().join("qirf-vk-leases")
}

/// The name of a device's lease on this machine: machines may share a temporary folder.
pub(in crate::gpu) fn name(info: &DeviceInfo, machine: &str) -> String {
    let device = match (info.pci, info.uuid) {
        (Some(pci), _) => pci.to_string(),
        (None, Some(uuid)) => format!("{uuid}-{}", info.index),
        (None, None) => info.index.to_string(),
    };
    format!("{machine}-{device}.lock").replace(|c: char| !c.is_ascii_alphanumeric() && !".-".contains(c), "-")
}

/// The name of this machine; empty if the system does not report it.
pub(in crate::gpu) fn machine() -> String {
    let told = fs::read_to_string("/proc/sys/kernel/hostname").ok().or_else(|| std::env::var("COMPUTERNAME").ok());
    told.map(|name| name.trim().to_owned()).unwrap_or_default()
}

/// Creates a folder in which all users may create files, as in the temporary folder.
fn make_folder(folder: &Path) -> io::Result<()> {
    folder.parent().map_or(Ok(()), fs::create_dir_all)?;
    match fs::create_dir(folder) {
        #[cfg(unix)]
        Ok(()) => fs::set_permissions(folder, std::os::unix::fs::PermissionsExt::from_mode(0o1777)),
        // Perhaps another user's, who alone may change its permissions.
        Err(_) if folder.is_dir() => Ok(()),
        made => made,
    }
}

/// Opens a file for its lock alone: for writing, because NFS needs that; for reading if the file is another user's.
fn open(path: &Path) -> io::Result<File> {
    match OpenOptions::new().write(true).open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            OpenOptions::new().write(true).create(true).truncate(false).open(path)
        }
        Err(error) if matches!(error.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem) => {
            File::open(path)
        }
        opened => opened,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_has_one_holder_and_ends_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("leases");
        let take = |name: &str| Lease::take(&folder, name).unwrap();
        let held = take("a.lock").expect("nobody has it");
        assert!(take("a.lock").is_none() && take("b.lock").is_some());
        drop(held);
        assert!(take("a.lock").is_some(), "the file stays, the lock does not");
        assert!(Lease::take(&folder.join("a.lock"), "a").is_err());
    }
}
