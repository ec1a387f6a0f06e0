//! ffprobe's facts about a video.

use std::cmp::Reverse;
use std::fs;
use std::path::Path;

use super::FFPROBE;
use crate::job::{Error, Watcher};
use crate::pose::child::{self, Output, Said};

/// Frames per second of a video that does not say.
const RATE: f64 = 30.0;
/// Orders of the half pictures of interlaced frames.
const INTERLACED: [&str; 4] = ["tt", "bb", "tb", "bt"];
/// Beginnings of the names of pixel formats with alpha.
const ALPHA: [&str; 9] = ["yuva", "ayuv", "vuya", "rgba", "bgra", "argb", "abgr", "gbrap", "ya"];
/// Share of a video's duration that its frames must fill.
const FILLED: f64 = 0.9;
/// Share of it from which on frames are looked for.
const LATE: f64 = 0.8;

/// Facts about the largest stream of pictures of a video.
#[derive(Debug, PartialEq)]
pub(super) struct Facts {
    /// Number of the stream in the file.
    pub stream: usize,
    /// Frames per second.
    pub rate: f64,
    /// Number of frames; 0 if it is not known.
    pub frames: usize,
    /// True if each frame consists of two half pictures, taken one after the other.
    pub is_interlaced: bool,
    /// Duration of this stream in seconds; none if the file states at most that of all streams.
    duration: Option<f64>,
    /// True if the colours have a high dynamic range.
    is_hdr: bool,
    has_alpha: bool,
}

impl Facts {
    /// Reads the facts of a file, by its name for ffmpeg; none if it has no stream of pictures other than its cover.
    pub fn read(file: &str, log: &Path, watcher: &dyn Watcher) -> Result<Option<Self>, Error> {
        let entries = "stream=index,width,height,pix_fmt,avg_frame_rate,nb_frames,color_transfer,field_order,duration:\
                       stream_tags=alpha_mode,DURATION:stream_disposition=attached_pic";
        let words = ["-select_streams", "v", "-show_entries", entries, "-of", "default=nk=0:nw=1", file];
        Ok(Self::of(&probe(&words, log, watcher)?))
    }

    /// The facts of the largest stream that ffprobe's lines tell of. The lines of a stream begin with its index.
    fn of(lines: &[String]) -> Option<Self> {
        let number = |stream: &[String], key: &str| value(stream, key).parse::<u64>().unwrap_or(0);
        let streams = lines.chunk_by(|_, next| !next.starts_with("index="));
        let pictures = streams.filter(|s| !value(s, "index").is_empty() && value(s, "DISPOSITION:attached_pic") != "1");
        let area = |stream: &&[String]| number(stream, "width").saturating_mul(number(stream, "height"));
        let stream = pictures.min_by_key(|stream| Reverse(area(stream)))?;
        let value = |key: &str| value(stream, key);
        let rate = value("avg_frame_rate").split_once('/').and_then(|(a, b)| {
            let rate = a.parse::<f64>().ok()? / b.parse::<f64>().ok()?;
            (rate.is_finite() && rate > 0.0).then_some(rate)
        });
        // A number, or hours, minutes and seconds, as of MKV.
        let seconds = |text: &str| {
            let sum = text.split(':').try_fold(0.0_f64, |sum, part| Some(60.0 * sum + part.parse::<f64>().ok()?));
            sum.filter(|v| v.is_finite() && *v > 0.0)
        };
        Some(Self {
            stream: value("index").parse().ok()?,
            rate: rate.unwrap_or(RATE),
            frames: value("nb_frames").parse().unwrap_or(0),
            is_interlaced: INTERLACED.contains(&value("field_order")),
            duration: seconds(value("duration")).or_else(|| seconds(value("TAG:DURATION"))),
            is_hdr: ["arib-std-b67", "smpte2084"].contains(&value("color_transfer")),
            has_alpha: value("TAG:alpha_mode") == "1" || ALPHA.iter().any(|name| value("pix_fmt").starts_with(*name)),
        })
    }

