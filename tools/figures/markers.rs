//! Where a page's generated parts lie: between `<!-- figures: begin NAME -->` and `<!-- figures: end NAME -->`.

/// The page with each named part filled, and all else as it was; `file` names it in errors.
///
/// # Errors
/// A part without markers, with several, or whose end comes first; markers of a part that is not among these.
pub fn fill(file: &str, page: &str, parts: &[(&'static str, String)]) -> Result<String, String> {
    for known in ["begin", "end"] {
        for name in page.split(&format!("<!-- figures: {known} ")).skip(1).filter_map(|rest| rest.split(" -->").next())
        {
            if !parts.iter().any(|(part, _)| *part == name) {
                let names: Vec<&str> = parts.iter().map(|(part, _)| *part).collect();
                return Err(format!("{file}: there are no figures '{name}'; there are {}", names.join(", ")));
            }
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
                n => return Err(format!("{file}: '{mark}' stands there {n} times; leave one")),
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
