//! Markers of a page's generated parts: `<!-- figures: begin NAME -->` and `<!-- figures: end NAME -->`.

/// Every part that a page may have.
const KNOWN: [&str; 13] = [
    "device",
    "sort",
    "frame",
    "cost",
    "culling",
    "iteration",
    "effects",
    "kernels",
    "sweep",
    "exactness",
    "renders",
    "results",
    "bytes",
];

/// The page with each of these parts filled and everything else unchanged; `file` names it in errors.
///
/// # Errors
/// A part without markers, with repeated markers, or whose end comes first; markers of an unknown part.
pub fn fill(file: &str, page: &str, parts: &[(&'static str, String)]) -> Result<String, String> {
    for which in ["begin", "end"] {
        let mark = format!("<!-- figures: {which} ");
        let mut names = page.split(&mark).skip(1).filter_map(|rest| rest.split(" -->").next());
        if let Some(name) = names.find(|name| !KNOWN.contains(name)) {
            return Err(format!("{file}: there are no figures '{name}'; there are {}", KNOWN.join(", ")));
        }
    }
    parts.iter().try_fold(page.to_owned(), |page, (name, body)| {
        let marks = ["begin", "end"].map(|which| format!("<!-- figures: {which} {name} -->"));
        for mark in &marks {
            match page.matches(mark.as_str()).count() {
                1 => {}
                0 => {
                    return Err(format!(
                        "{file}: no line '{mark}'; put both marks of '{name}' where its figures belong"
                    ));
                }
                n => return Err(format!("{file}: '{mark}' occurs {n} times; leave one")),
            }
        }
        let [begin, end] = &marks;
        let (before, rest) = page.split_once(begin.as_str()).unwrap_or_default();
        let Some((_, after)) = rest.split_once(end.as_str()) else {
            return Err(format!("{file}: '{end}' comes before its beginning"));
        };
        Ok(format!("{before}{begin}\n{}\n{end}{after}", body.trim_end()))
    })
}
