//! Missing data of JPEGs, which decoders silently replace by grey or by a blur.
//!
//! Segments and scans follow ITU T.81; embedded previews lie in segments before the image, which are skipped.

/// True if a file lacks data that its header promises: it is cut short, with or without an end marker put behind.
pub(super) fn lacks_data(bytes: &[u8]) -> bool {
    let Some(image) = Image::of(bytes) else { return true };
    let scan = &bytes[image.data..];
    if !scan.windows(2).any(|w| w == [0xff, 0xd9]) {
        return true;
    }
    if image.progressive { !image.all_scans(bytes) } else { image.blocks_missing(scan) }
}

/// A marker instead of a code.
enum Fault {
    /// The data end.
    End,
    /// Bits that no table has: damaged otherwise, or not of this kind.
    NoCode,
}

/// A Huffman table: the length and the symbol of the code that each 16 bits begin with; length 0 for none.
type Table = Vec<(u8, u8)>;

/// One colour's blocks within a unit of the scan, and its tables.
#[derive(Clone, Default)]
struct Component {
    id: u8,
    sampling: (u32, u32),
    tables: [Option<Table>; 2],
}

/// The header, up to the data of the first scan.
struct Image {
    progressive: bool,
    size: (u32, u32),
    components: Vec<Component>,
    /// Units of blocks between restarts; 0 without any.
    restart: u32,
    /// First byte of the first scan's data.
    data: usize,
    /// Components of the first scan.
    in_scan: usize,
}

impl Image {
    /// Reads the headers up to the first scan; none if the file ends before it.
    fn of(bytes: &[u8]) -> Option<Self> {
        let mut image =
            Self { progressive: false, size: (0, 0), components: Vec::new(), restart: 0, data: 0, in_scan: 0 };
        let mut tables: [[Option<Table>; 4]; 2] = Default::default();
        let mut at = 2;
        while let Some(&[mark, marker, high, low]) = bytes.get(at..at + 4) {
            // Decoders skip padding; these markers have no length.
            if mark != 0xff || matches!(marker, 0x00 | 0x01 | 0xd0..=0xd8 | 0xff) {
                at += 1;
                continue;
            }
            let length = usize::from(u16::from_be_bytes([high, low])).max(2);
            let body = bytes.get(at + 4..at + 2 + length)?;
            match marker {
                0xc0..=0xc2 if body.len() >= 6 => {
                    image.progressive = marker == 0xc2;
                    let pair = |i: usize| u32::from(u16::from_be_bytes([body[i], body[i + 1]]));
                    image.size = (pair(3), pair(1));
                    let row = |c: &[u8]| Component {
                        id: c[0],
                        sampling: (u32::from(c[1] >> 4), u32::from(c[1] & 15)),
                        tables: [None, None],
                    };
                    image.components = body[6..].chunks_exact(3).map(row).collect();
                }
                0xc4 => define(body, &mut tables),
                0xdd if body.len() >= 2 => image.restart = u32::from(u16::from_be_bytes([body[0], body[1]])),
                0xda => {
                    image.data = at + 2 + length;
                    image.in_scan = usize::from(*body.first()?);
                    for choice in body[1..].chunks_exact(2).take(image.in_scan) {
                        if let Some(own) = image.components.iter_mut().find(|c| c.id == choice[0]) {
                            let of = |class: usize, id: u8| tables[class].get(usize::from(id)).cloned().flatten();
                            own.tables = [of(0, choice[1] >> 4), of(1, choice[1] & 15)];
                        }
                    }
                    return Some(image);
                }
                _ => {}
            }
            at += 2 + length;
        }
        None
    }

    /// True if all coefficients of the first colour, which is the brightness, came to their last bit in some scan.
    fn all_scans(&self, bytes: &[u8]) -> bool {
        let Some(first) = self.components.first() else { return true };
        let mut whole = [false; 64];
        let mut at = 2;
        while let Some(&[mark, marker]) = bytes.get(at..at + 2) {
            if mark != 0xff || matches!(marker, 0 | 0x01 | 0xd0..=0xd7) {
                at += 1; // entropy-coded data
                continue;
            }
            if marker == 0xff {
                at += 1;
                continue;
            }
            if marker == 0xd9 {
                break;
            }
            let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { break };
            let length = usize::from(u16::from_be_bytes([high, low])).max(2);
            if marker == 0xda
                && let Some(body) = bytes.get(at + 4..at + 2 + length)
                && let [.., from, to, bits] = *body
                && body[1..].chunks_exact(2).take(usize::from(body[0])).any(|choice| choice[0] == first.id)
                && bits.trailing_zeros() >= 4
            {
                whole.iter_mut().take(usize::from(to) + 1).skip(usize::from(from)).for_each(|k| *k = true);
            }
            at += 2 + length;
        }
        whole.iter().all(|k| *k)
    }

