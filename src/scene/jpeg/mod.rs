//! Missing data of JPEGs, which decoders silently replace by grey or by a blur.
//!
//! Segments and scans follow ITU T.81; embedded previews lie in segments before the image, which are skipped.

mod bits;

use bits::{Blocks, Fault};

/// True if a file lacks data that its header promises: it is cut short, with or without an end marker put behind.
pub(super) fn lacks_data(bytes: &[u8]) -> bool {
    let mut image = Image { at: 2, ..Image::default() };
    let Some(mut scan) = image.next_scan(bytes) else { return true };
    if !bytes[image.at..].windows(2).any(|w| w == [0xff, 0xd9]) {
        return true;
    }
    // What follows damage of another kind cannot be counted.
    let mut sound = true;
    loop {
        if sound {
            match image.walk(&scan, &bytes[image.at..]) {
                Ok(()) => {}
                Err(Fault::End) => return true,
                Err(Fault::NoCode) => sound = false,
            }
        }
        match image.next_scan(bytes) {
            Some(next) => scan = next,
            None => return image.progressive && image.components.iter().any(|c| c.whole != u64::MAX),
        }
    }
}

/// A Huffman table: the length and the symbol of the code that each 16 bits begin with; length 0 for none.
type Table = Vec<(u8, u8)>;

/// One colour.
#[derive(Clone, Default)]
struct Component {
    id: u8,
    /// Its blocks within a unit of a scan of several colours, in a row and in a column.
    sampling: (u32, u32),
    /// Progressive: a bit for each coefficient of a block that came to its last bit in some scan.
    whole: u64,
    /// Progressive: for each block a bit for each coefficient that is not zero so far.
    found: Vec<u64>,
}

/// A scan of some colours.
struct Scan {
    /// Numbers of its colours, and of the tables of each.
    colours: Vec<(usize, [u8; 2])>,
    /// Its first and its last coefficient.
    band: [u8; 2],
    /// True if earlier scans had the first bits of these coefficients.
    refines: bool,
}

/// The header, up to the data of a scan.
#[derive(Default)]
struct Image {
    progressive: bool,
    size: (u32, u32),
    components: Vec<Component>,
    tables: [[Option<Table>; 4]; 2],
    /// Units of blocks between restarts; 0 without any.
    restart: u32,
    /// The byte that is read next.
    at: usize,
}

impl Image {
    /// Reads on to the data of the next scan; none if the image or the file ends before it.
    fn next_scan(&mut self, bytes: &[u8]) -> Option<Scan> {
        while let Some(&[mark, marker, high, low]) = bytes.get(self.at..self.at + 4) {
            // Data of a scan, padding, which decoders skip, and markers without a length.
            if mark != 0xff || matches!(marker, 0x00 | 0x01 | 0xd0..=0xd8 | 0xff) {
                self.at += 1;
                continue;
            }
            if marker == 0xd9 {
                return None;
            }
            let length = usize::from(u16::from_be_bytes([high, low])).max(2);
            let body = bytes.get(self.at + 4..self.at + 2 + length)?;
            self.at += 2 + length;
            match marker {
                0xc0..=0xc2 if body.len() >= 6 => {
                    self.progressive = marker == 0xc2;
                    let pair = |i: usize| u32::from(u16::from_be_bytes([body[i], body[i + 1]]));
                    self.size = (pair(3), pair(1));
                    let row = |c: &[u8]| Component {
                        id: c[0],
                        sampling: (u32::from(c[1] >> 4), u32::from(c[1] & 15)),
                        ..Component::default()
                    };
                    self.components = body[6..].chunks_exact(3).map(row).collect();
                }
                0xc4 => define(body, &mut self.tables),
                0xdd if body.len() >= 2 => self.restart = u32::from(u16::from_be_bytes([body[0], body[1]])),
                0xda => return self.scan(body),
                _ => {}
            }
        }
        None
    }

