//! Values on the command line: sizes, colours, resolutions, directions.

use crate::gaussians::formats::SpzPrecision;
use crate::job::config::ranges::MOST_GAUSSIANS;
use crate::qirf::partition::Partition;
use crate::render::Style;
use crate::scene::Resize;
use crate::scene::orbit::UP;
use crate::train::growth::Growth;
use crate::wording::{file_size, unknown};
use clap::ValueEnum;
use clap::builder::{PossibleValue, TypedValueParser};
use glam::DVec3;
use std::ffi::OsStr;
use std::str::FromStr;

/// Largest side of a picture in pixels.
const LARGEST_SIDE: u32 = 65_535;

/// A number that fits; `form` says what to write.
fn number<T: FromStr>(text: &str, fits: impl Fn(&T) -> bool, form: &str) -> Result<T, String> {
    text.parse().ok().filter(fits).ok_or_else(|| form.to_owned())
}

/// Finite numbers between commas.
pub(super) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let all: Option<Vec<f64>> = text.split(',').map(finite).collect();
    all?.try_into().ok()
}

/// A finite number.
pub(super) fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|x| x.is_finite())
}

/// `1280x720`.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |t: &str| t.parse::<u32>().ok().filter(|s| (1..=LARGEST_SIDE).contains(s));
    let parts = text.split_once(['x', 'X']).and_then(|(w, h)| Some((side(w)?, side(h)?)));
    parts.ok_or_else(|| format!("write WIDTHxHEIGHT, each 1 to {LARGEST_SIDE}, such as 1280x720"))
}

/// `640` (largest width) or `/4` (divisor).
pub(super) fn resolution(text: &str) -> Result<Resize, String> {
    text.parse()
}

/// One of the dilations in use.
pub(super) fn dilation(text: &str) -> Result<f32, String> {
    let known = Style::DILATIONS;
    let asked = text.parse::<f32>().ok().filter(|asked| known.contains(asked));
    asked.ok_or_else(|| format!("write {} or {}", known[0], known[1]))
}

/// An angle from a pole, in degrees: 0 to 90.
pub(super) fn pole(text: &str) -> Result<f64, String> {
    number(text, |angle| (0.0..=90.0).contains(angle), "write degrees from 0 to 90, such as 20")
}

/// The text of a [`resolution`], as given.
pub(super) fn resolution_text(text: &str) -> Result<String, String> {
    resolution(text).map(|_| text.to_owned())
}

/// `2G`, `800M` or a plain number of bytes.
pub(super) fn bytes(text: &str) -> Result<u64, String> {
    let (digits, unit) = match text.char_indices().last() {
        Some((at, 'k' | 'K')) => (&text[..at], 1_u64 << 10),
        Some((at, 'm' | 'M')) => (&text[..at], 1 << 20),
        Some((at, 'g' | 'G')) => (&text[..at], 1 << 30),
        _ => (text, 1),
    };
    let parsed = digits.parse::<u64>().ok().and_then(|n| n.checked_mul(unit)).filter(|n| *n > 0);
    parsed.ok_or_else(|| "write a number of bytes, such as 2G, 800M or 1000000".to_owned())
}

/// A size: that of pictures, or that of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Size {
    /// Width and height in pixels.
    Pictures(u32, u32),
    /// Bytes.
    File(u64),
}

/// `5MB`, `800kB`, `2.5MiB`, or `640x480` for pictures.
pub(super) fn size_of_file_or_pictures(text: &str) -> Result<Size, String> {
    let is_file = text.to_ascii_lowercase().ends_with('b');
    match size(text) {
        Ok((width, height)) if !is_file => Ok(Size::Pictures(width, height)),
        Err(fault) if text.contains(['x', 'X']) && !is_file => Err(fault),
        _ => file_size(text).map(Size::File),
    }
}

/// `6`, or `6,5`: bits of SH coefficients in SPZ, of band 1 and of the others.
pub(super) fn sh_bits(text: &str) -> Result<SpzPrecision, String> {
    let bits = |t: &str| t.trim().parse::<u8>().ok().filter(|b| (1..=8).contains(b));
    let (first, others) = text.split_once(',').unwrap_or((text, text));
    let both = bits(first).zip(bits(others)).map(|(first, others)| SpzPrecision { first, others, means: None });
    both.ok_or_else(|| "write 1 to 8, such as 8, or 6,5 for band 1 and the others".to_owned())
}

/// PSNR in dB, 5 to 100.
pub(super) fn psnr(text: &str) -> Result<f64, String> {
    let text = text.trim_end_matches("dB").trim_end();
    number(text, |v| (5.0..=100.0).contains(v), "write a PSNR in dB from 5 to 100, such as 35")
}

/// Growth as it was asked for: to a planned number, or, if none, by the thresholds of gradients.
#[derive(Clone, Copy, Debug)]
pub(super) struct GrowTo(pub Option<Growth>);

