//! Frames of a video: the sharpest of every window, by ffmpeg.

mod facts;

use self::facts::Facts;
use super::child::{self, Grey, Output, Said, on_path};
use super::folder::Folder;
use crate::job::{Error, Stage, Watcher};
use crate::scene::{self, median};
use crate::wording::counted;
use std::fs;
use std::path::Path;

const FFMPEG: &str = "ffmpeg";
const FFPROBE: &str = "ffprobe";
/// Most frames to take from a second of a long video.
const PER_SECOND: f64 = 2.0;
/// Frames to take from a short one, in which the camera moves further in a second, if it has three times as many.
const FEWEST: usize = 60;
/// Least distance of two chosen frames, in windows.
const APART: f64 = 0.3;
/// Longest filter in bytes that is an argument, and no file: on Windows, all arguments together have at most 32,767.
const LONGEST: usize = 8000;
/// Deinterlaces the frames of an interlaced video; it comes before other filters.
const DEINTERLACED: &str = "yadif,";
/// Pictures with square pixels, and with the colours of JPEG files, whose matrix is BT.601's and whose range is full. A pixel's aspect
/// below 1/4 or above 4 is a mistake of the file: it is ignored.
const AS_PHOTOS: &str = "scale=w=if(between(sar\\,1/4\\,4)\\,round(iw*sar)\\,iw):h=ih:out_color_matrix=bt601:\
                         out_range=full,setsar=1";

/// Refuses a file that holds no video, before anything is written for it.
pub(super) fn check(video: &Path, watcher: &dyn Watcher) -> Result<(), Error> {
    let missing: Vec<&str> = [FFMPEG, FFPROBE].into_iter().filter(|program| !on_path(program)).collect();
    if !missing.is_empty() {
        return Err(Error::NoProgram(missing));
    }
    let unusable = |what: String| Error::from(scene::Error::Instead { path: video.to_owned(), what });
    let log = tempfile::NamedTempFile::new();
    let log = log.map_err(|source| Error::Write { path: std::env::temp_dir(), source })?;
    match Facts::read(&url(video), log.path(), watcher) {
        Ok(Some(_)) => Ok(()),
        Ok(None) => Err(unusable("it holds no video stream: give another file, or a folder of photos".to_owned())),
        Err(Error::Program { last, .. }) => {
            let said = if last.is_empty() { String::new() } else { format!(" ({last})") };
            Err(unusable(format!("it is empty, cut short, or no video{said}: copy or export it again")))
        }
        Err(other) => Err(other),
    }
}

/// The video's name for ffmpeg, to which a name with a colon would be a protocol.
fn url(video: &Path) -> String {
    format!("file:{}", video.display())
}

