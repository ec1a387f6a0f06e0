//! Unpacking gzip: files of one member, and of several one after the other (RFC 1952).

use std::io::{self, Read};

use flate2::bufread::GzDecoder;

/// The first bytes of a gzip file, and of each member.
pub(super) const MAGIC: [u8; 2] = [0x1f, 0x8b];

/// The unpacked bytes of all members; other bytes may follow the last one.
pub(super) struct Members<'a> {
    member: GzDecoder<&'a [u8]>,
}

impl<'a> Members<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { member: GzDecoder::new(bytes) }
    }
}

impl Read for Members<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = self.member.read(out)?;
            let rest = *self.member.get_ref();
            if count > 0 || out.is_empty() || !rest.starts_with(&MAGIC) {
                return Ok(count);
            }
            self.member = GzDecoder::new(rest);
        }
    }
}
