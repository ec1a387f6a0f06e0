//! The options of a run: the keys of config.toml as keyword arguments, and short forms of them.

use crate::arrays::Resolution;
use crate::errors::{colour, number, share, wrong};
use crate::words::{refusal, repr};
use engine::effects::{Choice, Effect, Overrides};
use engine::gaussians::formats::RenderMode;
use engine::job::config::ranges::{MOST_GAUSSIANS, MOST_ITERATIONS};
use engine::job::config::{KEYS, Pruning};
use engine::job::{Init, Preset, RunConfig};
use engine::qirf::select::budget::Keep;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

type Table = Map<String, Value>;

/// Keys of config.toml's tables that it leaves out where they are not set.
const OPTIONAL: [&str; 4] = ["growth", "attrition", "rewarm", "l2_from"];
/// Keys whose tables are one of several kinds: none is completed by another.
const KINDS: [&str; 2] = ["keep", "partition"];
/// Keyword arguments that are no keys of config.toml.
const SHORT: [&str; 10] =
    ["iterations", "keep", "count", "preset", "output", "device", "resume", "overwrite", "on_step", "on_progress"];
/// Options of the program, and what they are here.
const PROGRAM: [(&str, &str); 12] = [
    ("target_count", "count"),
    ("grow_to", "schedule={\"growth\": {\"gaussians\": ...}}"),
    ("effect", "effects=[\"NAME=on\"]"),
    ("no_prune", "prune=False"),
    ("config", "**tomllib.load(file)"),
    ("selector", "prune={\"compression\": {\"selector\": ...}}"),
    ("budget", "prune={\"compression\": {\"budget\": ...}}"),
    ("detail", "prune={\"compression\": {\"detail\": ...}}"),
    ("merge", "prune={\"compression\": {\"merge\": ...}}"),
    ("solver", "prune={\"compression\": {\"basis\": {\"solver\": ...}}}"),
    ("partition", "prune={\"compression\": {\"basis\": {\"partition\": ...}}}"),
    ("overlap", "prune={\"compression\": {\"basis\": {\"overlap\": ...}}}"),
];

/// Options of the program that ask for a page, which train does not write.
const ABSENT: [&str; 2] = ["report", "no_report"];
/// Largest `count` of a run that grows: it grows to 1 / 0.28 times as many Gaussians, of which there are at most 100,000,000.
const MOST_GROWN: i64 = 28_000_000;

/// A value in Rust's type, or the refusal of it in Python's terms.
pub fn read<T: DeserializeOwned>(name: &str, value: &Value) -> PyResult<T> {
    serde_json::from_value(value.clone()).map_err(|e| wrong(refusal(name, value, &e.to_string())))
}

/// Takes an option out of them.
fn taken<T: DeserializeOwned>(options: &mut Table, name: &str) -> PyResult<Option<T>> {
    options.shift_remove(name).map(|value| read(name, &value)).transpose()
}

/// Takes a table out of the options, where the option is one.
fn taken_table(options: &mut Table, name: &str) -> Option<Table> {
    match options.shift_remove(name) {
        Some(Value::Object(table)) => Some(table),
        Some(other) => {
            options.insert(name.to_owned(), other);
            None
        }
        None => None,
    }
}

/// A part of a configuration as in config.toml.
fn table(part: &impl Serialize) -> PyResult<Table> {
    serde_json::to_value(part).and_then(serde_json::from_value).map_err(|e| wrong(e.to_string()))
}

/// A table with the given keys in place of its own; a table that has all of them stays as it is. None removes a key.
fn over(base: Table, given: Table) -> Table {
    let whole = base.keys().all(|key| OPTIONAL.contains(&key.as_str()) || given.contains_key(key));
    let mut out = if whole { Table::new() } else { base.clone() };
    for (key, value) in given {
        match (base.get(&key), value) {
            (_, Value::Null) => _ = out.shift_remove(&key),
            (Some(Value::Object(base)), Value::Object(given)) if !KINDS.contains(&key.as_str()) => {
                out.insert(key, Value::Object(over(base.clone(), given)));
            }
            (_, value) => _ = out.insert(key, value),
        }
    }
    out
}

