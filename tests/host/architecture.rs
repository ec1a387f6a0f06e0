//! The rules of the house, checked against its sources: imports go down the floors, a stage has one name, and the paths
//! that the documentation names exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Rooms of `src` by floor, the lowest first. A room imports from lower floors only.
const FLOORS: &[&[&str]] = &[
    &["checksum", "extension", "lock", "percent", "ply", "random", "sample", "solve", "wording"],
    &["scene"],
    &["gpu"],
    &["kernels"], // generated from glsl/
    &["primitives", "synth"],
    &["gaussians"],
    &["effects", "metrics", "render"],
    &["depth_maps", "response"],
    &["edit", "qirf", "train"],
    &["reference"],
    &["job"],
    &["aim"],
    &["pipeline"],
    &["pose", "report", "selftest", "shard", "view"],
    &["lab"],
    &["cli"],
    &["main"],
];

/// Exceptions to the rule: file, room, reason.
const UPWARD: &[(&str, &str, &str)] =
    &[("src/gpu/probe.rs", "kernels", "a device is probed with a kernel before it is handed out")];

/// Folders that may import the float64 twin: it is an oracle, and production code computes nothing with it.
const ORACLE_OF: &[&str] = &["src/reference/", "src/selftest/", "src/lab/sweep/"];

/// A shader's place in the house.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Host,
    Twin,
    Test,
    Bench,
    Label,
}

const PLACES: [Place; 5] = [Place::Host, Place::Twin, Place::Test, Place::Bench, Place::Label];

/// Shaders that are a step of another stage and share its places.
const STEPS: &[(&str, &str)] = &[
    ("primitives/arguments", "primitives/scan"),
    ("qirf/axes", "qirf/overlap"),
    ("qirf/overlap_by_sum", "qirf/overlap"),
    ("render/ranges", "render/bin"),
    ("render/rasterise_backward_atomic", "render/rasterise_backward"),
    ("response/tally", "response/score"),
    ("train/gather_rows", "train/densify"),
    ("train/loss_tiles", "train/loss"),
    ("train/reset_opacity", "train/densify"),
    ("train/sources", "train/densify"),
    ("train/split", "train/densify"),
    ("lab/learnt_mask_adam", "lab/learnt_mask"),
    ("lab/learnt_mask_gradient", "lab/learnt_mask"),
];

/// Places that these stages lack, and why.
const EXEMPT: &[(&[&str], Place, &str)] = &[
    (PRIMITIVES, Place::Twin, "exact: the standard library is the oracle"),
    (PRIMITIVES, Place::Label, "timed as part of the stage that calls it"),
    (&["primitives/gather", "primitives/sort"], Place::Test, "cases of the selftest, which tests/device runs"),
    (&["primitives/compact", "primitives/gather"], Place::Bench, "measured in the depth sort"),
    (&["primitives/reduce"], Place::Bench, "one dispatch every 16th iteration"),
    (&["response/residual"], Place::Bench, "one dispatch after the loss"),
    (&["train/densify"], Place::Host, "train/density.rs strings its steps together"),
    (&["train/densify"], Place::Label, "every hundredth iteration, between submissions that are timed"),
    (&["train/densify"], Place::Bench, "every hundredth iteration"),
    (&["train/halve"], Place::Bench, "one dispatch, in the iterations that see half the photo"),
    (&["train/mask"], Place::Bench, "row masks of the group effects: the effect's own name"),
    (&["train/mask"], Place::Label, "masks, the effect's own name"),
    (&["train/smoothing"], Place::Bench, "every 16th iteration, where anti-aliasing is on"),
    (&["train/smoothing"], Place::Label, "antialias, the effect that calls for it"),
    (&["lab/learnt_mask"], Place::Bench, "two or three dispatches, in runs with learnt masks"),
    (&["lab/mcmc"], Place::Bench, "two dispatches, in runs that grow by relocation"),
];
const PRIMITIVES: &[&str] =
    &["primitives/compact", "primitives/gather", "primitives/reduce", "primitives/scan", "primitives/sort"];

/// Rooms whose shaders are not stages: they probe and measure the device itself.
const NO_STAGES: &[&str] = &["lib", "probe", "rates"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files below a folder with this extension, as paths from the root.
fn files(folder: &str, extension: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut open = vec![root().join(folder)];
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(&at).expect("a folder of the house").flatten() {
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == extension) {
                found.push(path.strip_prefix(root()).expect("below the root").display().to_string());
            }
        }
    }
    found.sort();
    found
}

fn text(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("a file of the house")
}

