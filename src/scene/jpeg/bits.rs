//! The blocks of a JPEG's scan, and the bits that they are coded in.

/// A marker instead of a code.
pub(super) enum Fault {
    /// The data end.
    End,
    /// Bits that no table has: damaged otherwise, or not of this kind.
    NoCode,
}

/// The blocks of a scan, one after the other.
pub(super) struct Blocks<'a> {
    bits: Bits<'a>,
    /// Their first and their last coefficient besides the constant one.
    band: [u8; 2],
    /// The number of next blocks in which this scan finds no coefficient.
    run: u64,
}

impl<'a> Blocks<'a> {
    /// The blocks of the scan whose data begin here.
    pub(super) fn new(data: &'a [u8], band: [u8; 2]) -> Self {
        Self { bits: Bits { data, at: 0, buffer: 0, held: 0 }, band, run: 0 }
    }

    /// Steps over the restart marker that comes next.
    pub(super) fn restart(&mut self) -> Result<(), Fault> {
        self.run = 0;
        if self.bits.restart() { Ok(()) } else { Err(Fault::End) }
    }

    /// Steps over the first coefficient of a block.
    pub(super) fn skip_dc(&mut self, dc: &[(u8, u8)]) -> Result<(), Fault> {
        let size = self.bits.symbol(dc)?;
        self.bits.skip(size)
    }

    /// Steps over the next bit of a block's first coefficient.
    pub(super) fn refine_dc(&mut self) -> Result<(), Fault> {
        self.bits.skip(1)
    }

    /// Steps over one block with all its coefficients.
    pub(super) fn skip(&mut self, dc: &[(u8, u8)], ac: &[(u8, u8)]) -> Result<(), Fault> {
        self.skip_dc(dc)?;
        self.run = 0; // a run of blocks, which only progressive scans have
        self.begin(ac, &mut 0)
    }

    /// Steps over a block's first bits of the band's coefficients, and adds those that are not zero.
    pub(super) fn begin(&mut self, ac: &[(u8, u8)], found: &mut u64) -> Result<(), Fault> {
        if self.run > 0 {
            self.run -= 1;
            return Ok(());
        }
        let [mut k, to] = self.band;
        while k <= to {
            let symbol = self.bits.symbol(ac)?;
            match (symbol >> 4, symbol & 15) {
                (15, 0) => k += 16,
                (digits, 0) => {
                    self.run = (1_u64 << digits) - 1 + self.bits.take(digits)?;
                    break;
                }
                (zeros, size) => {
                    self.bits.skip(size)?;
                    k += zeros;
                    *found |= bit(k);
                    k += 1;
                }
            }
        }
        Ok(())
    }

    /// Steps over a block's next bits of the band's coefficients: one for each that was not zero before, and the first ones of
    /// others, which it adds.
    pub(super) fn refine(&mut self, ac: &[(u8, u8)], found: &mut u64) -> Result<(), Fault> {
        let [mut k, to] = self.band;
        while self.run == 0 && k <= to {
            let symbol = self.bits.symbol(ac)?;
            let (mut zeros, size) = (symbol >> 4, symbol & 15);
            if size == 0 && zeros < 15 {
                self.run = (1_u64 << zeros) + self.bits.take(zeros)?;
                break;
            }
            self.bits.skip(u8::from(size > 0))?; // the sign
            while k <= to && (*found & bit(k) > 0 || zeros > 0) {
                if *found & bit(k) > 0 {
                    self.bits.skip(1)?;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
            *found |= if size > 0 && k <= to { bit(k) } else { 0 };
            k += 1;
        }
        if self.run > 0 {
            for k in k..=to {
                self.bits.skip(u8::from(*found & bit(k) > 0))?;
            }
            self.run -= 1;
        }
        Ok(())
    }
}

/// The bit of a coefficient; none beyond the last.
fn bit(k: u8) -> u64 {
    1_u64.checked_shl(u32::from(k)).unwrap_or(0)
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

    /// The number that the next bits are.
    fn take(&mut self, bits: u8) -> Result<u64, Fault> {
        if self.held < bits {
            self.fill();
        }
        self.held = self.held.checked_sub(bits).ok_or(Fault::End)?;
        Ok((self.buffer >> self.held) & ((1_u64 << bits) - 1))
    }

    fn skip(&mut self, bits: u8) -> Result<(), Fault> {
        self.take(bits).map(|_| ())
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