/// `auto`, `thresholds` or a number of Gaussians.
pub(super) fn growth(text: &str) -> Result<GrowTo, String> {
    let form = format!("write auto, thresholds or a number from 1 to {MOST_GAUSSIANS}");
    let usable = |n: &usize| (1..=MOST_GAUSSIANS).contains(n);
    Ok(GrowTo(match text {
        "auto" => Some(Growth::default()),
        "thresholds" => None,
        _ => Some(Growth { gaussians: Some(number(text, usable, &form)?), ..Growth::default() }),
    }))
}

/// A share above 0, up to 1.
pub(super) fn share(text: &str) -> Result<f64, String> {
    number(text, |v| *v > 0.0 && *v <= 1.0, "write a share above 0 and up to 1, such as 0.28")
}

/// A share from 0 to 1.
pub(super) fn share_or_none(text: &str) -> Result<f64, String> {
    number(text, |v| (0.0..=1.0).contains(v), "write a share from 0 to 1, such as 0.05")
}

/// A finite number of 0 or more.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |v: &f64| v.is_finite() && *v >= 0.0, "write a number of 0 or more")
}

/// `X,Y,Z` in world units.
pub(super) fn point(text: &str) -> Result<DVec3, String> {
    numbers(text).map(DVec3::from_array).ok_or_else(|| "write x,y,z, such as 0,1.5,-2".to_owned())
}

/// Frames per second, above 0, up to 1000.
pub(super) fn frame_rate(text: &str) -> Result<f64, String> {
    number(text, |v| *v > 0.0 && *v <= 1000.0, "write frames per second, above 0 and up to 1000")
}

/// A whole number of 0 or more.
pub(super) fn whole<T: FromStr>(text: &str) -> Result<T, String> {
    number(text, |_| true, "write a whole number of 0 or more")
}

/// A number of seconds, 1 to 3600.
pub(super) fn seconds(text: &str) -> Result<u64, String> {
    number(text, |n| (1..=3600).contains(n), "write a whole number of seconds from 1 to 3600")
}

/// A parser of names, which help and completions list.
#[derive(Clone)]
pub(super) struct Names<T> {
    /// The names, each with what it stands for.
    listed: Vec<(PossibleValue, T)>,
    /// Noun for the things named, with its article: "a preset".
    what: &'static str,
}

impl<T: Clone + Send + Sync + 'static> TypedValueParser for Names<T> {
    type Value = T;

    fn parse_ref(&self, cmd: &clap::Command, arg: Option<&clap::Arg>, value: &OsStr) -> Result<T, clap::Error> {
        let Self { listed, what } = self.clone();
        let ignore_case = arg.is_some_and(clap::Arg::is_ignore_case_set);
        let read = move |text: &str| {
            let found = listed.iter().find(|(name, _)| name.matches(text, ignore_case));
            let names = listed.iter().map(|(name, _)| name.get_name());
            found.map(|(_, value)| value.clone()).ok_or_else(|| unknown(text, what, names))
        };
        read.parse_ref(cmd, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.listed.iter().map(|(name, _)| name.clone())))
    }
}

/// The names of a type whose help lists each with its meaning. `what` has its article: "a preset".
pub(super) fn one_of<T: ValueEnum>(what: &'static str) -> Names<T> {
    let listed = |value: &T| Some((value.to_possible_value()?, value.clone()));
    Names { listed: T::value_variants().iter().filter_map(listed).collect(), what }
}

/// These values by their names, as in the configuration file. `what` has its article: "a selector".
pub(super) fn named<T: Copy>(what: &'static str, all: &[T], name: fn(T) -> &'static str) -> Names<T> {
    Names { listed: all.iter().map(|value| (PossibleValue::new(name(*value)), *value)).collect(), what }
}

/// `on` or `off`; true, yes, 1 and their opposites mean the same.
pub(super) fn switch() -> Names<bool> {
    let on = PossibleValue::new("on").aliases(["true", "yes", "t", "y", "1"]);
    let off = PossibleValue::new("off").aliases(["false", "no", "f", "n", "0"]);
    Names { listed: vec![(on, true), (off, false)], what: "a choice" }
}

/// `adaptive`, `adaptive:MOST` (largest number of members), `paper`, or an edge of voxels in world units.
pub(super) fn partition(text: &str) -> Result<Partition, String> {
    let edge = || text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    let most = text.strip_prefix("adaptive:").and_then(|n| n.parse::<usize>().ok()).filter(|n| (16..=8000).contains(n));
    match (text, Partition::PAPER) {
        ("adaptive", _) => Ok(Partition::ADAPTIVE),
        _ if most.is_some() => Ok(Partition::Adaptive { mean: 48, least: 8, most: most.unwrap_or_default() }),
        ("paper", paper) => Ok(paper),
        (_, Partition::Paper { cap, .. }) if edge().is_some() => {
            Ok(Partition::Paper { voxel: edge().unwrap_or_default(), cap })
        }
        _ => Err("write adaptive, adaptive:128 (members per block, 16 to 8000), paper, or an edge in world units, such as 0.03".into()),
    }
}

