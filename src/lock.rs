//! Locks: of values, which a panic elsewhere does not spoil, and of files, which the system releases when a process ends,
//! however it ends.

use fs4::{FileExt, TryLockError};
use std::fs::File;
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, poisoned or not. Poisoning only means that another thread panicked; the guarded values are valid
/// after every step.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Result of an attempt to lock a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// It is locked until its handle is dropped.
    Locked,
    /// Another handle holds the lock, usually that of another process.
    Busy,
    /// The file system has no locks.
    WithoutLocks,
}

/// Tries to lock a file. It must be open for writing: NFS refuses to lock a file that is only open for reading.
///
/// # Errors
/// Errors of the system, except those that [`Attempt`] describes.
pub fn attempt(file: &File) -> io::Result<Attempt> {
    match FileExt::try_lock(file) {
        Ok(()) => Ok(Attempt::Locked),
        Err(TryLockError::WouldBlock) => Ok(Attempt::Busy),
        Err(TryLockError::Error(error)) if is_without_locks(&error) => Ok(Attempt::WithoutLocks),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Returns true for the errors of file systems without locks: an operation that is not supported, or, on NFS without a
/// lock daemon, ENOLCK, for which the standard library has no kind.
fn is_without_locks(error: &io::Error) -> bool {
    let no_locks = if cfg!(any(target_os = "linux", target_os = "android")) { 37 } else { 77 };
    error.kind() == io::ErrorKind::Unsupported || cfg!(unix) && error.raw_os_error() == Some(no_locks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_locked_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let [first, second] =
            [(); 2].map(|()| File::options().write(true).create(true).truncate(false).open(&path).unwrap());
        assert_eq!([&first, &second].map(|file| attempt(file).unwrap()), [Attempt::Locked, Attempt::Busy]);
        drop(first);
        assert_eq!(attempt(&second).unwrap(), Attempt::Locked);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn file_systems_without_locks_are_known_by_their_errors() {
        // ENOLCK and ENOSYS; EBADF and EIO are errors.
        let without = [37, 38, 9, 5].map(|code| is_without_locks(&io::Error::from_raw_os_error(code)));
        assert_eq!(without, [true, true, false, false]);
    }
}
