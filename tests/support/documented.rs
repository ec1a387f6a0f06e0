//! Fields of JSON documents, compared with their description in docs/metrics.md.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Fields whose own fields have varying names, or are described with other documents.
const OPEN: [&str; 11] =
    ["device", "effects", "figures", "gaussians", "guards", "protocol", "prune", "tables", "test", "train", "views"];

/// Fails if a document has fields that its section of docs/metrics.md does not name.
pub fn documented(section: &str, document: &Value) {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md")).unwrap();
    let text = page.split("\n## ").find(|text| text.split(['\n', ',']).next() == Some(section)).expect(section);
    let spans = text.split('`').skip(1).step_by(2);
    let known: BTreeSet<&str> = spans.flat_map(|s| s.split(|c: char| !c.is_alphanumeric() && c != '_')).collect();
    check(section, document, &known);
}

fn check(section: &str, value: &Value, known: &BTreeSet<&str>) {
    if let Value::Array(items) = value {
        for item in items {
            check(section, item, known);
        }
    }
    for (name, field) in value.as_object().into_iter().flatten() {
        assert!(known.contains(name.as_str()), "docs/metrics.md, {section}: no word on {name}");
        if !OPEN.contains(&name.as_str()) {
            check(section, field, known);
        }
    }
}
