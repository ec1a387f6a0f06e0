//! Mutations of bytes: damage by disks, cables, editors, careless writers and attackers.

use qirf_vk::random;

/// Random numbers of one case.
pub struct Rng {
    key: u64,
    drawn: u64,
}

impl Rng {
    pub fn new(key: u64) -> Self {
        Self { key, drawn: 0 }
    }

    pub fn next(&mut self) -> u64 {
        self.drawn += 1;
        random::bits(&[0x006d_7574_6174_6531, self.key, self.drawn])
    }

    /// Uniform in 0..n; 0 if there is nothing to choose from.
    pub fn below(&mut self, n: usize) -> usize {
        if n == 0 { 0 } else { (self.next() % n as u64) as usize }
    }

    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len())]
    }

    /// A place in `len` bytes: half the time near the start, where counts and types are.
    fn place(&mut self, len: usize) -> usize {
        let head = self.of(&[16, 64, 256, usize::MAX, usize::MAX, usize::MAX]);
        self.below(len.min(head))
    }

    /// A range within `len` bytes, mostly short.
    fn range(&mut self, len: usize) -> std::ops::Range<usize> {
        let start = self.place(len);
        let most = self.of(&[4, 16, 64, 512, usize::MAX]);
        start..start + self.below((len - start).min(most) + 1)
    }
}

const BYTES: [u8; 10] = [0, 1, 2, 0x7f, 0x80, 0xfe, 0xff, b'\n', b' ', b'-'];
const WORDS: [u64; 12] = [
    0,
    1,
    0xff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    0xffff_ffff_ffff_ffff,
    0x1_0000,
];
const FLOATS: [f64; 8] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -0.0, 1e38, -1e300, 1e-40, 1e9];
const TEXTS: [&str; 20] = [
    "0",
    "-1",
    "1",
    "2",
    "255",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "99999999999999999999",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "-1e300",
    "1e-320",
    "0x10",
    "",
    "null",
    "\"",
];

/// The bytes after one to four mutations; `other` lends parts of another file.
pub fn mutate(rng: &mut Rng, bytes: &[u8], other: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..rng.of(&[1, 1, 1, 2, 2, 3, 4]) {
        once(rng, &mut out, other);
    }
    out
}

fn once(rng: &mut Rng, out: &mut Vec<u8>, other: &[u8]) {
    let len = out.len();
    if len == 0 {
        out.extend_from_slice(&other[rng.range(other.len())]);
        return;
    }
    match rng.below(17) {
        0..=2 => out[rng.place(len)] ^= 1 << rng.below(8),
        3 => out[rng.place(len)] = rng.next() as u8,
        4 => out[rng.place(len)] = rng.of(&BYTES),
        5 | 6 => {
            let width = rng.of(&[2, 4, 4, 8]);
            let word = match rng.below(3) {
                0 => rng.of(&FLOATS).to_le_bytes(),
                1 => u64::from((rng.of(&FLOATS) as f32).to_bits()).to_le_bytes(),
                _ => rng.of(&WORDS).to_le_bytes(),
            };
            overwrite(out, rng.place(len), &word[..width]);
        }
        7 => out.truncate(rng.place(len)),
        8 => drop(out.drain(rng.range(len))),
        9 => {
            let copy = out[rng.range(len)].to_vec();
            let at = rng.place(len);
            out.splice(at..at, copy);
        }
        10 => {
            let (a, b, n) = (rng.place(len), rng.place(len), rng.of(&[1, 4, 8, 64]));
            for k in 0..n.min(len - a).min(len - b) {
                out.swap(a + k, b + k);
            }
        }
        11 => {
            let range = rng.range(len);
            for i in (1..range.len()).rev() {
                out.swap(range.start + i, range.start + rng.below(i + 1));
            }
        }
        12 => {
            let part = other[rng.range(other.len())].to_vec();
            let at = rng.place(len);
            if rng.below(2) == 0 { drop(out.splice(at..at, part)) } else { overwrite(out, at, &part) }
        }
        13 => {
            let n = rng.below(300);
            out.extend((0..n).map(|_| rng.next() as u8));
        }
        14 | 15 => number(rng, out),
        _ => lines(rng, out),
    }
}

fn overwrite(out: &mut [u8], at: usize, with: &[u8]) {
    out[at..].iter_mut().zip(with).for_each(|(byte, new)| *byte = *new);
}

/// Replaces a number in text by another.
fn number(rng: &mut Rng, out: &mut Vec<u8>) {
    let start = rng.place(out.len());
    let Some(at) = out[start..].iter().position(u8::is_ascii_digit).map(|at| start + at) else { return };
    let part = |b: &u8| b.is_ascii_alphanumeric() || b"+-.".contains(b);
    let end = out[at..].iter().position(|b| !part(b)).map_or(out.len(), |n| at + n);
    let text = rng.of(&TEXTS);
    out.splice(at..end, text.bytes());
}

/// Swaps, drops or repeats a line.
fn lines(rng: &mut Rng, out: &mut Vec<u8>) {
    let mut lines: Vec<Vec<u8>> = out.split_inclusive(|&b| b == b'\n').map(<[u8]>::to_vec).collect();
    let (a, b) = (rng.below(lines.len()), rng.below(lines.len()));
    match rng.below(3) {
        0 => lines.swap(a, b),
        1 => drop(lines.remove(a)),
        _ => lines.insert(b, lines[a].clone()),
    }
    *out = lines.concat();
}
