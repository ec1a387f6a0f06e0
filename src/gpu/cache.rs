//! Files in the cache folder.

use crate::extension::folder_of;
use std::io::{self, Write};
use std::path::Path;

/// Writes a file as a whole, in place of an earlier one, and makes its folder. A failure leaves the earlier file.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let folder = folder_of(path);
    std::fs::create_dir_all(folder)?;
    #[cfg(not(unix))]
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    // Other users of the folder may read it, as far as the umask allows.
    #[cfg(unix)]
    let mut file = tempfile::Builder::new()
        .permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666))
        .tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.persist(path)?;
    Ok(())
}
