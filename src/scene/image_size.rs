//! The size of a photo, read from its header alone.

use std::fs::File;
use std::io::{BufReader, Error, ErrorKind, Read};
use std::path::Path;

/// Width and height in pixels as the header of a JPEG, PNG or WebP file states them; EXIF orientation is ignored.
pub(crate) fn image_size(path: &Path) -> Result<(u32, u32), Error> {
    let mut file = BufReader::with_capacity(4096, File::open(path)?);
    let mut magic = [0; 2];
    file.read_exact(&mut magic)?;
    if magic == [0xff, 0xd8] {
        return jpeg_size(&mut file);
    }
    let reader = image::ImageReader::open(path)?.with_guessed_format()?;
    reader.into_dimensions().map_err(|e| Error::new(ErrorKind::InvalidData, e))
}

/// Walks from marker to marker up to the frame header, or to the end of the file.
fn jpeg_size(file: &mut BufReader<File>) -> Result<(u32, u32), Error> {
    loop {
        while byte(file)? != 0xff {}
        let mut marker = byte(file)?;
        while marker == 0xff {
            marker = byte(file)?;
        }
        match marker {
            // Stuffing, TEM, RSTn and SOI have no length.
            0x00 | 0x01 | 0xd0..=0xd8 => {}
            0xd9 | 0xda => return Err(Error::new(ErrorKind::InvalidData, "no frame header before the image data")),
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                let mut frame = [0; 7]; // length, precision, height, width
                file.read_exact(&mut frame)?;
                let size = |i: usize| u32::from(u16::from_be_bytes([frame[i], frame[i + 1]]));
                return Ok((size(5), size(3)));
            }
            _ => {
                let length = i64::from(u16::from_be_bytes([byte(file)?, byte(file)?]));
                file.seek_relative((length - 2).max(0))?;
            }
        }
    }
}

fn byte(file: &mut BufReader<File>) -> Result<u8, Error> {
    let mut b = [0];
    file.read_exact(&mut b)?;
    Ok(b[0])
}
