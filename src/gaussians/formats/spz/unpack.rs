//! Reading SPZ.
//!
//! Versions 1 to 3: gzip round a header of 16 bytes (magic, version, count: u32; SH degree, fractional bits, flags,
//! reserved: u8) and the attributes one after the other: positions, alphas, colours, scales, rotations, SH. Files of
//! these versions without the gzip layer occur and are read.
//!
//! Version 4 (layout from the official library's README and load-spz.cc, confirmed on files): a plain header of 32
//! bytes, the same 16 with the number of streams as the last byte, then the table's offset (u32) and 12 bytes of zeros;
//! extension records up to the table; the table, a pair (compressed, uncompressed) of byte counts as u64 per stream;
//! one zstd frame per attribute in the same order, empty attributes left out (no SH stream at degree 0).

use std::io::Read;

use half::f16;
use rayon::prelude::*;

use super::super::axes::{RIGHT_DOWN_FRONT, RIGHT_UP_BACK, convert};
use super::super::bytes::{field, from_smallest_three, logit_of_byte, u32_at, u64_at};
use super::super::fault::{Fault, malformed};
use super::super::gzip::{self, Members};
use super::super::limit::fits;
use super::super::{Format, Gaussians, Parsed, Tag};
use super::{COLOUR_SCALE, FLAG_ANTIALIASED, HEADER, MAGIC};
use crate::gaussians::MAX_SH_DEGREE;

const LEGACY_HEADER: usize = 16;
const NAMES: [&str; 6] = ["positions", "alphas", "colours", "scales", "rotations", "SH"];
const AGAIN: &str = "fetch or export the file again";

/// Bytes beyond the attributes that are looked at for extensions and for gzip's checksum.
const MAX_TAIL: u64 = 1 << 20;
const FLAG_EXTENSIONS: u8 = 2;
const COORDINATE_SYSTEM: u32 = 0xADBE_0003;

/// True if a gzip file may hold SPZ: what it begins with, if it can be unpacked at all.
pub(in super::super) fn is_inside(bytes: &[u8]) -> bool {
    let mut start = [0; 3];
    let other: [&[u8]; 6] = [b"ply", b"PK\x03", b"glT", b"#us", b"\x1f\x8b\x08", b"{\n "];
    Members::new(bytes).read_exact(&mut start).is_err() || !other.contains(&start.as_slice())
}

/// The fields that all versions share.
struct Header {
    version: u32,
    n: usize,
    degree: usize,
    fractional_bits: u8,
    antialiased: bool,
    extended: bool,
    streams: usize,
    around: Around,
}

/// Facts about an SPZ from the file that contains it.
#[derive(Clone, Copy)]
pub(in super::super) struct Around {
    /// The axes, unless an extension of SPZ names others.
    pub axes: u32,
    /// The number of Gaussians.
    pub count: Option<usize>,
}

/// An SPZ that is a file.
const ALONE: Around = Around { axes: RIGHT_UP_BACK, count: None };

impl Header {
    fn parse(bytes: &[u8], around: Around) -> Result<Self, Fault> {
        let (Some(MAGIC), Some(version), Some(n), Some([degree, fractional_bits, flags, streams])) =
            (u32_at(bytes, 0), u32_at(bytes, 4), u32_at(bytes, 8), field(bytes, 12))
        else {
            return Err(malformed("header", format!("no NGSP header of {LEGACY_HEADER} bytes; {AGAIN}")));
        };
        if !(1..=4).contains(&version) {
            return Err(Fault::Unsupported(format!(
                "SPZ version {version}; versions 1 to 4 are read; export it as one"
            )));
        }
        if usize::from(degree) > MAX_SH_DEGREE {
            return Err(Fault::Unsupported(format!(
                "SH degree {degree}, at most {MAX_SH_DEGREE} is known; export the file with a lower degree"
            )));
        }
        if fractional_bits > 30 {
            return Err(malformed(
                "header, byte 13",
                format!("{fractional_bits} fractional bits, at most 30; {AGAIN}"),
            ));
        }
        Ok(Self {
            version,
            n: n as usize,
            degree: usize::from(degree),
            fractional_bits,
            antialiased: flags & FLAG_ANTIALIASED != 0,
            extended: flags & FLAG_EXTENSIONS != 0,
            streams: usize::from(streams),
            around,
        })
    }

