//! A child process, whose output is read line by line, and which ends with this program.

use crate::job::{Error, Watcher};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Interval of the checks of the watcher.
const LOOK: Duration = Duration::from_millis(50);
/// Silence after which a program that has ended says no more, though another that it started holds its pipes open.
const SILENCE: Duration = Duration::from_secs(3);
/// Maximum number of unread pieces of output; beyond it the program waits.
const WAITING: usize = 64;

/// A piece of a program's output.
pub(super) enum Said {
    /// A line of text.
    Line(String),
    /// A grey picture.
    Grey(Grey),
}

/// A grey picture: one byte a pixel, rows from the top.
pub(super) struct Grey {
    /// Pixels in a row.
    pub width: usize,
    /// Width times height of them.
    pub pixels: Vec<u8>,
}

/// Use of a program's standard output.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Output {
    Text,
    /// Binary PGM pictures, one after the other.
    Pictures,
}

/// Suffixes of the names of programs; COLMAP's for Windows is `COLMAP.bat`.
const ENDINGS: &[&str] = if cfg!(windows) { &[".exe", ".bat"] } else { &[""] };

/// True if a program of this name is on the PATH.
pub(super) fn on_path(program: &str) -> bool {
    found(program).is_some()
}

/// The first program of this name on the PATH.
fn found(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let files = |folder: PathBuf| ENDINGS.iter().map(move |ending| folder.join(format!("{program}{ending}")));
    std::env::split_paths(&path).flat_map(files).find(|file| file.is_file())
}

/// Ends the program with this guard.
struct Guard(Child);

impl Drop for Guard {
    fn drop(&mut self) {
        // Both fail if it has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a program to its end, without input. All its lines go to the end of the file `log`, and each piece of its output
/// to `each`.
pub(super) fn run(
    (program, arguments): (&'static str, &[String]),
    output: Output,
    log: &Path,
    watcher: &dyn Watcher,
    each: &mut dyn FnMut(Said),
) -> Result<(), Error> {
    let unwritten = |source| Error::Write { path: log.to_owned(), source };
    let mut file = OpenOptions::new().create(true).append(true).open(log).map_err(unwritten)?;
    writeln!(file, "\n$ {program} {}", arguments.join(" ")).map_err(unwritten)?;
    let mut command = Command::new(found(program).ok_or_else(|| Error::NoProgram(vec![program]))?);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = Guard(command.spawn().map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => Error::NoProgram(vec![program]),
        _ => failed(program, source.to_string(), String::new(), log),
    })?);
    let (send, said) = sync_channel(WAITING);
    if let Some(stdout) = child.0.stdout.take() {
        let send = send.clone();
        reader(move || if output == Output::Text { lines(stdout, &send) } else { pictures(stdout, &send) })?;
    }
    if let Some(stderr) = child.0.stderr.take() {
        reader(move || lines(stderr, &send))?;
    }
    let (status, last) = follow(&mut child.0, &said, watcher, &mut |piece| {
        if let Said::Line(line) = &piece {
            writeln!(file, "{line}").map_err(unwritten)?;
        }
        each(piece);
        Ok(())
    })?;
    if status.success() { Ok(()) } else { Err(failed(program, status.to_string(), last, log)) }
}

/// Passes on the program's output until it ends; returns its last line that is not empty.
fn follow(
    child: &mut Child,
    said: &Receiver<Said>,
    watcher: &dyn Watcher,
    each: &mut dyn FnMut(Said) -> Result<(), Error>,
) -> Result<(ExitStatus, String), Error> {
    let mut last = String::new();
    let (mut ended, mut heard) = (None, Instant::now());
    loop {
        watcher.unless_stopped()?;
        match said.recv_timeout(LOOK) {
            Ok(piece) => {
                if let Said::Line(line) = &piece
                    && says_more(line, &last)
                {
                    line.trim().clone_into(&mut last);
                }
                heard = Instant::now();
                each(piece)?;
            }
            Err(end) => match ended {
                Some(status) if end == RecvTimeoutError::Disconnected || heard.elapsed() > SILENCE => {
                    return Ok((status, last));
                }
                Some(_) => {}
                None => {
                    ended = child.try_wait().ok().flatten();
                    if ended.is_some() {
                        heard = Instant::now();
                    } else if end == RecvTimeoutError::Disconnected {
                        thread::sleep(LOOK);
                    }
                }
            },
        }
    }
}

/// True if a line tells more of why a program failed than an earlier one: the latest does, unless it is a line of a stack or
/// follows the failed check of one.
fn says_more(line: &str, earlier: &str) -> bool {
    let is_stack = |line: &str| line.trim_start().starts_with(['@', '*']);
    line.chars().any(char::is_alphanumeric) && !is_stack(line) && !earlier.contains("Check failed")
}

fn failed(program: &'static str, ended: String, last: String, log: &Path) -> Error {
    Error::Program { program, ended, last, log: log.to_owned() }
}

/// Starts a thread that reads the program's output.
fn reader(read: impl FnOnce() + Send + 'static) -> Result<(), Error> {
    thread::Builder::new().spawn(read).map(drop).map_err(|e| Error::Threads(e.to_string()))
}

/// Sends every line, whatever its encoding.
fn lines(stream: impl Read, send: &SyncSender<Said>) {
    for line in BufReader::new(stream).split(b'\n').map_while(Result::ok) {
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        if send.send(Said::Line(line)).is_err() {
            return; // nobody listens any more
        }
    }
}

/// Sends every picture.
fn pictures(stream: impl Read, send: &SyncSender<Said>) {
    let mut stream = BufReader::with_capacity(1 << 16, stream);
    while let Some(picture) = picture(&mut stream) {
        if send.send(Said::Grey(picture)).is_err() {
            return;
        }
    }
}

/// The next PGM picture with eight bits a pixel.
fn picture(stream: &mut impl BufRead) -> Option<Grey> {
    let mut word = || -> Option<String> {
        let mut word = Vec::new();
        for byte in stream.by_ref().bytes() {
            match byte.ok()? {
                b if b.is_ascii_whitespace() => break,
                b => word.push(b),
            }
        }
        String::from_utf8(word).ok()
    };
    let header = [word()?, word()?, word()?, word()?];
    let [width, height] = [&header[1], &header[2]].map(|n| n.parse::<usize>().ok().filter(|n| *n <= 1 << 16));
    let (width, height) = (width?, height?);
    if header[0] != "P5" || header[3] != "255" {
        return None;
    }
    // Memory is taken as pixels come, not as the header promises.
    let mut pixels = Vec::new();
    stream.take((width * height) as u64).read_to_end(&mut pixels).ok()?;
    (pixels.len() == width * height).then_some(Grey { width, pixels })
}

/// The lines of a file that a program is to read.
pub(super) fn list(path: PathBuf, lines: &[String]) -> Result<PathBuf, Error> {
    let written = File::create(&path).and_then(|mut file| writeln!(file, "{}", lines.join("\n")));
    written.map_err(|source| Error::Write { path: path.clone(), source })?;
    Ok(path)
}
