//! Output: results go to standard output, all else to standard error; colour and bars appear only on a terminal.

use crate::job::Error;
use crate::pipeline::compress::remarks::Remark;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::io::{self, IsTerminal, Write};
use std::time::Duration;

/// Choice of when to colour text.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Colour {
    /// On a terminal, if NO_COLOR is not set.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl Colour {
    /// Returns true if text is coloured; `terminal` is true if the stream is a terminal.
    pub fn on(self, terminal: bool) -> bool {
        match self {
            Self::Auto => terminal && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty()),
            Self::Always => true,
            Self::Never => false,
        }
    }
}

/// The program's two output streams.
#[derive(Clone, Debug)]
pub struct Console {
    /// True if only results and errors are printed.
    pub quiet: bool,
    /// Choice of when to colour.
    pub colour: Colour,
}

#[allow(clippy::unused_self)] // that all output goes by way of a console is the point
impl Console {
    /// Writes a line to standard output.
    ///
    /// # Errors
    /// [`Error::Print`]; also if the reader closed the pipe (`| head`), which `main` ignores.
    pub fn print(&self, line: impl std::fmt::Display) -> Result<(), Error> {
        writeln!(io::stdout().lock(), "{line}").map_err(Error::Print)
    }

    /// Writes one JSON document to standard output.
    pub fn json(&self, document: &impl Serialize) -> Result<(), Error> {
        self.print(serde_json::to_string_pretty(document).map_err(|e| Error::encoding("the JSON document", e))?)
    }

    /// Prints a remark on standard error, unless quiet.
    pub fn note(&self, line: impl std::fmt::Display) {
        if !self.quiet {
            self.error(line);
        }
    }

    /// Tells remarks, as notes and warnings.
    pub fn tell(&self, remarks: impl IntoIterator<Item = Remark>) {
        for remark in remarks {
            match remark {
                Remark::Note(line) => self.note(line),
                Remark::Warning(line) => self.warn(line),
            }
        }
    }

    /// Warns on standard error.
    pub fn warn(&self, line: impl std::fmt::Display) {
        if !self.quiet {
            let head = self.paint("33", "warning:", io::stderr().is_terminal());
            self.error(format_args!("{head} {line}"));
        }
    }

    /// Writes to standard error; failures are ignored.
    pub fn error(&self, line: impl std::fmt::Display) {
        let _ = writeln!(io::stderr().lock(), "{line}");
    }

    /// Text in an ANSI colour, if this stream is coloured.
    pub fn paint(&self, code: &str, text: &str, terminal: bool) -> String {
        if self.colour.on(terminal) { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
    }

    /// A progress bar on standard error; hidden if that is not a terminal, or with `--quiet`.
    pub fn bar(&self, length: u64, what: &'static str) -> ProgressBar {
        if self.quiet || !io::stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
        let template = "{msg} {wide_bar:.cyan/dim} {pos}/{len} {elapsed_precise} ({eta} left)";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(what);
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }

    /// A progress bar of training: its message shows the loss.
    pub fn training_bar(&self, iterations: u64) -> ProgressBar {
        let bar = self.bar(iterations, "training");
        if let Ok(style) =
            ProgressStyle::with_template("training {wide_bar:.cyan/dim} {pos}/{len}  {msg}  {per_sec} ({eta} left)")
        {
            bar.set_style(style);
        }
        bar
    }
}
