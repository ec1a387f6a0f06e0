//! Writes files completely or not at all, and never over the input, a device or a pipe.

use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use super::Error;
use crate::checksum::crc32;
use crate::extension::folder_of;

/// Refuses an `output` that is the same file as `input`, or one in that folder, through any links.
///
/// # Errors
/// [`Error::SameFile`].
pub fn refuse_overwrite(input: &Path, output: &Path) -> Result<(), Error> {
    // Windows knows no final path on some drives, and Wine none of more than 260 characters.
    let canonical = |path: &Path| match fs::canonicalize(path) {
        Err(error) if !matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            std::path::absolute(path).ok()
        }
        real => real.ok(),
    };
    let (Some(from), Some(to)) = (canonical(input), canonical(output)) else { return Ok(()) };
    // A model in a folder is all files in it.
    if to.starts_with(&from) || same_inode(&from, &to) {
        return Err(Error::SameFile { path: output.to_owned() });
    }
    Ok(())
}

/// True if two existing paths are hard links to one file.
#[cfg(unix)]
fn same_inode(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    match (fs::metadata(a), fs::metadata(b)) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

#[cfg(not(unix))]
fn same_inode(_: &Path, _: &Path) -> bool {
    false
}

/// Writes `path` by way of a temporary file beside it: written, flushed to the disk, then renamed over `path`.
///
/// A crash or a full disk at any moment leaves the old file, or none, but never half of the new one.
///
/// # Errors
/// [`Error::NotAFile`]; [`Error::Io`]; the temporary file is removed.
pub fn write_atomically(path: &Path, body: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), Error> {
    refuse_device(path)?;
    let attempt = || -> io::Result<()> {
        let path = &behind_links(path)?;
        let (temporary, file) = create_beside(path)?;
        let written = fill(file, body).and_then(|()| fs::rename(&temporary, path));
        if written.is_err() {
            // The write's own error is the one to report; a leftover is harmless.
            let _ = fs::remove_file(&temporary);
        }
        written?;
        sync_folder(path);
        Ok(())
    };
    attempt().map_err(|source| Error::Io { path: path.to_owned(), source })
}

/// Refuses a `path` that [`write_atomically`] could not write, before any work is done for it, and removes what killed writers left.
///
/// # Errors
/// [`Error::NotAFile`]; [`Error::Io`] for a folder that is absent or not writable, or a name that the system does not allow.
pub fn check_place(path: &Path) -> Result<(), Error> {
    refuse_device(path)?;
    let attempt = || match fs::symlink_metadata(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => {
            let path = behind_links(path)?;
            remove_leftovers(&path);
            create_beside(&path).and_then(|(temporary, _)| fs::remove_file(temporary))
        }
    };
    attempt().map_err(|source| Error::Io { path: path.to_owned(), source })
}

/// Refuses what a rename would replace by a file: a device such as /dev/null, a pipe, a socket.
fn refuse_device(path: &Path) -> Result<(), Error> {
    match fs::metadata(path) {
        Ok(there) if !there.is_file() && !there.is_dir() => Err(Error::NotAFile { path: path.to_owned() }),
        _ => Ok(()),
    }
}

/// The file that a path leads to, there or not: a link, say to a larger disk, stays a link.
fn behind_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS {
        let Ok(target) = fs::read_link(&path) else { return Ok(path) };
        path = path.parent().unwrap_or(Path::new("")).join(target);
    }
    Err(io::Error::new(io::ErrorKind::InvalidFilename, "a chain of links without an end"))
}

/// Largest number of links that are followed.
const LINKS: usize = 32;

/// End of a temporary file's name, after a dot, the file's own name, the writer's process, its host, where known, and a number.
const TEMPORARY: &str = ".tmp";

/// Longest name in bytes that a temporary file repeats whole: systems allow 255 in all, the rest included.
const REPEATED: usize = 200;

/// The age from which a file is one of a killed writer, where its writer's process cannot be looked up.
const OLD: Duration = Duration::from_secs(3600);

