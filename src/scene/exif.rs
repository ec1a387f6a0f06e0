//! Camera, exposure, rotation and colour profile in a photo's header.

mod profile;

use super::image_size::image_size;
use super::view::View;
use exif::{Exif, In, Reader, Tag, Value};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

impl View {
    /// The photo's exposure in stops: log2 of time times sensitivity over the square of the aperture's f-number. None
    /// if the header lacks one of the three.
    pub fn exposure_stops(&self) -> Option<f64> {
        let header = header(&self.image)?;
        let [time, aperture] = [Tag::ExposureTime, Tag::FNumber].map(|tag| positive(&header, tag));
        Some((time? * positive(&header, Tag::PhotographicSensitivity)? / aperture?.powi(2)).log2())
    }

    /// True if the photo's header says that it is to be turned or mirrored before it is shown.
    pub fn has_exif_rotation(&self) -> bool {
        let orientation = header(&self.image).and_then(|header| positive(&header, Tag::Orientation));
        orientation.is_some_and(|orientation| orientation > 1.0 && orientation < 9.0)
    }
}

/// The kind of camera that took a photo.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraKind {
    /// Make, model and focal length; empty if the header does not say.
    pub said: String,
    /// True if the header tells the field of view.
    pub has_focal: bool,
    /// Width and height of the photo in pixels.
    pub size: (u32, u32),
}

impl CameraKind {
    /// Reads a photo's header. None if not even its size can be read.
    pub fn of(photo: &Path) -> Option<Self> {
        let size = image_size(photo).ok()?;
        let header = header(photo);
        let field = |tag| header.as_ref()?.get_field(tag, In::PRIMARY).map(|f| f.display_value().to_string());
        let said: Vec<String> = [Tag::Make, Tag::Model, Tag::FocalLength].into_iter().filter_map(field).collect();
        let has_focal = header.as_ref().is_some_and(|h| positive(h, Tag::FocalLengthIn35mmFilm).is_some());
        Some(Self { said: said.join(" "), has_focal, size })
    }

    /// True if both photos can share one camera's parameters: their sizes differ by 1 % at most, as after cropping.
    pub fn shares(&self, other: &Self) -> bool {
        let near = |a: u32, b: u32| a.abs_diff(b) <= b / 100;
        self.said == other.said && near(self.size.0, other.size.0) && near(self.size.1, other.size.1)
    }
}

fn header(photo: &Path) -> Option<Exif> {
    Reader::new().read_from_container(&mut BufReader::new(File::open(photo).ok()?)).ok()
}

/// The first number of a field, if it is finite and above 0.
fn positive(header: &Exif, tag: Tag) -> Option<f64> {
    let number = match &header.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(list) => list.first()?.to_f64(),
        value => f64::from(value.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}
