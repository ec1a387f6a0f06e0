//! mkkellogg `.ksplat`: sections of Gaussians, plain (level 0) or quantised in buckets (levels 1 and 2).
//!
//! A header of 4,096 bytes, then one of 1,024 bytes per section, then each section's bucket lengths, bucket centres and
//! records. A record: mean, linear scale, quaternion (w, x, y, z), 8-bit red, green, blue, opacity, SH of bands 1 and
//! up, each band channel-major. Level 0 stores f32; levels 1 and 2 halves, 16-bit means about bucket centres; level 2
//! 8-bit SH (github.com/mkkellogg/GaussianSplats3D).

use half::f16;
use rayon::prelude::*;

use super::bytes::{f32_at, logit_of_byte, sh0_of_colour, u16_at, u32_at};
use super::fault::{Fault, malformed};
use super::{Format, Gaussians, Parsed, Tag};
use crate::gaussians::MAX_SH_DEGREE;

const HEADER: usize = 4096;
const SECTION_HEADER: usize = 1024;

/// Bytes of a mean and of one scale, rotation and SH value at each compression level.
const LEVELS: [Widths; 3] =
    [Widths { mean: 12, value: 4, sh: 4 }, Widths { mean: 6, value: 2, sh: 2 }, Widths { mean: 6, value: 2, sh: 1 }];

#[derive(Clone, Copy)]
struct Widths {
    mean: usize,
    value: usize,
    sh: usize,
}

/// Fields of the file's header that apply to all sections.
struct Common {
    level: usize,
    widths: Widths,
    sh_limits: [f32; 2],
}

/// One section, as slices of the file.
struct Section<'a> {
    degree: usize,
    records: &'a [u8],
    stride: usize,
    /// World units of one step of a 16-bit mean, and the step of the bucket's centre.
    step: f32,
    centre_step: f32,
    /// Bucket centres, and the bucket of each Gaussian; both empty at level 0.
    centres: Vec<[f32; 3]>,
    buckets: Vec<u32>,
}

/// Reads a whole `.ksplat` file.
pub(super) fn read(bytes: &[u8]) -> Result<Parsed, Fault> {
    let short = || {
        malformed("header", format!("{} bytes, at least {HEADER} needed; fetch or export the file again", bytes.len()))
    };
    let header = bytes.get(..HEADER).ok_or_else(short)?;
    let word = |offset| u32_at(header, offset).ok_or_else(short);
    if header[0] != 0 || header[1] == 0 {
        return Err(Fault::Unsupported(format!(
            "ksplat version {}.{}; versions 0.1 and later 0.x are read; export the file again",
            header[0], header[1]
        )));
    }
    let level = usize::from(u16_at(header, 20).ok_or_else(short)?);
    let widths = *LEVELS.get(level).ok_or_else(|| {
        malformed("header, byte 20", format!("compression level {level}, 0 to 2 expected; export the file again"))
    })?;
    // Zero means unset: files of version 0.1 without SH leave the limits out.
    let limit = |offset, unset| f32_at(header, offset).filter(|&x| x != 0.0).unwrap_or(unset);
    let common = Common { level, widths, sh_limits: [limit(36, -1.5), limit(40, 1.5)] };

    let count = word(4)? as usize;
    let mut at = count.checked_mul(SECTION_HEADER).and_then(|size| size.checked_add(HEADER)).ok_or_else(short)?;
    let headers = bytes.get(HEADER..at).ok_or_else(|| {
        malformed("header, byte 4", format!("{count} sections claimed, more than the file can hold; fetch it again"))
    })?;
    let mut sections = Vec::new();
    for (i, header) in headers.chunks_exact(SECTION_HEADER).enumerate() {
        let (section, end) = section(bytes, at, header, &common).map_err(|what| {
            malformed(format!("section {i}, byte {at}"), format!("{what}; fetch or export it again"))
        })?;
        sections.push(section);
        at = end;
    }

    let n: usize = sections.iter().map(Section::len).sum();
    let claimed = word(16)? as usize;
    if n != claimed {
        return Err(malformed(
            "header, byte 16",
            format!("{claimed} Gaussians claimed, {n} in the sections; export the file again"),
        ));
    }
    let degree = sections.iter().map(|section| section.degree).max().unwrap_or(0);
    let mut model = Gaussians { sh: vec![Vec::new(); degree + 1], ..Gaussians::default() };
    for section in &sections {
        section.append_to(&mut model, &common);
    }
    let trailing_bytes = (bytes.len() - at) as u64;
    Ok(Parsed { gaussians: model, format: Format::Ksplat, tag: Tag::default(), trailing_bytes })
}

