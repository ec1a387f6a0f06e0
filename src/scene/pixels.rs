//! Decoded pixels on the host: in memory, or in a temporary file if there are too many.

use std::borrow::Cow;
use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Bytes of a pixel: red, green, blue, and a fourth.
const PIXEL: usize = 4;

/// The pixels of one photo: RGBA, 8 bits each, row by row.
#[derive(Clone, Debug)]
pub enum Pixels {
    /// In memory.
    Held(Arc<[u8]>),
    /// In a file, read on demand.
    Filed {
        /// The file of all photos.
        file: Arc<File>,
        /// Byte offset of this photo.
        start: u64,
        /// Its length in bytes.
        len: usize,
    },
}

impl Pixels {
    /// Number of bytes.
    pub fn len(&self) -> usize {
        match self {
            Self::Held(bytes) => bytes.len(),
            Self::Filed { len, .. } => *len,
        }
    }

    /// True if there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// All bytes.
    pub fn read(&self) -> io::Result<Cow<'_, [u8]>> {
        match self {
            Self::Held(bytes) => Ok(Cow::Borrowed(bytes)),
            Self::Filed { file, start, len } => {
                let mut bytes = vec![0; *len];
                read_at(file, &mut bytes, *start)?;
                Ok(Cow::Owned(bytes))
            }
        }
    }

    /// One pixel, counted row by row.
    ///
    /// # Panics
    /// If `pixel` is past the last one.
    pub fn at(&self, pixel: usize) -> io::Result<[u8; PIXEL]> {
        let first = pixel * PIXEL;
        assert!(first + PIXEL <= self.len(), "pixel {pixel} of {}", self.len() / PIXEL);
        let mut out = [0; PIXEL];
        match self {
            Self::Held(bytes) => out.copy_from_slice(&bytes[first..first + PIXEL]),
            Self::Filed { file, start, .. } => read_at(file, &mut out, start + first as u64)?,
        }
        Ok(out)
    }
}

impl From<Vec<u8>> for Pixels {
    fn from(bytes: Vec<u8>) -> Self {
        Self::Held(bytes.into())
    }
}

impl FromIterator<u8> for Pixels {
    fn from_iter<I: IntoIterator<Item = u8>>(bytes: I) -> Self {
        Self::Held(bytes.into_iter().collect())
    }
}

/// An unnamed temporary file of photos; it disappears when the process ends, in whatever way.
pub struct PhotoFile(Arc<File>);

impl PhotoFile {
    /// Creates the file in this folder.
    pub fn new(folder: &Path) -> io::Result<Self> {
        tempfile::tempfile_in(folder).map(|file| Self(Arc::new(file)))
    }

    /// Stores a photo from byte `start` on.
    pub fn put(&self, start: u64, bytes: &[u8]) -> io::Result<Pixels> {
        write_at(&self.0, bytes, start)?;
        Ok(Pixels::Filed { file: Arc::clone(&self.0), start, len: bytes.len() })
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], start: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, start)
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], start: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, start)
}

#[cfg(windows)]
fn read_at(file: &File, mut bytes: &mut [u8], mut start: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, start)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            n => (bytes, start) = (&mut bytes[n..], start + n as u64),
        }
    }
    Ok(())
}

#[cfg(windows)]
fn write_at(file: &File, mut bytes: &[u8], mut start: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        let n = std::os::windows::fs::FileExt::seek_write(file, bytes, start)?;
        (bytes, start) = (&bytes[n..], start + n as u64);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn filed_photos_are_what_was_put_whoever_reads() {
        let folder = tempfile::tempdir().unwrap();
        let file = PhotoFile::new(folder.path()).unwrap();
        let photo = |i: usize| (0..40 + 4 * i).map(|k| (k * 7 + i * 31) as u8).collect::<Vec<u8>>();
        let starts: Vec<u64> = (0..20).map(|i| (0..i).map(|k| photo(k).len() as u64).sum()).collect();
        // Last first: the order of storing does not matter.
        let mut filed: Vec<_> = (0..20).rev().map(|i| file.put(starts[i], &photo(i)).unwrap()).collect();
        filed.reverse();
        drop(file);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "it has no name");
        thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for (i, pixels) in filed.iter().enumerate() {
                        let held = Pixels::from(photo(i));
                        assert!(pixels.read().unwrap() == held.read().unwrap() && pixels.len() == held.len());
                        assert!((0..held.len() / 4).all(|p| pixels.at(p).unwrap() == held.at(p).unwrap()));
                    }
                });
            }
        });
    }

    #[test]
    fn a_file_that_is_cut_short_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let file = PhotoFile::new(folder.path()).unwrap();
        let pixels = file.put(8, &[1; 64]).unwrap();
        file.0.set_len(40).unwrap();
        assert!(pixels.read().is_err() && pixels.at(15).is_err() && pixels.at(0).is_ok());
        assert!(PhotoFile::new(&folder.path().join("nowhere")).is_err());
    }
}
