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
    if is_jpeg(&mut file)? {
        return jpeg_frame(&mut file).map(|(width, height, _)| (width, height));
    }
    picture_reader(file)?.into_dimensions().map_err(|e| Error::new(ErrorKind::InvalidData, e))
}

/// The number of channels of a JPEG as its header states it; none of other files.
pub(super) fn jpeg_channels(path: &Path) -> Option<u8> {
    let mut file = BufReader::with_capacity(4096, File::open(path).ok()?);
    let frame = if is_jpeg(&mut file).ok()? { jpeg_frame(&mut file).ok() } else { None };
    frame.map(|(_, _, channels)| channels)
}

/// True at the beginning of a JPEG.
fn is_jpeg(file: &mut BufReader<File>) -> Result<bool, Error> {
    Ok(file.fill_buf()?.starts_with(&[0xff, 0xd8]))
}

/// Walks from marker to marker up to the frame header, or to the end of the file: width, height and number of channels.
fn jpeg_frame(file: &mut BufReader<File>) -> Result<(u32, u32, u8), Error> {
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
                let mut frame = [0; 8]; // length, precision, height, width, number of channels
                file.read_exact(&mut frame)?;
                let size = |i: usize| u32::from(u16::from_be_bytes([frame[i], frame[i + 1]]));
                return Ok((size(5), size(3), frame[7]));
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