    /// Reads the header of a scan.
    fn scan(&mut self, body: &[u8]) -> Option<Scan> {
        let (count, rest) = body.split_first()?;
        let [.., from, to, bits] = *rest else { return None };
        let band = [from.min(63), to.min(63)];
        let known = |choice: &[u8]| {
            let number = self.components.iter().position(|c| c.id == choice[0])?;
            Some((number, [choice[1] >> 4, choice[1] & 15]))
        };
        let colours: Option<Vec<_>> = rest.chunks_exact(2).take(usize::from(*count)).map(known).collect();
        let colours = colours.unwrap_or_default();
        if bits.trailing_zeros() >= 4 && band[0] <= band[1] {
            let bits = (u64::MAX >> (63 - band[1])) & (u64::MAX << band[0]);
            for (number, _) in &colours {
                self.components[*number].whole |= bits;
            }
        }
        Some(Scan { colours, band, refines: bits >> 4 > 0 })
    }

    /// Steps over the blocks of a scan, as far as its tables and colours are known.
    fn walk(&mut self, scan: &Scan, data: &[u8]) -> Result<(), Fault> {
        if self.components.iter().any(|c| c.sampling.0 * c.sampling.1 == 0) {
            return Err(Fault::NoCode);
        }
        let most = |of: fn(&Component) -> u32| self.components.iter().map(of).max().unwrap_or(1);
        let (wide, high) = (most(|c| c.sampling.0), most(|c| c.sampling.1));
        let alone = scan.colours.len() == 1;
        // A colour alone has no blocks beyond the picture's edge.
        let (width, height) = match scan.colours[..] {
            [] => return Err(Fault::NoCode),
            [(number, _)] => {
                let (across, down) = self.components[number].sampling;
                ((self.size.0 * across).div_ceil(8 * wide), (self.size.1 * down).div_ceil(8 * high))
            }
            _ => (self.size.0.div_ceil(8 * wide), self.size.1.div_ceil(8 * high)),
        };
        let units = width as usize * height as usize;
        let by_bands = self.progressive && scan.band[0] > 0;
        if by_bands && !alone {
            return Err(Fault::NoCode);
        }
        let mut blocks = Blocks::new(data, if self.progressive { scan.band } else { [1, 63] });
        for unit in 0..units {
            if self.restart > 0 && unit > 0 && unit.is_multiple_of(self.restart as usize) {
                blocks.restart()?;
            }
            for (number, tables) in &scan.colours {
                let component = &mut self.components[*number];
                let [dc, ac] =
                    [0, 1].map(|class: usize| self.tables[class].get(usize::from(tables[class]))?.as_deref());
                if by_bands {
                    component.found.resize(units, 0);
                    let (table, found) = (ac.ok_or(Fault::NoCode)?, &mut component.found[unit]);
                    if scan.refines {
                        blocks.refine(table, found)?;
                    } else {
                        blocks.begin(table, found)?;
                    }
                    continue;
                }
                let count = if alone { 1 } else { component.sampling.0 * component.sampling.1 };
                for _ in 0..count {
                    match (self.progressive, scan.refines) {
                        (false, _) => blocks.skip(dc.ok_or(Fault::NoCode)?, ac.ok_or(Fault::NoCode)?)?,
                        (true, false) => blocks.skip_dc(dc.ok_or(Fault::NoCode)?)?,
                        (true, true) => blocks.refine_dc()?,
                    }
                }
            }
        }
        Ok(())
    }
}