/// A source without comments and without its unit tests, which may import from higher floors.
fn code(path: &str) -> String {
    let text = text(path);
    let production = text.split("#[cfg(test)]").next().unwrap_or_default();
    production.lines().map(|l| l.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Rooms that a source names after `crate::`, also inside braces.
fn imports(code: &str) -> BTreeSet<String> {
    let name = |s: &str| -> String { s.chars().take_while(|c| c.is_ascii_lowercase() || *c == '_').collect() };
    let mut rooms = BTreeSet::new();
    // Numbers of shaders depend on nothing: they are on the lowest floor.
    let code = code.replace("crate::kernels::constants", "").replace("crate::kernels::needs", "");
    for after in code.split("crate::").skip(1) {
        if let Some(list) = after.strip_prefix('{') {
            let mut depth = 0;
            let mut item = true;
            for (at, c) in list.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => item = true,
                    c if item && c.is_ascii_lowercase() => {
                        rooms.insert(name(&list[at..]));
                        item = false;
                    }
                    _ => {}
                }
            }
        } else {
            rooms.insert(name(after));
        }
    }
    rooms.remove("");
    rooms
}

fn room(path: &str) -> &str {
    path.split('/').nth(1).unwrap_or_default().trim_end_matches(".rs")
}

#[test]
fn imports_go_down_the_floors() {
    let floor: BTreeMap<&str, usize> =
        FLOORS.iter().enumerate().flat_map(|(n, rooms)| rooms.iter().map(move |r| (*r, n))).collect();
    let mut upward = BTreeSet::new();
    let mut wrong = Vec::new();
    for path in files("src", "rs").iter().filter(|p| *p != "src/lib.rs") {
        let own = floor.get(room(path)).unwrap_or_else(|| panic!("{path}: give its room a floor in FLOORS"));
        for imported in imports(&code(path)).iter().filter(|r| *r != room(path)) {
            let Some(other) = floor.get(imported.as_str()) else { continue };
            if other >= own {
                upward.insert((path.clone(), imported.clone()));
            }
            if imported == "lab" && room(path) != "cli" {
                wrong.push(format!("{path} imports the laboratory, which only the command line may"));
            }
            if imported == "reference" && !ORACLE_OF.iter().any(|place| path.starts_with(place)) {
                wrong.push(format!("{path} computes with the oracle, crate::reference"));
            }
        }
    }
    let allowed: BTreeSet<_> = UPWARD.iter().map(|(f, r, _)| ((*f).to_owned(), (*r).to_owned())).collect();
    wrong.extend(
        upward.difference(&allowed).map(|(file, room)| format!("{file} imports crate::{room}, which is no lower")),
    );
    wrong.extend(allowed.difference(&upward).map(|(file, room)| format!("UPWARD: {file} no longer imports {room}")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Texts that are searched for stages.
struct House {
    sources: Vec<String>,
    tests: Vec<(String, String)>,
    benches: String,
    host: Vec<(String, String)>,
}

/// Whether the name of a test function, which `text` begins with, has the stage's words in it, whole and in order.
fn whole_words(text: &str, stage: &str) -> bool {
    let name = text.split('(').next().unwrap_or_default();
    format!("_{name}_").contains(&format!("_{stage}_"))
}

impl House {
    fn open() -> Self {
        let with_text = |paths: Vec<String>| paths.into_iter().map(|p| (p.clone(), text(&p))).collect::<Vec<_>>();
        let sources = files("src", "rs");
        let host = sources.iter().filter(|p| !matches!(room(p), "reference" | "selftest" | "cli" | "report"));
        Self {
            host: host.map(|p| (p.clone(), code(p))).collect(),
            tests: with_text(files("tests", "rs")),
            benches: files("benches", "rs").iter().map(|p| text(p)).collect::<Vec<_>>().join("\n"),
            sources,
        }
    }

    fn has(&self, shader: &str, place: Place) -> bool {
        let (room, stage) = shader.split_once('/').expect("room/stage");
        let label = format!("\"{}\"", stage.replace('_', " "));
        let here = format!("src/{room}/");
        let rendered = qirf_vk::render::STAGES.iter().chain(&qirf_vk::render::BACKWARD_STAGES);
        match place {
            Place::Host => {
                let names = [format!("/{stage}.rs"), format!("/{stage}/mod.rs")];
                self.sources.iter().any(|p| p.starts_with(&here) && names.iter().any(|name| p.ends_with(name)))
            }
            Place::Twin => self.sources.contains(&format!("src/reference/{stage}.rs")),
            Place::Test => self.tests.iter().any(|(path, text)| {
                Path::new(path).file_stem().is_some_and(|s| s == stage)
                    || text.split("#[test]\nfn ").skip(1).any(|t| whole_words(t, stage))
            }),
            Place::Bench => {
                self.benches.contains(&label) || rendered.into_iter().any(|s| *s == stage.replace('_', " "))
            }
            Place::Label => self.host.iter().any(|(path, code)| path.starts_with(&here) && code.contains(&label)),
        }
    }
}

#[test]
fn a_stage_has_one_name_everywhere() {
    let house = House::open();
    let shaders: Vec<String> = files("glsl", "comp")
        .iter()
        .map(|p| p.trim_start_matches("glsl/").trim_end_matches(".comp").to_owned())
        .filter(|s| !NO_STAGES.contains(&s.split('/').next().unwrap_or_default()))
        .collect();
    let mut wrong = Vec::new();
    for shader in shaders.iter().filter(|s| STEPS.iter().all(|(step, _)| step != s)) {
        for place in PLACES {
            let exempt = EXEMPT.iter().any(|(s, p, _)| s.contains(&shader.as_str()) && *p == place);
            match (house.has(shader, place), exempt) {
                (false, false) => wrong.push(format!("glsl/{shader}.comp: no {place:?} of that name")),
                (true, true) => wrong.push(format!("EXEMPT: {shader} has its {place:?} now")),
                _ => {}
            }
        }
    }
    let known = |name: &str| shaders.iter().any(|s| s == name);
    let exempt = EXEMPT.iter().flat_map(|e| e.0.iter().copied());
    for name in exempt.chain(STEPS.iter().flat_map(|(a, b)| [*a, *b])).filter(|n| !known(n)) {
        wrong.push(format!("{name}: no such shader"));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A root of a sum has the same bits with every C library. `hypot` has not.
#[test]
fn lengths_are_roots() {
    let calls = |path: &String| code(path).contains("hypot(");
    assert_eq!(files("src", "rs").into_iter().filter(calls).collect::<Vec<_>>(), Vec::<String>::new());
}

/// Drivers may assume that there is no NaN, which makes both false: `glsl/lib/finite.glsl` compares bits instead.
#[test]
fn shaders_ask_for_nan_by_bits() {
    let shaders = files("glsl", "comp").into_iter().chain(files("glsl", "glsl"));
    let asks = |path: &String| ["isnan(", "isinf("].iter().any(|call| code(path).contains(call));
    assert_eq!(shaders.filter(asks).collect::<Vec<_>>(), Vec::<String>::new());
}

/// Paths of this repository in a page: text in backquotes, and targets of links.
fn paths(page: &str) -> BTreeSet<String> {
    const TOPS: [&str; 6] = ["src/", "glsl/", "docs/", "tools/", "tests/", "benches/"];
    page.split(['`', '(', ')', ' ', '\n', '|', ','])
        .map(|word| word.split(['#', ':']).next().unwrap_or_default().trim_end_matches(['.', ';']))
        .filter(|word| TOPS.iter().any(|top| word.starts_with(top)))
        .filter(|word| word.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "/._-".contains(c)))
        .map(ToOwned::to_owned)
        .collect()
}

/// What README.md links to beside itself is in the crate, in the Debian package and in the archives.
#[test]
fn packages_hold_what_the_readme_links_to() {
    let [readme, manifest, package] = ["README.md", "Cargo.toml", "tools/package"].map(text);
    let targets = readme.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    let beside = targets.filter(|target| !target.is_empty() && !target.contains("://"));
    for target in beside.filter(|target| !["docs/", "LICENSE-"].iter().any(|whole| target.starts_with(whole))) {
        assert!(root().join(target).is_file(), "{target} is not there");
        assert!(manifest.contains(&format!("\"/{target}\"")), "{target} is not in the crate");
        assert!(manifest.contains(&format!("[\"{target}\"")), "{target} is not in the Debian package");
        assert!(package.contains(target), "{target} is not in the archives");
    }
}

#[test]
fn paths_in_the_documentation_exist() {
    let mut pages = files("docs", "md");
    pages.extend(fs::read_dir(root()).unwrap().flatten().filter_map(|e| {
        let name = PathBuf::from(e.file_name());
        (name.extension()? == "md").then(|| name.display().to_string())
    }));
    let mut named = 0;
    let mut missing = Vec::new();
    for page in pages {
        for path in paths(&text(&page)) {
            named += 1;
            if !root().join(&path).exists() {
                missing.push(format!("{page}: {path}"));
            }
        }
    }
    assert!(named > 20, "the pages name {named} paths");
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}