    /// Bytes per Gaussian of each attribute.
    fn widths(&self) -> [usize; 6] {
        let sh = 3 * ((self.degree + 1) * (self.degree + 1) - 1);
        [if self.version == 1 { 6 } else { 9 }, 1, 3, 3, if self.version < 3 { 3 } else { 4 }, sh]
    }

    /// Bytes of all attributes; fails if a file of `available` bytes cannot hold that many Gaussians, or should hold others.
    fn body(&self, available: usize) -> Result<usize, Fault> {
        if let Some(count) = self.around.count.filter(|count| *count != self.n) {
            let what = format!("{} Gaussians claimed, {count} by the file around it; {AGAIN}", self.n);
            return Err(malformed("header of the SPZ inside, byte 8", what));
        }
        let body = self.n.checked_mul(self.widths().iter().sum());
        body.filter(|_| fits(self.n, self.degree, available)).ok_or_else(|| {
            malformed(
                "header, byte 8",
                format!("{} Gaussians claimed, more than a file of {available} bytes can hold; {AGAIN}", self.n),
            )
        })
    }
}

/// Reads a whole SPZ file of any version.
pub(in super::super) fn read(bytes: &[u8]) -> Result<Parsed, Fault> {
    read_in(bytes, ALONE)
}

/// Reads a whole SPZ file of any version inside another file.
pub(in super::super) fn read_in(bytes: &[u8], around: Around) -> Result<Parsed, Fault> {
    if bytes.starts_with(&gzip::MAGIC) {
        return read_gzip(bytes, around);
    }
    let header = Header::parse(bytes, around)?;
    if header.version < 4 {
        header.body(bytes.len())?;
        return read_legacy(&header, bytes, "");
    }
    read_streams(&header, bytes)
}

fn read_gzip(bytes: &[u8], around: Around) -> Result<Parsed, Fault> {
    let mut decoder = Members::new(bytes);
    let mut plain = Vec::new();
    let damaged = |count: usize, error: &std::io::Error| {
        malformed(
            format!("gzip stream, uncompressed byte {count}"),
            format!("the stream breaks off or is damaged ({error}); {AGAIN}"),
        )
    };
    if let Err(error) = decoder.by_ref().take(LEGACY_HEADER as u64).read_to_end(&mut plain) {
        return Err(damaged(plain.len(), &error));
    }
    let header = Header::parse(&plain, around)?;
    let body = header.body(bytes.len())? as u64;
    // Reading past the attributes to the end makes the decoder verify the checksum.
    match decoder.take(body + MAX_TAIL).read_to_end(&mut plain) {
        Ok(_) => read_legacy(&header, &plain, ""),
        Err(error) => match read_legacy(&header, &plain, "; the gzip stream breaks off or is damaged there") {
            Ok(_) => Err(damaged(plain.len(), &error)),
            Err(fault) => Err(fault),
        },
    }
}

/// Reads an uncompressed body of versions 1 to 3 that follows its header in `plain`.
fn read_legacy(header: &Header, plain: &[u8], hint: &str) -> Result<Parsed, Fault> {
    let mut rest = &plain[LEGACY_HEADER..];
    let mut streams = [&[][..]; 6];
    for ((stream, width), name) in streams.iter_mut().zip(header.widths()).zip(NAMES) {
        let at = plain.len() - rest.len();
        (*stream, rest) = rest.split_at_checked(width * header.n).ok_or_else(|| {
            malformed(
                format!("{name}, uncompressed byte {at}"),
                format!(
                    "{} whole rows of the {} that the header claims{hint}; {AGAIN}",
                    rest.len() / width.max(1),
                    header.n
                ),
            )
        })?;
    }
    let (system, trailing) =
        if header.extended { (stored_system(rest, header.around.axes)?, 0) } else { (header.around.axes, rest.len()) };
    Ok(decode(header, &streams, system, trailing as u64))
}