/// Chooses sharp frames of a video, at most `most` of them, and writes them into the folder of images; returns their
/// names, which hold the number of the frame in the video.
pub(super) fn extract(video: &Path, most: usize, folder: &Folder, watcher: &dyn Watcher) -> Result<Vec<String>, Error> {
    let log = folder.log();
    let file = url(video);
    let Some(facts) = Facts::read(&file, &log, watcher)? else { return Ok(Vec::new()) };
    facts.notes().for_each(|note| watcher.note(note));
    let (map, before) = (format!("0:{}", facts.stream), if facts.is_interlaced { DEINTERLACED } else { "" });
    let spelling = Spelling::read(&log, watcher)?;
    let ffmpeg = |[option, filter]: [&str; 2], output: &[&str]| -> Vec<String> {
        let input = ["-hide_banner", "-nostdin", "-loglevel", "error", "-i", &file, "-map", &map, option, filter];
        let timing = [spelling.timing, "passthrough"];
        [&input[..], &timing, output].concat().into_iter().map(ToOwned::to_owned).collect()
    };

    let mut sharpness = Vec::new();
    let grey = format!("{before}scale=w='min(640,iw)':h=-2,format=gray");
    let small = ffmpeg(["-vf", &grey], &["-f", "image2pipe", "-c:v", "pgm", "-"]);
    child::run((FFMPEG, &small), Output::Pictures, &log, watcher, &mut |said| {
        if let Said::Grey(picture) = said {
            sharpness.push(laplacian_variance(&picture));
            // There may be more frames than the video says.
            watcher.progress(Stage::Frames, sharpness.len(), facts.frames.max(sharpness.len() + 1));
        }
    })?;
    watcher.progress(Stage::Frames, sharpness.len(), sharpness.len());
    if let Some(note) = facts.cut_short(&file, &log, watcher)? {
        watcher.note(&note);
    }
    let chosen = choose(&sharpness, windows(sharpness.len(), facts.rate, most));
    let unwritten = |source| Error::Write { path: folder.images(), source };
    if chosen.is_empty() {
        return Ok(Vec::new());
    }

    let taken = folder.work().join("frames");
    let _ = fs::remove_dir_all(&taken); // of an interrupted job
    fs::create_dir_all(&taken).map_err(unwritten)?;
    let select = format!("{before}select={},{AS_PHOTOS}", one_of(&chosen));
    let (option, filter) = if select.len() > LONGEST {
        let script = child::list(taken.join("filter.txt"), &[select])?;
        (spelling.script, format!("file:{}", script.display()))
    } else {
        ("-vf", select)
    };
    // A % of the folder's own name is written twice.
    let within = taken.display().to_string().replace('%', "%%");
    let pattern = Path::new(&within).join("%06d.jpg").display().to_string();
    let large = ffmpeg([option, &filter], &["-f", "image2", "-q:v", "2", &pattern]);
    child::run((FFMPEG, &large), Output::Text, &log, watcher, &mut |_| ())?;
    let names: Vec<String> = chosen.iter().map(|n| format!("frame_{n:06}.jpg")).collect();
    for (i, name) in (1..).zip(&names) {
        fs::rename(taken.join(format!("{i:06}.jpg")), folder.images().join(name)).map_err(unwritten)?;
    }
    let _ = fs::remove_dir_all(&taken);
    watcher.note(&format!("{} out of {}", counted(names.len(), "sharp frame"), sharpness.len()));
    Ok(names)
}

/// An expression of ffmpeg that is true for these frames, which ascend. It is a balanced tree: a sum of thousands of terms
/// would need too much of ffmpeg's stack.
fn one_of(frames: &[usize]) -> String {
    match frames {
        [] => "0".to_owned(),
        [only] => format!("eq(n\\,{only})"),
        _ => {
            let (low, high) = frames.split_at(frames.len() / 2);
            format!("if(lt(n\\,{})\\,{}\\,{})", high[0], one_of(low), one_of(high))
        }
    }
}

/// The names of options that this version of ffmpeg knows.
struct Spelling {
    /// Option that passes on every frame as it is.
    timing: &'static str,
    /// Option that names a file with the filter.
    script: &'static str,
}

impl Spelling {
    /// Reads ffmpeg's help.
    fn read(log: &Path, watcher: &dyn Watcher) -> Result<Self, Error> {
        let (mut fps_mode, mut filter_script) = (false, false);
        let help = ["-hide_banner", "-h", "long"].map(ToOwned::to_owned);
        // Not into the scene's log: it is long.
        let nowhere = log.with_extension("help");
        child::run((FFMPEG, &help), Output::Text, &nowhere, watcher, &mut |said| {
            if let Said::Line(line) = said {
                fps_mode |= line.starts_with("-fps_mode");
                filter_script |= line.starts_with("-filter_script");
            }
        })?;
        let _ = fs::remove_file(nowhere);
        let timing = if fps_mode { "-fps_mode" } else { "-vsync" };
        let script = if filter_script { "-filter_script:v" } else { "-/filter:v" };
        Ok(Self { timing, script })
    }
}

/// Sharpness of a picture: the variance of its Laplacian, in squared grey levels.
fn laplacian_variance(Grey { width, pixels }: &Grey) -> f64 {
    let (mut n, mut sum, mut squares) = (0, 0, 0);
    let rows: Vec<&[u8]> = pixels.chunks_exact((*width).max(1)).collect();
    for row in rows.windows(3) {
        for x in 1..width.saturating_sub(1) {
            let at = |y: usize, x: usize| i64::from(row[y][x]);
            let laplacian = at(0, x) + at(2, x) + at(1, x - 1) + at(1, x + 1) - 4 * at(1, x);
            (n, sum, squares) = (n + 1, sum + laplacian, squares + laplacian * laplacian);
        }
    }
    let mean = sum as f64 / f64::from(n.max(1));
    squares as f64 / f64::from(n.max(1)) - mean * mean
}