/// The host since its start, and the container, as a number: within it, each process has a number of its own. `None` where /proc does
/// not list all of these processes.
static HOST: LazyLock<Option<u32>> = LazyLock::new(|| {
    let own = fs::read_link("/proc/self").ok()?.to_str()?.parse::<u32>() == Ok(std::process::id());
    // Mounted to hide other users' processes, /proc has no process 1 either.
    if !own || !Path::new("/proc/1").exists() {
        return None;
    }
    let boot = fs::read("/proc/sys/kernel/random/boot_id").ok()?;
    let container = fs::read_link("/proc/self/ns/pid").ok()?;
    Some(crc32([boot.as_slice(), container.as_os_str().as_encoded_bytes()]))
});

/// Begin of a temporary file's name. A longer name is cut, and its checksum tells it from others.
fn hidden_prefix(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    if name.len() <= REPEATED {
        return format!(".{name}.");
    }
    let begin: String = name.chars().take(REPEATED / 4).collect();
    format!(".{begin}~{:08x}.", crc32([name.as_bytes()]))
}

/// Removes the temporary files of [`write_atomically`] that writers of `path` left when they were killed. Files of living writers stay, also
/// those of other nodes and containers that share the folder.
pub fn remove_leftovers(path: &Path) {
    let Some(name) = path.file_name() else { return };
    let prefix = hidden_prefix(name);
    for entry in fs::read_dir(folder_of(path)).into_iter().flatten().flatten() {
        let found = entry.file_name();
        let found = found.to_string_lossy();
        let middle = found.strip_prefix(&prefix).and_then(|rest| rest.strip_suffix(TEMPORARY));
        if middle.and_then(writer).is_some_and(|writer| is_gone(writer, &entry)) {
            // A file that cannot be removed costs some space, nothing else.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// The process and the host in a temporary file's name, of which `middle` follows the prefix.
fn writer(middle: &str) -> Option<(u32, Option<u32>)> {
    let (process, rest) = middle.split_once('-')?;
    let (host, attempt) = match rest.split_once('-') {
        Some((host, attempt)) => (Some(u32::from_str_radix(host, 16).ok()?), attempt),
        None => (None, rest),
    };
    attempt.parse::<u32>().ok()?;
    Some((process.parse().ok()?, host))
}

/// True if the process that wrote a temporary file has ended. A process of this host is looked up; of others, only the age of the file
/// is known. This process's own number may be that of an earlier one, as in containers that are started again.
fn is_gone((process, host): (u32, Option<u32>), file: &fs::DirEntry) -> bool {
    if host.is_some() && host == *HOST && process != std::process::id() {
        return !Path::new("/proc").join(process.to_string()).exists();
    }
    let age = file.metadata().and_then(|m| m.modified()).ok().and_then(|written| written.elapsed().ok());
    age.is_some_and(|age| age > OLD)
}

/// A new file in the folder of `path` that no other writer uses.
fn create_beside(path: &Path) -> io::Result<(PathBuf, File)> {
    let name = path.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "not a file name"))?;
    let host = HOST.map(|host| format!("{host:08x}-")).unwrap_or_default();
    let begin = format!("{}{}-{host}", hidden_prefix(name), std::process::id());
    let mut attempt = 0u32;
    loop {
        let temporary = path.with_file_name(format!("{begin}{attempt}{TEMPORARY}"));
        match OpenOptions::new().write(true).create_new(true).open(&temporary) {
            Ok(file) => return Ok((temporary, file)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && attempt < 1000 => attempt += 1,
            Err(error) => return Err(error),
        }
    }
}

fn fill(file: File, body: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut out = BufWriter::with_capacity(1 << 20, file);
    body(&mut out)?;
    out.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()
}

/// Makes the rename itself durable, on systems on which folders can be synced.
fn sync_folder(path: &Path) {
    if let Ok(folder) = File::open(folder_of(path)) {
        let _ = folder.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::SystemTime;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |out| {
            out.write_all(b"half")?;
            Err(io::Error::new(io::ErrorKind::StorageFull, "disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn leftovers_of_one_file_go_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let own = format!(".a.ply.{}-0.tmp", std::process::id());
        // No system numbers processes so high. Those of other nodes and containers cannot be looked up here.
        let of_host = |host: u32| format!(".a.ply.4194305-{host:08x}-0.tmp");
        let here = HOST.map_or_else(|| ".a.ply.4194305-2.tmp".to_owned(), of_host);
        let there = of_host(HOST.map_or(7, |host| !host));
        // Name, age in seconds, and whether it stays.
        let files: [(&str, u64, bool); 12] = [
            (".a.ply.4194305-0.tmp", 7200, false),
            (".a.ply.4294967295-12.tmp", 7200, false),
            (".a.ply.4194305-1.tmp", 60, true),
            (&here, if HOST.is_some() { 0 } else { 7200 }, false),
            (&there, 60, true),
            (".a.ply.1-0000000a-0.tmp", 7200, false),
            (".a.ply.tmp", 7200, true),
            (".a.ply.x-1.tmp", 7200, true),
            (".a.ply.1-x-1.tmp", 7200, true),
            (".b.ply.4194305-0.tmp", 7200, true),
            ("a.ply", 7200, true),
            (&own, 0, true),
        ];
        for (name, age, _) in files {
            let file = File::create(folder.path().join(name)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(age)).unwrap();
        }
        remove_leftovers(&folder.path().join("a.ply"));
        for (name, age, stays) in files {
            assert_eq!(folder.path().join(name).exists(), stays, "{name} of {age} s");
        }
    }

    /// A file that is being written bears the process and the host of its writer.
    #[test]
    fn writers_sign_their_files() {
        let folder = tempfile::tempdir().unwrap();
        let (temporary, _file) = create_beside(&folder.path().join("a.ply")).unwrap();
        let name = temporary.file_name().unwrap().to_str().unwrap();
        let middle = name.strip_prefix(".a.ply.").and_then(|rest| rest.strip_suffix(TEMPORARY)).unwrap();
        assert_eq!(writer(middle), Some((std::process::id(), *HOST)));
    }

    #[test]
    fn a_name_may_be_as_long_as_the_system_allows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("{}.ply", "\u{e9}".repeat(125)));
        write_atomically(&path, |out| out.write_all(b"whole")).unwrap();
        let left = path.with_file_name(format!("{}4194305-0{TEMPORARY}", hidden_prefix(path.file_name().unwrap())));
        File::create(&left).unwrap().set_modified(SystemTime::now() - Duration::from_secs(7200)).unwrap();
        remove_leftovers(&path.with_extension("spz"));
        assert!(left.exists(), "another file's");
        remove_leftovers(&path);
        assert!(!left.exists() && fs::read(&path).unwrap() == b"whole");
        assert!(check_place(&path).is_ok() && check_place(&path.with_extension("spz")).is_ok());
        for wrong in [path.with_extension("longer.ply"), folder.path().join("none/a.ply"), path.join("a.ply")] {
            assert!(check_place(&wrong).is_err(), "{}", wrong.display());
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe.ply");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let link = folder.path().join("link.ply");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        for path in [&path, &link] {
            assert!(matches!(check_place(path), Err(Error::NotAFile { .. })));
            assert!(matches!(write_atomically(path, |_| Ok(())), Err(Error::NotAFile { .. })));
        }
        assert!(!fs::metadata(&path).unwrap().is_file());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn the_input_is_recognised_through_links() {
        let folder = tempfile::tempdir().unwrap();
        let input = folder.path().join("in.ply");
        fs::write(&input, b"x").unwrap();
        assert!(matches!(refuse_overwrite(&input, &folder.path().join("./in.ply")), Err(Error::SameFile { .. })));
        assert!(refuse_overwrite(&input, &folder.path().join("out.ply")).is_ok());
        let link = folder.path().join("hard.ply");
        fs::hard_link(&input, &link).unwrap();
        #[cfg(unix)]
        assert!(matches!(refuse_overwrite(&input, &link), Err(Error::SameFile { .. })));
        assert!(matches!(refuse_overwrite(folder.path(), &input), Err(Error::SameFile { .. })), "a part of it");
        assert!(refuse_overwrite(folder.path(), &folder.path().join("out.ply")).is_ok());
    }
}
