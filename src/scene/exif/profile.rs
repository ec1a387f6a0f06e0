//! Colour profiles (ICC) in the headers of photos: their names, and their coordinates of red, green and blue.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use image::ImageDecoder;

use crate::scene::image_size::{is_jpeg, jpeg_segment, picture_reader};
use crate::scene::view::View;

/// The marker of segments that hold profiles, and what the first of them begins with.
const SEGMENT: (u8, &[u8]) = (0xe2, b"ICC_PROFILE\0\x01");
/// X and Y of red, green and blue in sRGB.
const SRGB: [(&[u8; 4], [f64; 2]); 3] =
    [(b"rXYZ", [0.4361, 0.2225]), (b"gXYZ", [0.3851, 0.7169]), (b"bXYZ", [0.1431, 0.0606])];
/// Difference of a coordinate from that of sRGB, as of rounding and of other ways to adapt the white.
const ROUNDED: f64 = 0.01;

impl View {
    /// The name of the colour profile in the photo's header, if that describes reds, greens and blues other than those of sRGB.
    pub fn foreign_profile(&self) -> Option<String> {
        other_than_srgb(&stored(&self.image)?)
    }
}

/// The profile in a photo's header.
fn stored(photo: &Path) -> Option<Vec<u8>> {
    // A name may point anywhere.
    if !photo.is_file() {
        return None;
    }
    let mut file = BufReader::with_capacity(4096, File::open(photo).ok()?);
    if is_jpeg(&mut file).ok()? {
        // The decoder would read the whole file.
        return of_jpeg(&mut file);
    }
    picture_reader(file).ok()?.into_decoder().ok()?.icc_profile().ok()?
}

/// The first part of a JPEG's profile, which holds its name and its colours.
fn of_jpeg<R: Read + Seek>(file: &mut BufReader<R>) -> Option<Vec<u8>> {
    loop {
        let (marker, length) = jpeg_segment(file).ok()?;
        if marker != SEGMENT.0 {
            file.seek_relative(i64::from(length)).ok()?;
            continue;
        }
        let mut contents = vec![0; usize::from(length)];
        file.read_exact(&mut contents).ok()?;
        if let Some(part) = contents.strip_prefix(SEGMENT.1) {
            // After the number of parts.
            return part.get(1..).map(<[u8]>::to_vec);
        }
    }
}

/// The name of a profile of red, green and blue, if these are others than those of sRGB.
fn other_than_srgb(profile: &[u8]) -> Option<String> {
    if profile.get(16..20)? != b"RGB " {
        return None;
    }
    let name = tag(profile, *b"desc").and_then(name).unwrap_or_default();
    let is_near = |(colour, known): &(&[u8; 4], [f64; 2])| {
        tag(profile, **colour).is_some_and(|colour| {
            (8..).step_by(4).zip(known).all(|(at, known)| {
                number(colour, at).is_some_and(|v| (f64::from(v.cast_signed()) / 65536.0 - known).abs() < ROUNDED)
            })
        })
    };
    let is_srgb = name.to_lowercase().contains("srgb") || SRGB.iter().all(is_near);
    (!is_srgb).then(|| if name.is_empty() { "without a name".to_owned() } else { name })
}

/// The contents of a profile's tag.
fn tag(profile: &[u8], wanted: [u8; 4]) -> Option<&[u8]> {
    let mut tags = profile.get(132..)?.chunks_exact(12).take(usize::try_from(number(profile, 128)?).ok()?);
    let place = |entry: &[u8], at: usize| usize::try_from(number(entry, at)?).ok();
    let entry = tags.find(|entry| entry.starts_with(&wanted))?;
    let start = place(entry, 4)?;
    profile.get(start..start.checked_add(place(entry, 8)?)?)
}

/// The name in a tag of text: of letters in version 2 of the format, in UTF-16 in version 4.
fn name(text: &[u8]) -> Option<String> {
    let name = if text.starts_with(b"desc") {
        let length = usize::try_from(number(text, 8)?).ok()?;
        String::from_utf8_lossy(text.get(12..12_usize.checked_add(length)?)?).into_owned()
    } else {
        // The first of several languages.
        let [length, start] = [20, 24].map(|at| number(text, at).and_then(|n| usize::try_from(n).ok()));
        let letters = text.get(start?..start?.checked_add(length?)?)?.chunks_exact(2);
        let letters: Vec<u16> = letters.map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&letters)
    };
    Some(name.chars().filter(|c| !c.is_control()).take(60).collect())
}

/// A whole number of 32 bits.
fn number(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|bytes| u32::from_be_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// A profile with this name and these reds, greens and blues.
    fn profile(name: &str, version: u8, colours: [[f64; 3]; 3]) -> Vec<u8> {
        let fixed = |v: f64| ((v * 65536.0).round() as i32).to_be_bytes();
        let long = |n: usize| u32::try_from(n).unwrap().to_be_bytes();
        let text = if version == 2 {
            [&b"desc\0\0\0\0"[..], &long(name.len() + 1), name.as_bytes(), b"\0"].concat()
        } else {
            let letters: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            [&b"mluc\0\0\0\0"[..], &long(1), &long(12), b"enUS", &long(letters.len()), &long(28), &letters].concat()
        };
        let mut tags = vec![(b"desc", text)];
        for ((tag, _), colour) in SRGB.iter().zip(colours) {
            tags.push((*tag, [&b"XYZ \0\0\0\0"[..], &colour.map(fixed).concat()].concat()));
        }
        let mut whole = [&[0_u8; 16][..], b"RGB ", &[0_u8; 108], &long(tags.len())].concat();
        let mut at = whole.len() + 12 * tags.len();
        for (tag, bytes) in &tags {
            whole.extend([**tag, long(at), long(bytes.len())].concat());
            at += bytes.len();
        }
        for (_, bytes) in &tags {
            whole.extend(bytes);
        }
        whole
    }

    #[test]
    fn profiles_other_than_srgb_are_named() {
        let srgb = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
        let p3 = [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];
        for version in [2, 4] {
            let named = |name: &str, colours| other_than_srgb(&profile(name, version, colours));
            assert_eq!(named("Display P3", p3).as_deref(), Some("Display P3"), "{version}");
            assert_eq!((named("c2", srgb), named("sRGB built-in", p3)), (None, None));
            assert_eq!(named("", p3).as_deref(), Some("without a name"));
            let whole = profile("Display P3", version, p3);
            let segment = [&b"ICC_PROFILE\0\x01\x01"[..], &whole].concat();
            let length = u16::try_from(segment.len() + 2).unwrap().to_be_bytes();
            let jpeg = [&b"\xff\xd8\xff\xe0\0\x04ab\xff\xe2"[..], &length, &segment, b"\xff\xda\0\x02"].concat();
            let read = |bytes: &[u8]| of_jpeg(&mut BufReader::new(Cursor::new(bytes)));
            assert_eq!(read(&jpeg), Some(whole.clone()));
            // After five segments of the greatest length.
            let mut long = b"\xff\xe1\xff\xff".to_vec();
            long.resize(65_537, 0);
            assert_eq!(read(&[&jpeg[..2], &long.repeat(5), &jpeg[2..]].concat()), Some(whole.clone()));
            for cut in 0..jpeg.len() {
                let _ = read(&jpeg[..cut]);
                let _ = other_than_srgb(&whole[..cut.min(whole.len())]);
            }
        }
        assert_eq!(other_than_srgb(&[]), None);
    }
}
