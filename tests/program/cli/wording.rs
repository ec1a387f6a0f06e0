//! Words of messages: unknown names, numbers out of range, counts of one, and notes.

use super::{Sandbox, model};
use crate::program::ended::end;
use qirf_vk::gaussians::formats::{self, RenderMode};

#[test]
fn unknown_names_are_refused_in_one_form() {
    let sandbox = Sandbox::new();
    let run = |option: &'static str, name: &'static str| vec!["run", "scene", "-o", "out", option, name];
    let cases = [
        (run("--selector", "abc"), "'abc' is not a selector; possible values: gnso, "),
        (run("--budget", "abc"), "'abc' is not a budget; possible values: per-block, hybrid, global"),
        (run("--overlap", "abc"), "'abc' is not a kind of overlap; possible values: normalised, raw"),
        (run("--solver", "abc"), "'abc' is not an eigensolver; possible values: dsygvd, low-rank, low-rank-f32"),
        (run("--preset", "abc"), "'abc' is not a preset; possible values: paper, standard, quick"),
        (run("--schedule", "abc"), "'abc' is not a schedule; possible values: attrition, one-shot, gradual"),
        (run("--effect", "abc=on"), "'abc' is not an effect; possible values: view_dependence, "),
        (run("--effect", "abc"), "'abc' is not an effect; possible values: view_dependence, "),
        (run("--effect", "masks=abc"), "'abc' is not a choice; possible values: auto, on, off"),
        (run("--antialias=abc", "-q"), "'abc' is not a choice; possible values: on, off"),
        (run("--tuning", "abc"), "'abc' is not a class of devices; possible values: cpu, "),
        (run("--color", "abc"), "'abc' is not a choice; possible values: auto, always, never"),
        (run("--matching", "abc"), "'abc' is not a way of matching; possible values: auto, sequential, exhaustive"),
        (
            vec!["compare", "scene", "-o", "out", "--arms", "abc"],
            "'abc' is not an arm; possible values: default, paper, gns, ",
        ),
        (vec!["sweep", "scene", "-o", "out", "--axis", "abc"], "'abc' is not an axis; possible values: solver, "),
        (vec!["convert", "model.ply", "model.abc"], ".html for a page, or lod-meta.json"),
        (vec!["synth", "out", "--effects", "abc"], "'abc' is not an effect; possible values: exposure, "),
        (
            vec!["synth", "out", "--kind", "abc"],
            "'abc' is not a kind of scene; possible values: plaza, terrain, panorama",
        ),
    ];
    for (arguments, says) in cases {
        sandbox.fails(2, &arguments, &[says]);
    }
    assert!(!sandbox.path("out").exists());
}

#[test]
fn numbers_out_of_range_are_refused_by_what_is_allowed() {
    let sandbox = Sandbox::new();
    let run = |option: &'static str| vec!["run", "scene", "-o", "out", option, "-5"];
    for (arguments, says) in [
        (run("--resolution"), "neither a width in pixels"),
        (run("--keep"), "write a share above 0"),
        (run("--eval-every"), "write a whole number of 0 or more"),
        (run("--iterations"), "-5 is not in 1.."),
        (run("--seed"), "-5 is not in 0.."),
        (run("--epsilon"), "write a number of 0 or more"),
        (run("--memory-budget"), "write a number of bytes"),
        (vec!["synth", "out", "--views", "-5"], "write a whole number of 0 or more"),
        (vec!["device", "--tune", "abc"], "write a whole number of seconds from 1 to 3600"),
        (vec!["shard", "verify", "out", "--share", "-5"], "write a share above 0"),
    ] {
        sandbox.fails(2, &arguments, &["invalid value '", says]);
    }
    assert!(!sandbox.path("out").exists());
}

#[test]
fn one_is_singular() {
    let sandbox = Sandbox::new();
    let told = sandbox.works(&["synth", "one", "--views", "1", "--size", "16x16", "--points", "1"]).said;
    assert!(told.contains("1 photo (1 held out for tests)"), "{told}");
    let told = sandbox.works(&["render", "model.ply", "--orbit", "1", "-o", "orbit", "--size", "16x16"]).said;
    assert!(told.contains("1 picture in orbit"), "{told}");
}

/// Also where no device measures the loss.
#[test]
fn colours_that_a_written_file_cuts_off_are_warned_of() {
    let sandbox = Sandbox::new();
    let mut bright = model(3);
    bright.sh[1][0] = 1.5;
    formats::write(&sandbox.path("bright.ply"), &bright, RenderMode::Plain).unwrap();
    let edited = |name: &str| sandbox.works(&["edit", "bright.ply", "-o", name]).said;
    let converted = |name: &str| sandbox.converts(&["bright.ply", name]).said;
    for (name, said) in [("a.spz", converted("a.spz")), ("a.html", converted("a.html")), ("b.spz", edited("b.spz"))] {
        let told = format!("{name}: 1 Gaussian has spherical harmonics beyond the +-1 that SPZ stores");
        assert!(said.contains("warning:") && said.contains(&told), "{said}");
    }
    for said in [converted("a.sog"), edited("b.glb")] {
        assert!(!said.contains("warning:"), "{said}");
    }
}

#[test]
fn equal_pictures_are_called_equal_and_missing_weights_are_told_once_after_the_work() {
    let sandbox = Sandbox::new();
    let eval = |arguments: &[&str]| {
        let mut command = sandbox.command(arguments);
        // A folder of temporary files that the system names is no option.
        let command = command.env("TMPDIR", sandbox.path("scene"));
        end(command.env_remove("QIRF_LPIPS").env("XDG_DATA_HOME", sandbox.path("empty")))
    };
    let same = eval(&["eval", "model.ply", "--against", "model.ply"]).with(0, &[]);
    let mean = same.out.lines().last().unwrap_or_default();
    assert!(mean.starts_with("mean of 6") && mean.contains(" equal "), "{}", same.out);
    assert_eq!(same.said.matches("tools/lpips-weights").count(), 1, "{}", same.said);

    let refused = eval(&["eval", "model.ply", "scene"]);
    assert!(refused.code != Some(0) && !refused.said.contains("weights"), "{}", refused.said);
}
