//! Which command dispatches which kernel: the last column of the equations in docs/engine.md, held against what commands do.

use super::ended::{qirf, works};
use super::run::{finished, finished_as_in_the_paper};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The code spans of a table's cell.
fn spans(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Kernels of the table and the commands that dispatch them.
fn documented() -> Vec<(String, Vec<String>)> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/engine.md")).unwrap();
    let cells = |line: &str| line.trim_matches('|').split('|').map(spans).collect::<Vec<_>>();
    let rows: Vec<_> = text.lines().filter(|l| l.starts_with("| Q")).map(cells).collect();
    assert!(rows.len() >= 10 && rows.iter().all(|row| row.len() == 7), "{rows:?}");
    let kernel = |path: &String| Some(path.strip_prefix("glsl/")?.strip_suffix(".comp")?.to_owned());
    rows.iter().flat_map(|row| row[1].iter().filter_map(kernel).map(|k| (k, row[6].clone()))).collect()
}

/// Kernels that `run` with these options dispatches: a pipeline is made at its first dispatch, and told of.
fn dispatched(options: &str) -> BTreeSet<String> {
    let told = match options {
        "" => finished().ended.said.clone(),
        "--preset paper" => finished_as_in_the_paper().ended.said.clone(),
        other => {
            let folder = tempfile::tempdir().unwrap();
            let mut run = qirf(["run".as_ref(), &*finished().scene, "-o".as_ref(), folder.path()]);
            works(run.args(["--iterations", "60", "-v", "-v"]).args(other.split(' '))).said
        }
    };
    told.lines().filter_map(|line| line.split_once("pipeline ")?.1.split(' ').next().map(str::to_owned)).collect()
}

#[test]
fn the_equations_kernels_are_dispatched_by_the_commands_that_the_documentation_names() {
    let documented = documented();
    let all: BTreeSet<&String> = documented.iter().flat_map(|(_, commands)| commands).collect();
    for needed in ["run", "run --preset paper"] {
        assert!(all.iter().any(|c| *c == needed), "docs/engine.md names `{needed}`");
    }
    let by_command: BTreeMap<&String, BTreeSet<String>> = all
        .into_iter()
        .map(|command| {
            let options = command.strip_prefix("run").unwrap_or_else(|| panic!("{command}: not `run`"));
            (command, dispatched(options.trim()))
        })
        .collect();
    assert!(documented.len() >= 5, "{documented:?}");
    for (kernel, commands) in &documented {
        assert!(!commands.is_empty(), "{kernel}: no command is named");
        for command in commands {
            let seen = &by_command[command];
            assert!(seen.contains(kernel), "`{command}` does not dispatch {kernel}, but: {seen:?}");
        }
    }
    // The default run solves on the host; what it does not dispatch is not claimed.
    assert!(!by_command[&"run".to_owned()].contains("qirf/participation"));
}