    /// True if the scan's data end before its last block. A scan of some colours only is taken for whole.
    fn blocks_missing(&self, scan: &[u8]) -> bool {
        if self.in_scan != self.components.len()
            || self.components.iter().any(|c| c.tables.iter().any(Option::is_none) || c.sampling.0 * c.sampling.1 == 0)
        {
            return false;
        }
        let alone = self.components.len() == 1;
        let most = |of: fn(&Component) -> u32| self.components.iter().map(of).max().unwrap_or(1).max(1);
        let (width, height) = if alone { (1, 1) } else { (most(|c| c.sampling.0), most(|c| c.sampling.1)) };
        let units = self.size.0.div_ceil(8 * width) * self.size.1.div_ceil(8 * height);
        let mut bits = Bits { data: scan, at: 0, buffer: 0, held: 0 };
        for unit in 0..units {
            if self.restart > 0 && unit > 0 && unit % self.restart == 0 && !bits.restart() {
                return true;
            }
            for component in &self.components {
                let blocks = if alone { 1 } else { component.sampling.0 * component.sampling.1 };
                for _ in 0..blocks {
                    match component.skip_block(&mut bits) {
                        Ok(()) => {}
                        Err(Fault::NoCode) => return false,
                        Err(Fault::End) => return true,
                    }
                }
            }
        }
        false
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

impl Component {
    /// Steps over one block.
    fn skip_block(&self, bits: &mut Bits) -> Result<(), Fault> {
        let [Some(dc), Some(ac)] = &self.tables else { return Err(Fault::NoCode) };
        let size = bits.symbol(dc)?;
        bits.skip(size)?;
        let mut k = 1;
        while k < 64 {
            let symbol = bits.symbol(ac)?;
            match (symbol >> 4, symbol & 15) {
                (15, 0) => k += 16,
                (_, 0) => break,
                (zeros, size) => {
                    bits.skip(size)?;
                    k += 1 + zeros;
                }
            }
        }
        Ok(())
    }
}

/// The bits of a scan, up to its next marker.
struct Bits<'a> {
    data: &'a [u8],
    at: usize,
    /// The next bits, `held` of them, the first one highest of these.
    buffer: u64,
    held: u8,
}

impl Bits<'_> {
    /// Holds more than 32 bits unless a marker follows.
    fn fill(&mut self) {
        while self.held <= 48 {
            let Some(&byte) = self.data.get(self.at) else { return };
            let stuffed = byte == 0xff;
            if stuffed && self.data.get(self.at + 1) != Some(&0) {
                return;
            }
            self.at += 1 + usize::from(stuffed);
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.held += 8;
        }
    }

    /// The next symbol.
    fn symbol(&mut self, table: &[(u8, u8)]) -> Result<u8, Fault> {
        self.fill();
        let next = if self.held >= 16 { self.buffer >> (self.held - 16) } else { self.buffer << (16 - self.held) };
        let (length, symbol) = table[(next & 0xffff) as usize];
        if length == 0 {
            return Err(if self.held < 16 { Fault::End } else { Fault::NoCode });
        }
        self.held = self.held.checked_sub(length).ok_or(Fault::End)?;
        Ok(symbol)
    }

    fn skip(&mut self, bits: u8) -> Result<(), Fault> {
        if self.held < bits {
            self.fill();
        }
        self.held = self.held.checked_sub(bits).ok_or(Fault::End)?;
        Ok(())
    }

    /// Steps over the restart marker that comes next; false if another marker does.
    fn restart(&mut self) -> bool {
        self.held = 0;
        while self.data.get(self.at..self.at + 2) == Some(&[0xff, 0xff]) {
            self.at += 1;
        }
        let there = matches!(self.data.get(self.at..self.at + 2), Some([0xff, 0xd0..=0xd7]));
        self.at += if there { 2 } else { 0 };
        there
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

    #[test]
    fn half_a_jpeg_is_noticed_with_and_without_an_end() {
        for (progressive, plain) in [(false, false), (true, false), (false, true), (true, true)] {
            let whole = photo(progressive, plain);
            assert!(!lacks_data(&whole), "{progressive} {plain}");
            // Previews of phones and tails of other programs follow the end.
            assert!(!lacks_data(&[&whole[..], &[0; 100]].concat()));
            for share in [0.55, 0.7, 0.9] {
                let head = (0..whole.len()).find(|&i| whole[i..].starts_with(&[0xff, 0xda])).unwrap();
                let cut = head + ((whole.len() - head) as f64 * share) as usize;
                assert!(lacks_data(&whole[..cut]));
                let ended = [&whole[..cut], &[0xff, 0xd9]].concat();
                // The last scan of a progressive JPEG only sharpens: a part of it is not missed.
                if !progressive || share < 0.6 {
                    assert!(lacks_data(&ended), "{progressive} {plain} {share}");
                }
            }
        }
    }
}