    /// What the user is told before frames are taken.
    pub fn notes(&self) -> impl Iterator<Item = &'static str> {
        let notes = [
            (
                self.is_hdr,
                "the video has a high dynamic range (HLG or PQ): its colours will look flat; record without HDR",
            ),
            (
                self.is_interlaced,
                "the video is interlaced: it is deinterlaced, which costs sharpness; record progressive video (25p, 30p)",
            ),
            (
                self.has_alpha,
                "the video has transparency (alpha), which its frames do not keep: to use it, write some frames as PNG files with \
                 ffmpeg, and give their folder",
            ),
        ];
        notes.into_iter().filter(|(is_so, _)| *is_so).map(|(_, note)| note)
    }

    /// A note on a video, by its name for ffmpeg, whose last frame ends long before its duration.
    pub fn cut_short(&self, file: &str, log: &Path, watcher: &dyn Watcher) -> Result<Option<String>, Error> {
        let Some(whole) = self.duration else { return Ok(None) };
        let (stream, late) = (self.stream.to_string(), format!("{:.3}%", LATE * whole));
        // Not into the scene's log: there is a line for each frame.
        let times = log.with_extension("times");
        // Where the index of a film comes first, what is cut off may hold all of its end: then the whole film tells.
        for interval in [&late, "%"] {
            let words = ["-select_streams", &stream, "-read_intervals", interval];
            let entries = ["-show_entries", "packet=pts_time,duration_time", "-of", "csv=p=0", file];
            let lines = probe(&[&words[..], &entries].concat(), &times, watcher);
            let _ = fs::remove_file(&times);
            match lines {
                Ok(lines) => {
                    if let Some(end) = end(&lines) {
                        return Ok(shorter(whole, end));
                    }
                }
                Err(Error::Program { .. }) => return Ok(None),
                Err(other) => return Err(other),
            }
        }
        Ok(None)
    }
}

/// The time in seconds at which the last frame ends. Each of ffprobe's lines holds the time and the duration of a frame.
fn end(lines: &[String]) -> Option<f64> {
    let end = |line: &String| {
        let mut numbers = line.split(',').map(|number| number.parse::<f64>().ok().filter(|v| v.is_finite()));
        Some(numbers.next()?? + numbers.next().flatten().unwrap_or(0.0))
    };
    lines.iter().filter_map(end).reduce(f64::max)
}

/// A note on a video of `whole` seconds whose last frame ends long before them.
fn shorter(whole: f64, end: f64) -> Option<String> {
    (end < FILLED * whole)
        .then(|| format!("the video ends after {end:.1} of {whole:.1} s: it may be cut short; copy it again"))
}

/// The lines that ffprobe writes.
fn probe(words: &[&str], log: &Path, watcher: &dyn Watcher) -> Result<Vec<String>, Error> {
    let arguments: Vec<String> = [&["-v", "error"][..], words].concat().into_iter().map(ToOwned::to_owned).collect();
    let mut lines = Vec::new();
    child::run((FFPROBE, &arguments), Output::Text, log, watcher, &mut |said| {
        if let Said::Line(line) = said {
            lines.push(line);
        }
    })?;
    Ok(lines)
}

/// The value of a key in the lines of a stream; empty if it is not there.
fn value<'a>(stream: &'a [String], key: &str) -> &'a str {
    stream.iter().find_map(|line| line.strip_prefix(key)?.strip_prefix('=')).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Option<Facts> {
        Facts::of(&text.split(' ').map(ToOwned::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn the_largest_stream_that_is_no_cover_is_taken() {
        let cover = "index=0 width=9000 height=9000 avg_frame_rate=0/0 DISPOSITION:attached_pic=1";
        let preview = "index=1 width=32 height=24 pix_fmt=yuv420p avg_frame_rate=10/1 DISPOSITION:attached_pic=0";
        let film = "index=3 width=128 height=96 pix_fmt=yuva444p12le avg_frame_rate=30/1 duration=N/A \
                    field_order=progressive TAG:DURATION=00:01:02.500000000";
        assert_eq!((of(""), of(cover)), (None, None));
        let found = of(&format!("{cover} {preview} {film}")).unwrap();
        assert_eq!((found.stream, found.rate, found.duration, found.has_alpha), (3, 30.0, Some(62.5), true));
        assert_eq!((found.notes().count(), of(preview).unwrap().duration), (1, None));
        let tape = film.replace("progressive", "tt").replace("yuva444p12le", "yuv420p").replace("N/A", "2.0");
        let found = of(&format!("{preview} {tape}")).unwrap();
        assert!(found.is_interlaced && found.notes().all(|note| note.contains("interlaced")));
        assert_eq!(found.duration, Some(2.0));
    }

    #[test]
    fn a_video_is_cut_short_if_its_last_frame_ends_early() {
        let told =
            |lines: &[&str]| shorter(2.0, end(&lines.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>())?);
        let note = told(&["[matroska] File ended prematurely", "0.6,0.1,", "0.5,N/A", "N/A,9.0"]).unwrap();
        assert_eq!(note.split(':').next(), Some("the video ends after 0.7 of 2.0 s"));
        // The last frame of a slow video lasts long, and frames need not come in their order.
        assert_eq!([&["1.5,0.5"][..], &["1.9,N/A", "1.7,0.1"], &["N/A"], &[]].map(told), [None, None, None, None]);
    }
}
