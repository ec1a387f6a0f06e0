//! A film of pictures, by ffmpeg.

use super::evaluate::pictures::Format;
use super::render::{RenderConfig, RenderTimes, Shot, frame_digits, frames, render};
use crate::extension::folder_of;
use crate::gaussians::Gaussians;
use crate::job::{Error, Session};
use crate::scene::camera::Camera;
use std::io;
use std::path::Path;
use std::process::{Command, Stdio};

const FFMPEG: &str = "ffmpeg";
const FILM: &str = "film.mp4";

/// Draws the pictures of some cameras and makes a film of them (H.264, of an even size), written completely or not at all.
///
/// # Errors
/// [`Error::NoProgram`] without ffmpeg, before anything is drawn; [`Error::Program`] if it fails; those of [`render`].
pub fn film(
    session: &Session<'_>,
    model: Gaussians,
    cameras: Vec<Camera>,
    config: &RenderConfig,
    rate: f64,
    file: &Path,
) -> Result<RenderTimes, Error> {
    run(&["-version".to_owned()], Path::new("."), file)?;
    let unwritten = |source| Error::Write { path: file.to_owned(), source };
    let folder = folder_of(file);
    std::fs::create_dir_all(folder).map_err(unwritten)?;
    let work = tempfile::Builder::new().prefix(".film-").tempdir_in(folder).map_err(unwritten)?;
    let config = RenderConfig { format: Format::Png, transparent: false, ..*config };
    let shots: Vec<Shot> = frames(cameras, work.path(), Format::Png);
    let digits = frame_digits(shots.len());
    let times = render(session, model, &shots, &config)?;
    let pattern = format!("frame_%0{digits}d.png");
    let words = ["-hide_banner", "-nostdin", "-loglevel", "error", "-y", "-framerate"];
    let options = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p"];
    let mut arguments: Vec<String> = words.map(ToOwned::to_owned).to_vec();
    arguments.extend([rate.to_string(), "-start_number".into(), "0".into(), "-i".into(), pattern]);
    arguments.extend(options.map(ToOwned::to_owned));
    arguments.extend(["-movflags".into(), "+faststart".into(), FILM.into()]);
    run(&arguments, work.path(), file)?;
    std::fs::rename(work.path().join(FILM), file).map_err(unwritten)?;
    Ok(times)
}

/// Runs ffmpeg in a folder, whose path may hold what ffmpeg's patterns mean otherwise; where it fails, its words are in a file beside
/// `file`.
fn run(arguments: &[String], folder: &Path, file: &Path) -> Result<(), Error> {
    let output = Command::new(FFMPEG).args(arguments).current_dir(folder).stdin(Stdio::null()).output();
    let output = output.map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => Error::NoProgram(vec![FFMPEG]),
        _ => Error::Write { path: file.to_owned(), source },
    })?;
    if output.status.success() {
        return Ok(());
    }
    let log = file.with_extension("ffmpeg.log");
    std::fs::write(&log, &output.stderr).map_err(|source| Error::Write { path: log.clone(), source })?;
    let last = String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned();
    Err(Error::Program { program: FFMPEG, ended: output.status.to_string(), last, log })
}
