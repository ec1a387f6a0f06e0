//! `make figures` and `make results`: write the generated parts of pages, the plots and the renders.

#[path = "mod.rs"]
mod figures;

use figures::{BYTES, Bench, Origin, Parts, RENDERS, Sweep, bytes, fill, made, renders, results};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const USAGE: &str = "usage (from the repository's root):
  figures measured CRITERION_FOLDER SWEEP.JSON COMMIT COMMAND   tables and plots
  figures renders COMPARISON_FOLDER                             the renders in README.md
  figures bytes COMMIT FOLDER_OF_A_CURVE...                     the plot and the table of docs/formats.md
  figures results FOLDER_OF_COMPARISONS COMMIT COMMAND          the tables of docs/results.md and README.md";

/// A file and its new content.
type File = (PathBuf, Vec<u8>);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let files = match arguments[..] {
        ["measured", criterion, sweep, commit, command] => {
            let origin = Origin { commit: commit.to_owned(), command: command.to_owned() };
            measured(Path::new(criterion), Path::new(sweep), &origin)
        }
        ["bytes", commit, ref curves @ ..] => curved(curves, commit),
        ["renders", comparison] => rendered(Path::new(comparison)),
        ["results", folder, commit, command] => {
            let origin = Origin { commit: commit.to_owned(), command: command.to_owned() };
            compared(Path::new(folder), &origin)
        }
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match files.and_then(write) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("figures: {message}");
            ExitCode::from(3)
        }
    }
}

fn measured(criterion: &Path, sweep: &Path, origin: &Origin) -> Result<Vec<File>, String> {
    let [page, sweep_page, plots] = made(&Bench::read(criterion)?, &Sweep::read(sweep)?, origin)?;
    let mut files = vec![filled("docs/performance.md", &page)?, filled("docs/sweep.md", &sweep_page)?];
    let folder = Path::new("docs/figures");
    files.extend(plots.into_iter().map(|(name, text)| (folder.join(name), text.into_bytes())));
    Ok(files)
}

fn rendered(comparison: &Path) -> Result<Vec<File>, String> {
    let (picture, readme) = renders(comparison)?;
    Ok(vec![filled("README.md", &readme)?, (RENDERS.into(), picture)])
}

fn compared(folder: &Path, origin: &Origin) -> Result<Vec<File>, String> {
    let [page, readme] = results(folder, origin)?;
    Ok(vec![filled("docs/results.md", &page)?, filled("README.md", &readme)?])
}

fn curved(curves: &[&str], commit: &str) -> Result<Vec<File>, String> {
    let folders: Vec<&Path> = curves.iter().map(Path::new).collect();
    let (plot, table) = bytes(&folders, &format!("llvmpipe, commit {commit}."))?;
    Ok(vec![filled("docs/formats.md", &vec![("bytes", table)])?, (BYTES.into(), plot.into_bytes())])
}

fn filled(file: &str, parts: &Parts) -> Result<File, String> {
    let text = std::fs::read_to_string(file).map_err(|e| format!("{file}: {e}"))?;
    Ok((file.into(), fill(file, &text, parts)?.into_bytes()))
}

/// Writes the finished files, and prints their paths.
fn write(files: Vec<File>) -> Result<(), String> {
    for (path, bytes) in files {
        let told = |e: std::io::Error| format!("{}: {e}", path.display());
        path.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(told)?;
        std::fs::write(&path, bytes).map_err(told)?;
        println!("{}", path.display());
    }
    Ok(())
}