/// `R,G,B`, each 0 to 1, or a name.
pub(super) fn colour(text: &str) -> Result<[f32; 3], String> {
    match text {
        "black" => return Ok([0.0; 3]),
        "grey" | "gray" => return Ok([0.5; 3]),
        "white" => return Ok([1.0; 3]),
        _ => {}
    }
    let channel = |t: &str| t.trim().parse::<f32>().ok().filter(|v| (0.0..=1.0).contains(v));
    let channels: Option<Vec<f32>> = text.split(',').map(channel).collect();
    channels
        .and_then(|c| c.try_into().ok())
        .ok_or_else(|| "write three numbers from 0 to 1, such as 1,1,1, or black, grey or white".to_owned())
}

/// The world direction that is up: `x`, `-y` and the like, or `auto`, as in captures.
pub(super) fn up(text: &str) -> Result<DVec3, String> {
    let asked = if text == "auto" { Some(UP) } else { axis(text) };
    asked.ok_or_else(|| "write x, y, z, -x, -y, -z or auto".to_owned())
}

/// An axis of the world: `x`, `-y` and the like.
pub(super) fn axis(text: &str) -> Option<DVec3> {
    Some(match text {
        "x" => DVec3::X,
        "y" => DVec3::Y,
        "z" => DVec3::Z,
        "-x" => DVec3::NEG_X,
        "-y" => DVec3::NEG_Y,
        "-z" => DVec3::NEG_Z,
        _ => return None,
    })
}

/// An angle in degrees between 1 and 150.
pub(super) fn degrees(text: &str) -> Result<f64, String> {
    number(text, |v| (1.0..=150.0).contains(v), "write degrees from 1 to 150")
}

/// An elevation in degrees.
pub(super) fn elevation(text: &str) -> Result<f64, String> {
    number(text, |v| (-89.0..=89.0).contains(v), "write degrees from -89 to 89")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_or_refused() {
        assert_eq!(size("1280x720"), Ok((1280, 720)));
        assert_eq!(resolution("640"), Ok(Resize::Width(640)));
        assert_eq!(resolution("/4"), Ok(Resize::Divide(4)));
        assert_eq!(colour("0.5,0,1"), Ok([0.5, 0.0, 1.0]));
        assert_eq!(up("-y"), Ok(DVec3::NEG_Y));
        assert_eq!(degrees("40"), Ok(40.0));
        for bad in ["", "0x7", "7", "7x", "x", "-1x5", "70000x5", "4294967296x1"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        for bad in ["", "/", "0", "/0", "-4", "1.5"] {
            assert!(resolution(bad).is_err(), "{bad}");
        }
        assert_eq!((bytes("2G"), bytes("7k"), bytes("12")), (Ok(2 << 30), Ok(7 << 10), Ok(12)));
        for bad in ["", "G", "0", "-1", "1.5G", "99999999999G", "1T"] {
            assert!(bytes(bad).is_err(), "{bad}");
        }
        assert_eq!((file_size("5MB"), file_size("1.5kB"), file_size("2 MiB")), (Ok(5_000_000), Ok(1500), Ok(2 << 20)));
        assert_eq!(file_size("1TB"), Ok(1_000_000_000_000));
        assert!(
            file_size("5XB").unwrap_err().contains("GiB and TiB") && file_size("5").unwrap_err().contains("its unit")
        );
        assert_eq!(size_of_file_or_pictures("640x480"), Ok(Size::Pictures(640, 480)));
        assert_eq!(size_of_file_or_pictures("12kb"), Ok(Size::File(12_000)));
        for bad in ["5", "0", "0MB", "-1MB", "1XB", "MB", "", "nanMB", "infMB", "1e30GB", "5 apples", "0x7", "0x1B"] {
            assert!(size_of_file_or_pictures(bad).is_err(), "{bad}");
        }
        assert_eq!(sh_bits("6,5"), Ok(SpzPrecision { first: 6, others: 5, means: None }));
        assert!(["", "0", "9", "5,", "5,4,3", "x"].iter().all(|bad| sh_bits(bad).is_err()));
        assert_eq!(psnr("35"), Ok(35.0));
        assert!(psnr("nan").is_err() && psnr("4").is_err() && psnr("101").is_err() && psnr("-35").is_err());
        for bad in ["", "1,1", "1,1,1,1", "2,0,0", "nan,0,0", "red"] {
            assert!(colour(bad).is_err(), "{bad}");
        }
        assert_eq!((whole("0"), seconds("50")), (Ok(0_usize), Ok(50)));
        assert!(whole::<usize>("-1").is_err() && seconds("0").is_err() && seconds("abc").is_err());
        assert!(up("w").is_err() && degrees("nan").is_err() && elevation("90").is_err());
    }

    #[test]
    fn names_are_read_by_their_aliases_too() {
        let command = clap::Command::new("test").arg(clap::Arg::new("it").value_parser(switch()).ignore_case(true));
        let read =
            |text: &str| command.clone().try_get_matches_from(["test", text]).ok()?.get_one::<bool>("it").copied();
        let on = ["on", "TRUE", "1"].map(read);
        let off = ["off", "No", "f"].map(read);
        assert_eq!((on, off, read("perhaps")), ([Some(true); 3], [Some(false); 3], None));
    }
}