/// Cuts out the section whose data begin at `at`; returns it with its end.
fn section<'a>(bytes: &'a [u8], at: usize, header: &[u8], common: &Common) -> Result<(Section<'a>, usize), String> {
    let word = |offset| u32_at(header, offset).unwrap_or(0) as usize;
    let (used, capacity) = (word(0), word(4));
    let (bucket_size, bucket_count) = (word(8), word(12));
    let block = f32_at(header, 16).unwrap_or(0.0);
    let centre_bytes = usize::from(u16_at(header, 20).unwrap_or(0));
    let range = if word(24) == 0 { 32767 } else { word(24) };
    let (full, partial) = (word(32), word(36));
    let degree = usize::from(u16_at(header, 40).unwrap_or(0));
    if degree > MAX_SH_DEGREE {
        return Err(format!("SH degree {degree}, at most {MAX_SH_DEGREE} is known"));
    }
    if used > capacity {
        return Err(format!("{used} Gaussians in room for {capacity}"));
    }

    let Widths { mean, value, sh } = common.widths;
    let stride = mean + 7 * value + 4 + 3 * ((degree + 1) * (degree + 1) - 1) * sh;
    let mut rest = bytes.get(at..).unwrap_or_default();
    let mut cut = |what: &str, count: usize, size: usize| {
        let size = count.checked_mul(size);
        let part = size.and_then(|size| rest.split_at_checked(size));
        let (part, tail) = part.ok_or_else(|| {
            format!("{count} {what} claimed, more than the {} bytes that are left can hold", rest.len())
        })?;
        rest = tail;
        Ok::<_, String>(part)
    };
    let lengths = cut("partly filled buckets", partial, 4)?;
    let centres = cut("buckets", bucket_count, centre_bytes)?;
    let records = cut("Gaussians", capacity, stride)?;
    let end = bytes.len() - rest.len();

    let mut section = Section {
        degree,
        records: &records[..used * stride],
        stride,
        step: block / 2.0 / range as f32,
        centre_step: range as f32,
        centres: Vec::new(),
        buckets: Vec::new(),
    };
    if common.level > 0 {
        if centre_bytes < 12 && bucket_count > 0 {
            return Err(format!("bucket centres of {centre_bytes} bytes, 12 expected"));
        }
        let axis = |centre: &[u8], i: usize| f32_at(centre, 4 * i).unwrap_or(0.0);
        section.centres =
            centres.chunks_exact(centre_bytes.max(1)).map(|c| [axis(c, 0), axis(c, 1), axis(c, 2)]).collect();
        let lengths = lengths.chunks_exact(4).map(|bytes| u32_at(bytes, 0).unwrap_or(0) as usize);
        section.buckets = buckets(used, std::iter::repeat_n(bucket_size, full.min(bucket_count)).chain(lengths))?;
        if section.buckets.last().is_some_and(|&last| last as usize >= bucket_count) {
            return Err(format!("Gaussians beyond the {bucket_count} buckets"));
        }
    }
    Ok((section, end))
}

/// Bucket index of each of `n` Gaussians, given the buckets' lengths.
fn buckets(n: usize, lengths: impl Iterator<Item = usize>) -> Result<Vec<u32>, String> {
    let mut buckets = Vec::with_capacity(n);
    for (bucket, length) in lengths.enumerate() {
        buckets.extend(std::iter::repeat_n(bucket as u32, length.min(n - buckets.len())));
    }
    if buckets.len() < n {
        return Err(format!("buckets for {} of {n} Gaussians", buckets.len()));
    }
    Ok(buckets)
}

impl Section<'_> {
    fn len(&self) -> usize {
        self.records.len() / self.stride
    }

    /// Decodes the records behind those already in `model`; bands that this section lacks are zero.
    fn append_to(&self, model: &mut Gaussians, common: &Common) {
        let Widths { mean, value, sh } = common.widths;
        let (scale_at, rotation_at, colour_at, sh_at) =
            (mean, mean + 3 * value, mean + 7 * value, mean + 7 * value + 4);
        let records = || self.records.par_chunks_exact(self.stride);
        let float = |record: &[u8], at: usize, width: usize| match width {
            4 => f32_at(record, at).unwrap_or(0.0),
            2 => f16::from_bits(u16_at(record, at).unwrap_or(0)).to_f32(),
            _ => {
                let [low, high] = common.sh_limits;
                low + f32::from(record[at]) / 255.0 * (high - low)
            }
        };
        model.means.par_extend(records().enumerate().map(|(i, record)| {
            [0, 1, 2].map(|axis: usize| match self.buckets.get(i) {
                None => float(record, 4 * axis, 4),
                Some(&bucket) => {
                    let steps = f32::from(u16_at(record, 2 * axis).unwrap_or(0)) - self.centre_step;
                    steps * self.step + self.centres[bucket as usize][axis]
                }
            })
        }));
        model.log_scales.par_extend(records().map(|r| [0, 1, 2].map(|i| float(r, scale_at + i * value, value).ln())));
        model.rotations.par_extend(records().map(|r| [0, 1, 2, 3].map(|i| float(r, rotation_at + i * value, value))));
        model.opacity_logits.par_extend(records().map(|r| logit_of_byte(r[colour_at + 3])));
        for record in self.records.chunks_exact(self.stride) {
            let colours = &record[colour_at..colour_at + 3];
            model.sh[0].extend(colours.iter().map(|&c| sh0_of_colour(f32::from(c) / 255.0)));
        }
        for (l, band) in model.sh.iter_mut().enumerate().skip(1) {
            if l > self.degree {
                band.resize(band.len() + self.len() * Gaussians::band_width(l), 0.0);
                continue;
            }
            let (before, coefficients) = (3 * (l * l - 1), 2 * l + 1);
            for record in self.records.chunks_exact(self.stride) {
                for m in 0..coefficients {
                    let at = |channel: usize| sh_at + (before + channel * coefficients + m) * sh;
                    band.extend([0, 1, 2].map(|channel| float(record, at(channel), sh)));
                }
            }
        }
    }
}
