//! Tags of a TIFF's first picture, which the `image` crate does not tell.

/// ExtraSamples: the meaning of the channels beyond the colours.
pub(super) const EXTRA_SAMPLES: u16 = 338;
/// Its value for alpha that the colours are multiplied by.
pub(super) const MULTIPLIED: u16 = 1;
/// SampleFormat: the kind of the numbers.
pub(super) const SAMPLE_FORMAT: u16 = 339;
/// Its value for floats.
pub(super) const FLOATS: u16 = 3;

/// The types of whole numbers without a sign, and their bytes: BYTE, SHORT, LONG, LONG8.
const TYPES: [(u64, usize); 4] = [(1, 1), (3, 2), (4, 4), (16, 8)];

/// The first number of a tag of whole numbers; none if the first picture of this TIFF or BigTIFF lacks the tag.
pub(super) fn first(bytes: &[u8], tag: u16) -> Option<u16> {
    let is_little = bytes.starts_with(b"II");
    let number = |at: usize, length: usize| -> Option<u64> {
        let bytes = bytes.get(at..at.checked_add(length)?)?;
        let join = |sum: u64, byte: &u8| (sum << 8) | u64::from(*byte);
        Some(if is_little { bytes.iter().rev().fold(0, join) } else { bytes.iter().fold(0, join) })
    };
    let place = |at: usize, length: usize| usize::try_from(number(at, length)?).ok();
    // Bytes of a place in the file, of the number of tags, and of a tag.
    let (size, count, length) = if number(2, 2)? == 43 { (8, 8, 20) } else { (4, 2, 12) };
    let start = place(size, size)?;
    let mut at = start.checked_add(count)?;
    for _ in 0..number(start, count)? {
        if number(at, 2)? == u64::from(tag) {
            let (kind, numbers) = (number(at + 2, 2)?, number(at + 4, size)?);
            let held = at + 4 + size;
            let (_, width) = TYPES.into_iter().find(|(known, _)| *known == kind)?;
            // More numbers than fit lie elsewhere.
            let held = if numbers > (size / width) as u64 { place(held, size)? } else { held };
            return u16::try_from(number(held, width)?).ok();
        }
        at += length;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_are_found_in_either_order_of_bytes_and_elsewhere() {
        // Two tags: one number, and three numbers at byte 38.
        let short = |little: bool, value: u16| if little { value.to_le_bytes() } else { value.to_be_bytes() };
        for little in [true, false] {
            let long = |value: u16| {
                let halves = if little { [short(true, value), [0, 0]] } else { [[0, 0], short(false, value)] };
                halves.concat()
            };
            let tag = |number: u16, count: u16, value: Vec<u8>| {
                [short(little, number).to_vec(), short(little, 3).to_vec(), long(count), value].concat()
            };
            let order = if little { *b"II" } else { *b"MM" };
            let mut file = [order.to_vec(), short(little, 42).to_vec(), long(8)].concat();
            file.extend(short(little, 2));
            file.extend(tag(EXTRA_SAMPLES, 1, [short(little, 1), [0, 0]].concat()));
            file.extend(tag(SAMPLE_FORMAT, 3, long(38)));
            file.extend([0; 4]);
            file.extend([3; 3].map(|format| short(little, format)).concat());
            assert_eq!([EXTRA_SAMPLES, SAMPLE_FORMAT, 256].map(|tag| first(&file, tag)), [Some(1), Some(3), None]);
            for cut in 0..file.len() {
                let _ = first(&file[..cut], SAMPLE_FORMAT);
            }
            // The same three numbers in bytes, which fit into the tag, and in 32 bits.
            let kinds = [short(little, SAMPLE_FORMAT), short(little, 3)].concat();
            let kind = file.windows(4).position(|w| w == kinds).unwrap();
            for (number, held) in [(1, vec![3, 3, 3, 0]), (4, long(38))] {
                let mut other = file[..38].to_vec();
                other[kind + 2..kind + 4].copy_from_slice(&short(little, number));
                other[kind + 8..kind + 12].copy_from_slice(&held);
                other.extend([long(3), long(3), long(3)].concat());
                assert_eq!(first(&other, SAMPLE_FORMAT), Some(FLOATS), "{number}");
            }
        }
    }
}
