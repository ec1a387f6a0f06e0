//! The engine's words in Python's terms.

use serde_json::Value;

/// Options of the program as keyword arguments, where the name alone is not enough.
const PHRASES: [(&str, &str); 4] = [
    ("(`run` and `compare` with --resume)", "with resume=True"),
    ("--selector pairs", "selector=\"pairs\""),
    ("--least-views", "least"),
    ("--clean", "clean=True"),
];

/// A message with the names of keyword arguments in place of the program's options: `--eval-every 0` is `eval_every=0`.
pub fn in_python(message: &str) -> String {
    let text = PHRASES.iter().fold(message.to_owned(), |text, (option, argument)| text.replace(option, argument));
    let mut out = String::new();
    let mut rest = text.as_str();
    while let Some(at) = rest.find("--") {
        let (before, option) = (&rest[..at], &rest[at + 2..]);
        let end = option.find(|c: char| !(c.is_ascii_lowercase() || c == '-')).unwrap_or(option.len());
        let free = before.is_empty() || before.ends_with([' ', '(', '`', '"', '\'']);
        out += before;
        if !free || !option.starts_with(|c: char| c.is_ascii_lowercase()) {
            out += "--";
            rest = option;
            continue;
        }
        let (argument, left) = argument(&option[..end], &option[end..]);
        out += &argument;
        rest = left;
    }
    out + rest
}

/// A keyword argument for an option, with its value if one follows, and the text after it.
fn argument<'a>(option: &str, after: &'a str) -> (String, &'a str) {
    let name = option.replace('-', "_");
    let value = after.strip_prefix(' ').unwrap_or_default();
    let end = value.find(|c: char| !(c.is_ascii_alphanumeric() || "._=".contains(c))).unwrap_or(value.len());
    let (value, left) = value.split_at(end);
    if name == "effect" && value.contains('=') {
        return (format!("effects=[\"{value}\"]"), left);
    }
    if !value.starts_with(|c: char| c.is_ascii_digit()) {
        return (name, after);
    }
    let quote = if value.parse::<f64>().is_ok() { "" } else { "\"" };
    (format!("{name}={quote}{value}{quote}"), left)
}

/// A value as Python writes it.
pub fn repr(value: &Value) -> String {
    match value {
        Value::Null => "None".to_owned(),
        Value::Bool(true) => "True".to_owned(),
        Value::Bool(false) => "False".to_owned(),
        Value::Number(number) => number.to_string(),
        Value::String(text) => format!("{text:?}"),
        Value::Array(items) => format!("[{}]", items.iter().map(repr).collect::<Vec<_>>().join(", ")),
        Value::Object(table) => {
            let items = table.iter().map(|(key, value)| format!("{key:?}: {}", repr(value)));
            format!("{{{}}}", items.collect::<Vec<_>>().join(", "))
        }
    }
}

/// What Python calls a type that serde expects, where a whole number is given or not.
fn needed(expected: &str, is_whole: bool) -> String {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" if is_whole => {
            "a whole number of 0 or more, and not too large,".to_owned()
        }
        "u8" | "u16" | "u32" | "u64" | "usize" | "i64" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a boolean" => "True or False".to_owned(),
        "a string" | "path string" | "string" => "a string".to_owned(),
        "a sequence" => "a list".to_owned(),
        "an array of length 3" => "a list of three numbers".to_owned(),
        "a map" | "map" => "a dict".to_owned(),
        other if other.starts_with("struct ") => "a dict".to_owned(),
        other if other.starts_with("enum ") || ["string or map", "string or table", "string only"].contains(&other) => {
            "a name, or a dict of one,".to_owned()
        }
        other => other.to_owned(),
    }
}

/// The names between backquotes.
pub fn names(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

/// serde's refusal of a value of an argument, or of a key in it, such as `schedule.iterations`.
pub fn refusal(name: &str, value: &Value, message: &str) -> String {
    let listed = |names: &[&str]| names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
    let message = message.trim();
    if let Some((what, expected)) = message.split_once(", expected ") {
        let known = names(expected);
        if what.starts_with("unknown variant ") {
            return format!("{name} is {}: give one of {}", repr(value), listed(&known));
        }
        if what.starts_with("unknown field ") {
            let key = names(what).concat();
            return format!("{name} has a key \"{key}\" that is not known: its keys are {}", listed(&known));
        }
        if what.starts_with("invalid ") && name == "init" {
            let known = "\"points\", \"random\", the path of a model, or a Model";
            return format!("init is {}: give {known}", repr(value));
        }
        if what.starts_with("invalid ") {
            let whole = value.is_i64() || value.is_u64();
            return format!("{name} is {}, {} is needed", repr(value), needed(expected, whole));
        }
    }
    match message.strip_prefix("missing field ") {
        Some(key) => format!("{name} needs the key \"{}\"", key.trim_matches('`')),
        None => format!("{name}: {message}"),
    }
}
