//! `make figures`: writes the generated parts of pages, and plots, from criterion's folder and a `sweep.json`.

#[path = "mod.rs"]
mod figures;

use figures::{Bench, Origin, Sweep, fill, made};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const USAGE: &str = "usage: figures CRITERION_FOLDER SWEEP.JSON COMMIT COMMAND (from the repository's root)";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [criterion, sweep, commit, command] = &arguments[..] else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    let origin = Origin { commit: commit.clone(), command: command.clone() };
    match write(Path::new(criterion), Path::new(sweep), &origin) {
        Ok(written) => {
            for path in written {
                println!("{}", path.display());
            }
            ExitCode::SUCCESS
        }
        Err(message) => {
            eprintln!("figures: {message}");
            ExitCode::from(3)
        }
    }
}

/// All is made before anything is written.
fn write(criterion: &Path, sweep: &Path, origin: &Origin) -> Result<Vec<PathBuf>, String> {
    let [page, readme, plots] = made(&Bench::read(criterion)?, &Sweep::read(sweep)?, origin)?;
    let mut files = Vec::new();
    for (file, parts) in [("docs/performance.md", &page), ("README.md", &readme)] {
        let text = std::fs::read_to_string(file).map_err(|e| format!("{file}: {e}"))?;
        files.push((PathBuf::from(file), fill(file, &text, parts)?));
    }
    let folder = Path::new("docs/figures");
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    files.extend(plots.into_iter().map(|(name, text)| (folder.join(name), text)));
    for (path, text) in &files {
        std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    Ok(files.into_iter().map(|(path, _)| path).collect())
}