/// The same configuration with these keys of config.toml.
fn with(config: &RunConfig, fields: Table) -> PyResult<RunConfig> {
    let given = Value::Object(fields);
    let fields: toml::Table = read("options", &given)?;
    check_types(config, &fields, &given)?;
    config.with(fields).map_err(|e| wrong(e.to_string().replace(": write ", ": give ")))
}

/// Refuses a value of the wrong type by its place in the tables, which the text of a config.toml does not tell.
fn check_types(config: &RunConfig, fields: &toml::Table, given: &Value) -> PyResult<()> {
    let mut whole = toml::Table::try_from(config).map_err(|e| wrong(e.to_string()))?;
    whole.extend(fields.clone());
    let Err(error) = whole.try_into::<RunConfig>() else { return Ok(()) };
    let text = error.to_string();
    let place = text.lines().find_map(|line| line.strip_prefix("in `")?.strip_suffix('`'));
    // The keys of styles are read without their place.
    let place = place.or_else(|| given.get("dilation").map(|_| "dilation")).unwrap_or("options");
    let value = place.split('.').try_fold(given, |value, key| value.get(key)).unwrap_or(&Value::Null);
    Err(wrong(refusal(place, value, error.message())))
}

/// Refuses keyword arguments that there are not.
fn check_names(py: Python<'_>, options: &Table) -> PyResult<()> {
    let known: Vec<&str> = KEYS.split(", ").chain(SHORT).collect();
    let Some(name) = options.keys().find(|name| !known.contains(&name.as_str())) else { return Ok(()) };
    if let Some((_, here)) = PROGRAM.iter().find(|(option, _)| option == name) {
        return Err(PyTypeError::new_err(format!("{name}: did you mean {here}? train has no keyword {name}")));
    }
    if ABSENT.contains(&name.as_str()) {
        let what = "train writes no report; the record of the run has its figures";
        return Err(PyTypeError::new_err(format!("{name}: {what}")));
    }
    let near = py.import("difflib")?.call_method1("get_close_matches", (name, &known, 1))?;
    Err(PyTypeError::new_err(match near.extract::<Vec<String>>()?.first() {
        Some(near) => format!("{name}: did you mean {near}? train has no keyword {name}"),
        None => format!("train has no keyword {name}; it has {}", known.join(", ")),
    }))
}

/// Refuses numbers beyond the 64 bits of config.toml's; JSON has made floats of the largest.
fn check_numbers(options: &Table) -> PyResult<()> {
    let end = 2_f64.powi(63);
    for (name, value) in options {
        let Value::Number(number) = value else { continue };
        if number.is_u64() && !number.is_i64() {
            return Err(wrong(format!("{name}={number}: give a smaller number")));
        }
        match number.as_f64().filter(|_| number.is_f64()) {
            Some(float) if float >= end => return Err(wrong(format!("{name}: give a number below 2^63"))),
            Some(float) if float < -end => return Err(wrong(format!("{name}: give a number above -2^63"))),
            _ => {}
        }
    }
    Ok(())
}

/// Refuses a whole number of an option that is not from 1 to `most`.
fn check_range(options: &Table, name: &str, most: i64) -> PyResult<()> {
    match options.get(name).and_then(Value::as_i64).filter(|value| !(1..=most).contains(value)) {
        Some(value) => Err(wrong(format!("{name}={value}: give a number from 1 to {most}"))),
        None => Ok(()),
    }
}

/// Refuses colours and sizes of photos that are none, in the words of the other functions' arguments.
fn check_pictures(options: &mut Table) -> PyResult<()> {
    if let Some(given @ (Value::Number(_) | Value::String(_))) = options.get_mut("resolution") {
        let text = given.as_str().map_or_else(|| given.to_string(), ToOwned::to_owned);
        *given = Value::String(Resolution::of(text, &repr(given))?.0);
    }
    let background = options.get("background").map(|given| serde_json::from_value::<[f32; 3]>(given.clone()));
    if let Some(Ok(background)) = background {
        colour(background)?;
    }
    Ok(())
}