fn read_streams(header: &Header, bytes: &[u8]) -> Result<Parsed, Fault> {
    let cut = |what: String| malformed(what, format!("the file ends at byte {}; {AGAIN}", bytes.len()));
    header.body(bytes.len())?;
    let table = u32_at(bytes, 16).ok_or_else(|| cut("header".into()))? as usize;
    let extensions = bytes.get(HEADER..table).ok_or_else(|| cut(format!("table of streams at byte {table}")))?;
    let system = if header.extended { stored_system(extensions, header.around.axes)? } else { header.around.axes };

    let sizes = header.widths().map(|width| width * header.n);
    let needed: Vec<usize> = (0..6).filter(|&i| sizes[i] > 0).collect();
    if header.streams < needed.len() {
        let what = format!("{} streams, {} expected; {AGAIN}", header.streams, needed.len());
        return Err(malformed("header, byte 15", what));
    }
    let mut at = table + 16 * header.streams;
    let mut packed = Vec::new();
    for i in 0..header.streams {
        let entry = table + 16 * i;
        let (Some(compressed), Some(size)) = (u64_at(bytes, entry), u64_at(bytes, entry + 8)) else {
            return Err(cut(format!("table entry {i}, byte {entry}")));
        };
        let name = needed.get(i).map_or("further", |&i| NAMES[i]);
        let end = usize::try_from(compressed).ok().and_then(|size| at.checked_add(size));
        let frame = end
            .and_then(|end| bytes.get(at..end))
            .ok_or_else(|| cut(format!("{name} stream of {compressed} bytes at byte {at}")))?;
        if let Some(&attribute) = needed.get(i) {
            if size != sizes[attribute] as u64 {
                let n = header.n;
                let what =
                    format!("{size} bytes uncompressed, {} expected for {n} Gaussians; {AGAIN}", sizes[attribute]);
                return Err(malformed(format!("table entry {i} ({name}), byte {entry}"), what));
            }
            packed.push((attribute, frame, at));
        }
        at += frame.len();
    }

    let plain: Vec<(usize, Vec<u8>)> = packed
        .into_par_iter()
        .map(|(attribute, frame, at)| {
            let size = sizes[attribute];
            let damaged = |what: String| malformed(format!("{} stream, byte {at}", NAMES[attribute]), what);
            // The buffer grows with the output: a claimed size alone must not cost memory.
            let mut plain = Vec::new();
            zstd::Decoder::with_buffer(frame)
                .and_then(|decoder| decoder.take(size as u64 + 1).read_to_end(&mut plain))
                .map_err(|error| damaged(format!("damaged zstd data ({error}); {AGAIN}")))?;
            if plain.len() != size {
                let more = if plain.len() > size { " or more" } else { "" };
                return Err(damaged(format!(
                    "{}{more} bytes after decompression, {size} expected; {AGAIN}",
                    plain.len()
                )));
            }
            Ok((attribute, plain))
        })
        .collect::<Result<_, Fault>>()?;
    let mut streams = [&[][..]; 6];
    for (attribute, plain) in &plain {
        streams[*attribute] = plain;
    }
    Ok(decode(header, &streams, system, (bytes.len() - at) as u64))
}

/// The coordinate system that an extension record (type, length: u32; payload) states, or the usual one.
fn stored_system(mut records: &[u8], usual: u32) -> Result<u32, Fault> {
    while let (Some(kind), Some(length)) = (u32_at(records, 0), u32_at(records, 4)) {
        let Some(payload) = records.get(8..).and_then(|rest| rest.get(..length as usize)) else { break };
        match u32_at(payload, 0) {
            Some(system @ 1..=8) if kind == COORDINATE_SYSTEM => return Ok(system),
            Some(system @ 9..) if kind == COORDINATE_SYSTEM => {
                return Err(Fault::Unsupported(format!(
                    "stored in coordinate system {system}, whose axes are permuted; export it as RUB or RDF"
                )));
            }
            _ => {}
        }
        records = &records[8 + payload.len()..];
    }
    Ok(usual)
}

