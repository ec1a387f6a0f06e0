//! The exposure of a photo from its EXIF header.

use super::view::View;
use exif::{Exif, In, Reader, Tag, Value};
use std::fs::File;
use std::io::BufReader;

impl View {
    /// The photo's exposure in stops: log2 of time times sensitivity over the square of the aperture's f-number. None
    /// if the header lacks one of the three.
    pub fn exposure_stops(&self) -> Option<f64> {
        let file = File::open(&self.image).ok()?;
        let header = Reader::new().read_from_container(&mut BufReader::new(file)).ok()?;
        let [time, aperture] = [Tag::ExposureTime, Tag::FNumber].map(|tag| positive(&header, tag));
        Some((time? * positive(&header, Tag::PhotographicSensitivity)? / aperture?.powi(2)).log2())
    }
}

/// The first number of a field, if it is finite and above 0.
fn positive(header: &Exif, tag: Tag) -> Option<f64> {
    let number = match &header.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(list) => list.first()?.to_f64(),
        value => f64::from(value.get_uint(0)?),
    };
    (number.is_finite() && number > 0.0).then_some(number)
}
