//! Checksums of data that are stored or compared.

/// CRC-32 of some parts, one after the other.
pub fn crc32<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> u32 {
    let mut crc = flate2::Crc::new();
    parts.into_iter().for_each(|part| crc.update(part));
    crc.sum()
}