/// Reads the tables of one segment.
fn define(mut body: &[u8], tables: &mut [[Option<Table>; 4]; 2]) {
    while let Some((&[kind, ref counts @ ..], rest)) = body.split_first_chunk::<17>() {
        let n = counts.iter().map(|&c| usize::from(c)).sum();
        let Some((symbols, rest)) = rest.split_at_checked(n) else { return };
        let mut table = vec![(0, 0); 1 << 16];
        let (mut symbols, mut code) = (symbols.iter(), 0_usize);
        for (length, &count) in (1_u8..).zip(counts) {
            for &symbol in symbols.by_ref().take(usize::from(count)) {
                let first = code << (16 - length);
                table.iter_mut().skip(first).take(1 << (16 - length)).for_each(|entry| *entry = (length, symbol));
                code += 1;
            }
            code <<= 1;
        }
        if let Some(place) = tables.get_mut(usize::from(kind >> 4)).and_then(|t| t.get_mut(usize::from(kind & 15))) {
            *place = Some(table);
        }
        body = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::lacks_data;

    fn photo(progressive: bool, plain: bool) -> Vec<u8> {
        let (width, height) = (80_u16, 64_u16);
        let bytes: Vec<u8> = (0..3 * u32::from(width) * u32::from(height))
            .map(|i| if plain { 200 } else { (i * i / 97 + i % 13 * 9) as u8 })
            .collect();
        let mut out = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut out, 85);
        encoder.set_progressive(progressive);
        encoder.encode(&bytes, width, height, jpeg_encoder::ColorType::Rgb).unwrap();
        out
    }

    #[test]
    fn bytes_between_segments_are_padding() {
        for progressive in [false, true] {
            let whole = photo(progressive, false);
            let second = 4 + usize::from(u16::from_be_bytes([whole[4], whole[5]]));
            let padded = [&whole[..second], &[0, 0x12, 0xff], &whole[second..]].concat();
            assert!(!lacks_data(&padded), "{progressive}");
        }
    }

    /// A grey picture of 24 x 16 pixels in six scans, of which the last three refine the others, without its quantisation.
    const REFINED: &str = "\
        ffd8ffc2000b080010001801011100ffc40017000003010000000000000000000000000000010203ffda0008010100000001\
        d6218fffc4001a100002030101000000000000000000000001020003121131ffda00080101000105026c569ab197a0425767\
        d1a9ffc4001e100001040300030000000000000000000001000211120322614151b2ffda0008010100063f02b65363e94c33\
        133ab597748010816ab655b33b6f95a0af7cafffc4001e100100010402030000000000000000000001001121314151a17181\
        c1ffda0008010100013f21a2573813db2c5d8609380f703884abcc2d83677e01cc4ab67b4f67e13fffda0008010100000010\
        f3ffc4001d1001000202020300000000000000000000010011213141617191c1ffda0008010100013f10c351e55b3616d5b2\
        e89966bcd3e28afa8dcf78642b52db1506a81d721456c035f58a3d173fffd9";

    /// The last scan only sharpens, but a part of it is missed.
    #[test]
    fn each_byte_of_a_progressive_jpeg_is_missed() {
        let digits = |at: usize| u8::from_str_radix(&REFINED[at..at + 2], 16).unwrap();
        let whole: Vec<u8> = (0..REFINED.len()).step_by(2).map(digits).collect();
        assert!(!lacks_data(&whole));
        let scan = whole.windows(2).position(|w| w == [0xff, 0xda]).unwrap();
        for cut in scan + 10..whole.len() - 2 {
            assert!(lacks_data(&[&whole[..cut], &[0xff, 0xd9]].concat()), "{cut}");
        }
    }

    #[test]
    fn half_a_jpeg_is_noticed_with_and_without_an_end() {
        for (progressive, plain) in [(false, false), (true, false), (false, true), (true, true)] {
            let whole = photo(progressive, plain);
            assert!(!lacks_data(&whole), "{progressive} {plain}");
            // Previews of phones and tails of other programs follow the end.
            assert!(!lacks_data(&[&whole[..], &[0; 100]].concat()));
            for share in [0.55, 0.7, 0.9, 0.97] {
                let head = (0..whole.len()).find(|&i| whole[i..].starts_with(&[0xff, 0xda])).unwrap();
                let cut = head + ((whole.len() - head) as f64 * share) as usize;
                assert!(lacks_data(&whole[..cut]));
                assert!(lacks_data(&[&whole[..cut], &[0xff, 0xd9]].concat()), "{progressive} {plain} {share}");
            }
        }
    }
}
