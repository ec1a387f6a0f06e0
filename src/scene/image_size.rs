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
        return jpeg_frame(&mut file).map(|frame| frame.size);
    }
    picture_reader(file)?.into_dimensions().map_err(|e| Error::new(ErrorKind::InvalidData, e))
}

/// The frame header of a JPEG.
pub(super) struct Frame {
    /// Second byte of its marker, which tells the coding.
    marker: u8,
    /// Bits of a number.
    bits: u8,
    /// Width and height in pixels.
    size: (u32, u32),
    /// Number of channels.
    pub channels: u8,
}

impl Frame {
    /// The frame header of a JPEG; none of other files, and of damaged ones.
    pub fn of<R: Read + Seek>(file: R) -> Option<Self> {
        let mut file = BufReader::with_capacity(4096, file);
        if is_jpeg(&mut file).ok()? { jpeg_frame(&mut file).ok() } else { None }
    }

    /// Why this JPEG is not read, as the end of `is a JPEG `; none if it is read.
    pub fn unread(&self) -> Option<&'static str> {
        match (self.marker, self.bits) {
            (0xc3 | 0xc7 | 0xcb | 0xcf, _) => Some("with lossless coding"),
            (0xc9.., _) => Some("with arithmetic coding"),
            (0xc5.., _) => Some("in several resolutions"),
            (_, 12) => Some("of 12 bits"),
            _ => None,
        }
    }
}

/// True at the beginning of a JPEG.
pub(super) fn is_jpeg<R: Read>(file: &mut BufReader<R>) -> Result<bool, Error> {
    Ok(file.fill_buf()?.starts_with(&[0xff, 0xd8]))
}

/// Walks from segment to segment up to the frame header, or to the image data.
fn jpeg_frame<R: Read + Seek>(file: &mut BufReader<R>) -> Result<Frame, Error> {
    loop {
        let (marker, length) = jpeg_segment(file)?;
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            let mut frame = [0; 6]; // precision, height, width, number of channels
            file.read_exact(&mut frame)?;
            let size = |i: usize| u32::from(u16::from_be_bytes([frame[i], frame[i + 1]]));
            return Ok(Frame { marker, bits: frame[0], size: (size(3), size(1)), channels: frame[5] });
        }
        file.seek_relative(i64::from(length))?;
    }
}

/// Walks to the contents of a JPEG's next segment; returns the second byte of its marker, and the number of bytes of the
/// contents. At the image data, it is an error.
pub(super) fn jpeg_segment(file: &mut impl Read) -> Result<(u8, u16), Error> {
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
            _ => {
                let length = u16::from_be_bytes([byte(file)?, byte(file)?]);
                return Ok((marker, length.saturating_sub(2)));
            }
        }
    }
}

fn byte(file: &mut impl Read) -> Result<u8, Error> {
    let mut b = [0];
    file.read_exact(&mut b)?;
    Ok(b[0])
}