/// Decodes the six attributes, each of exactly `n` rows.
fn decode(header: &Header, streams: &[&[u8]; 6], system: u32, trailing_bytes: u64) -> Parsed {
    let [positions, alphas, colours, scales, rotations, sh] = *streams;
    let unit = 2f32.powi(-i32::from(header.fractional_bits));
    let fixed = |b: &[u8]| (i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) as f32 * unit;
    let rest_width = header.widths()[5];
    let mut model = Gaussians {
        means: if header.version == 1 {
            let float = |b: &[u8]| f16::from_le_bytes([b[0], b[1]]).to_f32();
            positions.par_chunks_exact(6).map(|p| [float(p), float(&p[2..]), float(&p[4..])]).collect()
        } else {
            positions.par_chunks_exact(9).map(|p| [fixed(p), fixed(&p[3..]), fixed(&p[6..])]).collect()
        },
        log_scales: scales
            .par_chunks_exact(3)
            .map(|s| [s[0], s[1], s[2]].map(|s| f32::from(s) / 16.0 - 10.0))
            .collect(),
        rotations: if header.version < 3 {
            rotations.par_chunks_exact(3).map(|r| first_three([r[0], r[1], r[2]])).collect()
        } else {
            rotations.par_chunks_exact(4).map(|r| smallest_three([r[0], r[1], r[2], r[3]])).collect()
        },
        opacity_logits: alphas.par_iter().map(|&alpha| logit_of_byte(alpha)).collect(),
        sh: vec![colours.par_iter().map(|&c| (f32::from(c) / 255.0 - 0.5) / COLOUR_SCALE).collect()],
    };
    for l in 1..=header.degree {
        let before = 3 * (l * l - 1);
        let mut band = vec![0.0; header.n * Gaussians::band_width(l)];
        let rows = band.par_chunks_exact_mut(Gaussians::band_width(l)).zip(sh.par_chunks_exact(rest_width));
        rows.for_each(|(out, row)| {
            for (out, &byte) in out.iter_mut().zip(&row[before..]) {
                *out = (f32::from(byte) - 128.0) / 128.0;
            }
        });
        model.sh.push(band);
    }
    convert(&mut model, system, RIGHT_DOWN_FRONT);
    Parsed { gaussians: model, format: Format::Spz, tag: Tag::of_bit(header.antialiased), trailing_bytes }
}

/// Versions 1 and 2: x, y, z in 8 bits each, w >= 0 from unit length.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    from_smallest_three(bytes.map(|byte| f32::from(byte) / 127.5 - 1.0), 0)
}

/// Versions 3 and 4: 2 bits for the greatest of (x, y, z, w), then sign and 9 bits each of the others over sqrt(1/2).
fn smallest_three(bytes: [u8; 4]) -> [f32; 4] {
    let word = u32::from_le_bytes(bytes);
    let smaller = [20, 10, 0].map(|shift| {
        let magnitude = (word >> shift & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        if word >> shift & 512 == 0 { magnitude } else { -magnitude }
    });
    let [x, y, z, w] = from_smallest_three(smaller, (word >> 30) as usize);
    [w, x, y, z]
}

/// Bytes of each attribute's stream in a file of version 4; nothing of others.
pub(in super::super) fn parts(bytes: &[u8]) -> Vec<(&'static str, u64)> {
    let Ok(Header { version: 4, streams, .. }) = Header::parse(bytes, ALONE) else { return Vec::new() };
    let table = u32_at(bytes, 16).unwrap_or_default() as usize;
    NAMES
        .iter()
        .take(streams)
        .enumerate()
        .filter_map(|(i, name)| Some((*name, u64_at(bytes, table + 16 * i)?)))
        .collect()
}