/// Number of frames to take from a video of `frames` frames, `rate` in a second, and at most `most`.
fn windows(frames: usize, rate: f64, most: usize) -> usize {
    let by_time = (frames as f64 / rate * PER_SECOND).ceil() as usize;
    most.min(by_time.max(FEWEST.min(frames / 3)))
}

/// The sharpest frame of each of a number of equal windows, in order; never two close to each other. A frame is compared with
/// the median of a window around it, so that what the camera shows matters less.
fn choose(sharpness: &[f64], windows: usize) -> Vec<usize> {
    let frames = sharpness.len();
    let windows = windows.min(frames);
    let length = frames as f64 / windows.max(1) as f64;
    let reach = length.ceil() as usize;
    let relative = |i: usize| {
        let mut around = sharpness[i.saturating_sub(reach)..(i + reach + 1).min(frames)].to_vec();
        sharpness[i] / median(&mut around).unwrap_or_default().max(f64::MIN_POSITIVE)
    };
    let mut chosen: Vec<usize> = Vec::with_capacity(windows);
    for window in 0..windows {
        let begin = (window as f64 * length) as usize;
        let end = ((window + 1) as f64 * length) as usize;
        let first = chosen.last().map_or(begin, |last| begin.max(last + (APART * length).ceil() as usize));
        let best =
            (first..end.min(frames)).map(|i| (relative(i), i)).max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        chosen.extend(best.map(|(_, i)| i));
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_videos_give_more_frames_a_second() {
        let [long, orbit, blink] = [5400, 300, 60].map(|frames| windows(frames, 30.0, 150));
        assert_eq!((long, orbit, blink), (150, 60, 20));
        assert_eq!((windows(1800, 30.0, 150), windows(300, 30.0, 24), windows(0, 30.0, 150)), (120, 24, 0));
    }

    #[test]
    fn frames_are_told_by_an_expression_that_is_not_deep() {
        assert_eq!((one_of(&[]), one_of(&[7])), ("0".to_owned(), r"eq(n\,7)".to_owned()));
        assert_eq!(one_of(&[3, 7, 9]), r"if(lt(n\,7)\,eq(n\,3)\,if(lt(n\,9)\,eq(n\,7)\,eq(n\,9)))");
        let (mut depth, mut deepest) = (0, 0);
        for c in one_of(&(0..10_000).collect::<Vec<usize>>()).chars() {
            depth += i32::from(c == '(') - i32::from(c == ')');
            deepest = deepest.max(depth);
        }
        assert!(depth == 0 && deepest < 20, "{deepest}");
    }

    #[test]
    fn the_sharpest_frame_of_every_window_is_chosen() {
        // One of three frames is sharp; the scene has more detail towards the end.
        let sharpness: Vec<f64> = (0..90).map(|i| f64::from(10 + i) * if i % 3 == 1 { 5.0 } else { 1.0 }).collect();
        let chosen = choose(&sharpness, 15);
        assert_eq!(chosen.len(), 15);
        assert!(chosen.iter().all(|i| i % 3 == 1), "{chosen:?}");
        assert!(chosen.windows(2).all(|w| w[1] - w[0] >= 2), "{chosen:?}");
    }

    #[test]
    fn two_chosen_frames_are_never_close() {
        // The sharpest frames lie at both sides of a border of windows of ten.
        let sharpness: Vec<f64> = (0..20).map(|i| if i == 9 || i == 10 { 9.0 } else { 1.0 }).collect();
        let chosen = choose(&sharpness, 2);
        assert_eq!((chosen.len(), chosen[0]), (2, 9));
        assert!(chosen[1] >= 12, "{chosen:?}");
        assert_eq!(choose(&[], 5), [0; 0]);
        assert_eq!(choose(&[1.0, 2.0], 5), [0, 1]);
    }

    #[test]
    fn sharpness_is_the_variance_of_the_laplacian() {
        let grey = |pixels: Vec<u8>| laplacian_variance(&Grey { width: 4, pixels });
        assert_eq!(grey(vec![7; 12]), 0.0);
        // Laplacians 3 and -42 at the two inner pixels: both are 22.5 from their mean.
        assert_eq!(grey(vec![0, 0, 0, 0, 0, 2, 11, 0, 0, 0, 0, 0]), 22.5 * 22.5);
        assert_eq!(grey(Vec::new()), 0.0);
    }
}