/// True if the options are a whole config.toml, which has values for everything that a preset decides.
fn is_whole(config: &RunConfig, options: &Table) -> PyResult<bool> {
    let always = table(config)?;
    let mut needed = always.keys().filter(|key| !["scene", "effects"].contains(&key.as_str()));
    let short = ["iterations", "keep", "count"].iter().any(|name| options.contains_key(*name));
    let tables = ["schedule", "effects", "prune"].iter().all(|name| options.get(*name).is_none_or(Value::is_object));
    Ok(!short && tables && needed.all(|key| options.contains_key(key)))
}

/// The configuration of a run: the preset's, with these options. Those that are a whole config.toml are that run.
pub fn configuration(py: Python<'_>, scene: PathBuf, preset: &str, mut options: Table) -> PyResult<RunConfig> {
    let preset: Preset = read("preset", &preset.into())?;
    let mut config = RunConfig::of(scene, preset);
    options.retain(|_, value| !value.is_null());
    check_names(py, &options)?;
    check_numbers(&options)?;
    check_pictures(&mut options)?;
    if let Some(Value::String(init)) = options.get("init")
        && !["points", "random"].contains(&init.as_str())
    {
        let model = json!({ "model": init });
        options.insert("init".to_owned(), model);
    }
    if is_whole(&config, &options)? {
        config.effects = Overrides::default();
        return with(&config, options);
    }
    let schedule = taken_table(&mut options, "schedule");
    check_range(&options, "iterations", i64::from(MOST_ITERATIONS))?;
    config = scheduled(config, preset, taken(&mut options, "iterations")?, schedule)?;
    decide_effects(&mut config, &mut options)?;
    let all = i64::try_from(MOST_GAUSSIANS).unwrap_or(i64::MAX);
    check_range(&options, "count", if config.schedule.growth.is_some() { MOST_GROWN } else { all })?;
    if let Some(pruning) = pruning(preset, &mut options)? {
        config = config.pruned(pruning);
    }
    with(&config, options)
}

/// The schedule of the preset, of this length, with these keys.
fn scheduled(
    mut config: RunConfig,
    preset: Preset,
    iterations: Option<u32>,
    given: Option<Table>,
) -> PyResult<RunConfig> {
    let Some(given) = given else {
        config.schedule = preset.schedule(iterations);
        return Ok(config);
    };
    let own = given.get("iterations").map(|length| read("schedule.iterations", length)).transpose()?;
    if let (Some(iterations), Some(own)) = (iterations, own)
        && iterations != own
    {
        let what = format!("iterations={iterations} contradicts schedule={{\"iterations\": {own}}}: leave out one");
        return Err(wrong(what));
    }
    config.schedule = preset.schedule(iterations.or(own));
    let schedule = over(table(&config.schedule)?, given);
    with(&config, Table::from_iter([("schedule".to_owned(), Value::Object(schedule))]))
}

/// Asks for the effects that are switched, by a keyword of their own or by `effects`.
fn decide_effects(config: &mut RunConfig, options: &mut Table) -> PyResult<()> {
    let choice = |on: bool| if on { Choice::On } else { Choice::Off };
    let named = match options.shift_remove("effects") {
        None => Vec::new(),
        Some(Value::Object(table)) => table
            .iter()
            .map(|(name, choice)| match choice {
                Value::Bool(on) => Ok(format!("{name}={}", if *on { "on" } else { "off" })),
                other => read(&format!("effects[\"{name}\"]"), other).map(|choice: String| format!("{name}={choice}")),
            })
            .collect::<PyResult<Vec<String>>>()?,
        Some(one @ Value::String(_)) => vec![read("effects", &one)?],
        Some(list) => read("effects", &list)?,
    };
    let named = named.iter().map(|text| Overrides::parse(text).map_err(wrong)).collect::<PyResult<Vec<_>>>()?;
    let mut switched = Vec::new();
    // In config.toml these keys tell what was decided; here they ask for it.
    for (name, effect, _) in config.switches() {
        if let Some(on) = taken::<bool>(options, name)? {
            switched.push((format!("{name}={}", repr(&on.into())), effect, choice(on)));
        }
    }
    if let Some(degree) = options.get("sh_degree").and_then(Value::as_u64) {
        switched.push((format!("sh_degree={degree}"), Effect::ViewDependence, choice(degree > 0)));
    }
    for (effect, choice) in &named {
        config.effects.set(*effect, *choice);
    }
    for (argument, effect, asked) in switched {
        let other = named.iter().find(|(named, choice)| *named == effect && ![asked, Choice::Auto].contains(choice));
        if let Some((effect, other)) = other {
            let what = format!("{argument} contradicts effects={{\"{}\": \"{other}\"}}: leave out one", effect.name());
            return Err(wrong(what));
        }
        config.effects.set(effect, asked);
    }
    Ok(())
}

