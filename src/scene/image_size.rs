//! The size of a photo, read from its header alone.

use std::fs::File;
use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Seek};
use std::path::Path;

use image::{ImageFormat, ImageReader};

/// A reader of a picture in the format of its first bytes. The `image` crate reads BigTIFF, but does not know its beginning.
pub(super) fn picture_reader<R: BufRead + Seek>(mut file: R) -> Result<ImageReader<R>, Error> {
    let start = file.fill_buf()?;
    let is_big_tiff = start.starts_with(b"II+\0") || start.starts_with(b"MM\0+");
    let mut reader = ImageReader::new(file).with_guessed_format()?;
    if is_big_tiff {
        reader.set_format(ImageFormat::Tiff);
    }
    Ok(reader)
}

/// Width and height in pixels as the header of a photo states them; EXIF orientation is ignored.
pub(crate) fn image_size(path: &Path) -> Result<(u32, u32), Error> {
    let mut file = BufReader::with_capacity(4096, File::open(path)?);
    let mut magic = [0; 2];
    file.read_exact(&mut magic)?;
    if magic == [0xff, 0xd8] {
        return jpeg_size(&mut file);
    }
    file.seek_relative(-2)?;
    picture_reader(file)?.into_dimensions().map_err(|e| Error::new(ErrorKind::InvalidData, e))
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
