//! A strict HTML reader: every element must be closed in its turn, every value quoted, every `<` and `&` in text
//! escaped.

const VOID: [&str; 6] = ["meta", "img", "input", "br", "hr", "link"];
const RAW: [&str; 2] = ["script", "style"];

/// An element with all the text within it.
pub struct Element {
    pub name: String,
    pub attributes: Vec<(String, String)>,
    pub text: String,
    parents: Vec<usize>,
}

impl Element {
    pub fn attribute(&self, key: &str) -> Option<&str> {
        self.attributes.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }

    /// Returns true if it matches `name`, `.class`, `#id`, `[key=value]`, or several of these in one.
    fn is(&self, compound: &str) -> bool {
        let starts: Vec<usize> = compound.match_indices(['.', '#', '[']).map(|(i, _)| i).collect();
        let (name, _) = compound.split_at(starts.first().copied().unwrap_or(compound.len()));
        let parts = starts.iter().enumerate().map(|(k, from)| {
            let until = starts.get(k + 1).copied().unwrap_or(compound.len());
            &compound[*from..until]
        });
        (name.is_empty() || name == self.name)
            && parts.into_iter().all(|part| match part.split_at(1) {
                (".", class) => self.attribute("class").is_some_and(|c| c.split(' ').any(|c| c == class)),
                ("#", id) => self.attribute("id") == Some(id),
                (_, pair) => {
                    let (key, value) = pair.trim_end_matches(']').split_once('=').expect("[key=value]");
                    self.attribute(key) == Some(value)
                }
            })
    }
}

pub struct Html(pub Vec<Element>);

impl Html {
    /// Elements by a selector of names, classes, ids and attributes, spaces between ancestors.
    pub fn select(&self, selector: &str) -> Vec<&Element> {
        let mut compounds: Vec<&str> = selector.split(' ').collect();
        let last = compounds.pop().expect("a selector");
        let within = |element: &Element| {
            let mut left = compounds.iter().rev().peekable();
            for parent in element.parents.iter().rev() {
                left.next_if(|c| self.0[*parent].is(c));
            }
            left.next().is_none()
        };
        self.0.iter().filter(|e| e.is(last) && within(e)).collect()
    }

    pub fn texts(&self, selector: &str) -> Vec<&str> {
        self.select(selector).into_iter().map(|e| e.text.as_str()).collect()
    }
}

/// Reads a page, or says what is wrong and where.
pub fn parse(page: &str) -> Result<Html, String> {
    let mut rest = page.strip_prefix("<!DOCTYPE html>").ok_or("no <!DOCTYPE html>")?;
    let mut elements: Vec<Element> = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    while !rest.is_empty() {
        let wrong = |what: &str| Err(format!("{what} at {:?}", rest.chars().take(60).collect::<String>()));
        let raw = open.last().filter(|i| RAW.contains(&elements[**i].name.as_str())).copied();
        let end = match raw {
            Some(i) => rest.find(&format!("</{}", elements[i].name)),
            None => rest.find('<'),
        };
        let (text, tag) = rest.split_at(end.unwrap_or(rest.len()));
        let text = if raw.is_some() { text.to_owned() } else { unescape(text)? };
        if open.is_empty() && !text.trim().is_empty() {
            return wrong("text outside");
        }
        for i in &open {
            elements[*i].text.push_str(&text);
        }
        if tag.is_empty() {
            break;
        }
        if let Some(closing) = tag.strip_prefix("</") {
            let (name, after) = closing.split_once('>').ok_or("an end tag without end")?;
            match open.pop() {
                Some(i) if elements[i].name == name => rest = after,
                _ => return wrong("an end tag out of turn"),
            }
            continue;
        }
        let (element, after) = start_tag(&tag[1..], &open)?;
        if elements.iter().any(|e| e.attribute("id").is_some() && e.attribute("id") == element.attribute("id")) {
            return wrong("an id given twice");
        }
        if !VOID.contains(&element.name.as_str()) {
            open.push(elements.len());
        }
        elements.push(element);
        rest = after;
    }
    if open.is_empty() { Ok(Html(elements)) } else { Err(format!("{} elements stay open", open.len())) }
}

fn start_tag<'a>(tag: &'a str, open: &[usize]) -> Result<(Element, &'a str), String> {
    let word = |t: &str| t.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(t.len());
    let (name, mut rest) = tag.split_at(word(tag));
    if name.is_empty() {
        return Err(format!("no name at {:?}", tag.chars().take(60).collect::<String>()));
    }
    let mut attributes = Vec::new();
    loop {
        if let Some(after) = rest.strip_prefix('>') {
            return Ok((Element { name: name.into(), attributes, text: String::new(), parents: open.to_vec() }, after));
        }
        let spaced = rest.strip_prefix(' ').ok_or_else(|| format!("<{name}>: no space before an attribute"))?;
        let (key, after) = spaced.split_at(word(spaced));
        if key.is_empty() || attributes.iter().any(|(k, _)| k == key) {
            return Err(format!("<{name}>: attribute {key:?}"));
        }
        let mut value = String::new();
        rest = after;
        if let Some(quoted) = after.strip_prefix("=\"") {
            let (inside, after) = quoted.split_once('"').ok_or("a value without end")?;
            (value, rest) = (unescape(inside)?, after);
        }
        attributes.push((key.to_owned(), value));
    }
}

fn unescape(text: &str) -> Result<String, String> {
    let mut pieces = text.split('&');
    let mut out = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (entity, after) = piece.split_once(';').ok_or_else(|| format!("a bare & before {piece:?}"))?;
        let entities = [("amp", '&'), ("lt", '<'), ("gt", '>'), ("quot", '"')];
        let known = entities.iter().find(|(name, _)| *name == entity);
        out.push(known.ok_or_else(|| format!("&{entity};"))?.1);
        out.push_str(after);
    }
    if out.contains('\0') { Err("a zero byte".into()) } else { Ok(out) }
}

#[test]
fn it_forgives_nothing() {
    let page = |body: &str| format!("<!DOCTYPE html><html>{body}</html>");
    assert!(parse(&page("<p class=\"a b\">x &amp; y<br>z</p><style>a>b &</style>")).is_ok());
    let wrong = ["<p><b>x</p></b>", "<p>", "</p>", "<p a=b></p>", "a & b", "< b", "<p id=\"x\"></p><i id=\"x\"></i>"];
    for wrong in wrong {
        assert!(parse(&page(wrong)).is_err(), "{wrong}");
    }
    let html = parse(&page("<div id=\"d\"><p class=\"a\" k=\"v\">1</p><i><p>2</p></i></div><p>3</p>")).unwrap();
    assert_eq!(html.texts("#d p"), ["1", "2"]);
    assert_eq!(html.texts("div i p"), ["2"]);
    assert_eq!(html.texts("p.a[k=v]"), ["1"]);
}