/// The pruning that is asked for; none for a dense run.
fn pruning(preset: Preset, options: &mut Table) -> PyResult<Option<Pruning>> {
    let keep = match (taken(options, "keep")?, taken(options, "count")?) {
        (Some(_), Some(_)) => return Err(wrong("keep and count ask for two numbers of Gaussians; give one of them")),
        (Some(keep), None) => Some(Keep::Share(share(keep)?)),
        (None, Some(count)) => Some(Keep::Count(number("count", count, 1)?)),
        (None, None) => None,
    };
    let steps: Option<String> = taken(options, "schedule")?;
    let given = taken_table(options, "prune");
    if given.is_none() && taken(options, "prune")? == Some(false) {
        return match (keep, steps) {
            (None, None) => Ok(None),
            (Some(_), _) => Err(wrong("prune=False keeps all: leave out keep and count")),
            (_, Some(steps)) => Err(wrong(format!("prune=False contradicts schedule=\"{steps}\": leave out one"))),
        };
    }
    let usual = preset.pruning();
    let process = match steps.as_deref() {
        None => usual.clone(),
        Some("attrition") => Pruning::default(),
        Some("one-shot") => Pruning::at_once(),
        Some("gradual") => Pruning::gradual(),
        Some(other) => {
            let known = "give \"attrition\", \"one-shot\" or \"gradual\", which prune, or a dict as in config.toml";
            return Err(wrong(format!("schedule=\"{other}\": {known}")));
        }
    };
    let mut pruning = Pruning { responses: usual.responses, compression: usual.compression, ..process };
    if let Some(given) = given {
        if let Some(steps) = steps {
            return Err(wrong(format!("schedule=\"{steps}\" and a dict as prune are two schedules: leave out one")));
        }
        let own = given.get("compression").and_then(|rule| rule.get("keep"));
        if keep.is_some() && own.is_some_and(|own| Some(own) != serde_json::to_value(keep).ok().as_ref()) {
            let what = "keep and count contradict prune={\"compression\": {\"keep\": ...}}: leave out one";
            return Err(wrong(what));
        }
        pruning = read_pruning(over(table(&pruning)?, given))?;
    }
    pruning.compression.keep = keep.unwrap_or(pruning.compression.keep);
    Ok(Some(pruning))
}

/// A pruning as in config.toml, whose faults are named by their place.
fn read_pruning(given: Table) -> PyResult<Pruning> {
    let given = Value::Object(given);
    let table: toml::Table = read("prune", &given)?;
    table.try_into().map_err(|e: toml::de::Error| {
        let text = e.to_string();
        let place = text.lines().find_map(|line| line.strip_prefix("in `")?.strip_suffix('`')).unwrap_or_default();
        let keys = place.split('.').filter(|key| !key.is_empty());
        let value = keys.clone().try_fold(&given, |value, key| value.get(key)).unwrap_or(&Value::Null);
        wrong(refusal(&std::iter::once("prune").chain(keys).collect::<Vec<_>>().join("."), value, e.message()))
    })
}

/// The same run from an initial model of this mode, at this place: anti-aliased if the model is, unless an option decides.
pub fn from_model(mut config: RunConfig, path: &Path, mode: RenderMode, asked: bool) -> RunConfig {
    if !asked && mode.antialiased() {
        config.effects.set(Effect::Antialias, Choice::On);
    }
    config.init = Init::Model(path.to_owned());
    config
}
