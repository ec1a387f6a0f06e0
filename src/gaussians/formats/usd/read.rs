//! Reading a USD text layer.

use std::ops::RangeInclusive;

use glam::{DAffine3, DVec3};

use super::super::axes::{RIGHT_DOWN_FRONT, RIGHT_UP_BACK, convert, convert_place};
use super::super::turn::place;
use super::arrays::{Arrays, gaussians};
use super::scan::Scan;
use super::transform::Transform;
use super::{Fault, Format, Gaussians, PRIM, Parsed, TAG, Tag};
use crate::wording::shown;

/// Deepest nesting of prims.
const DEEPEST: usize = 1000;
/// Metadata that adds the content of other layers, or of other prims.
const ARCS: [&[u8]; 5] = [b"references", b"payload", b"subLayers", b"inherits", b"specializes"];
const ELSEWHERE: &str =
    "it refers to other layers or prims, which are not read; `usdcat --flatten in.usda -o out.usda` joins them";
const HIDDEN: &str =
    "each is invisible, inactive, a guide, a proxy, a class or an over; show it in the program that made the file";
/// Units of length that are read, in metres.
const UNITS: RangeInclusive<f64> = 1e-20..=1e20;

/// The Gaussians of a prim.
struct Part {
    gaussians: Gaussians,
    tag: Tag,
    /// The map from their axes to those of the scope that they are in, or to the layer's.
    map: DAffine3,
    /// True if the map leads to the layer's axes.
    reset: bool,
}

/// Metadata of a prim or of the layer.
#[derive(Default)]
struct Metadata {
    inactive: bool,
    tag: Tag,
    z_up: Option<bool>,
    /// Metres of a unit.
    unit: Option<f64>,
}

/// An open pair of braces.
#[derive(Default)]
struct Scope {
    /// Its prim's arrays, if it is one with Gaussians.
    splats: Option<Arrays>,
    name: String,
    tag: Tag,
    transform: Transform,
    /// The contents of the prims in it.
    parts: Vec<Part>,
    /// True if a stage shows nothing of it: a class, an `over`, inactive or invisible.
    hidden: bool,
    /// True if its own purpose is that of a guide or of a proxy; none if it has the purpose of the prim around it.
    aside: Option<bool>,
    /// True for the value of a property: a dictionary, or the variants of a set.
    value: bool,
    /// Attributes with time samples, which are not read, as far as they would change its Gaussians.
    sampled: Vec<String>,
}

impl Scope {
    /// Notes that an attribute has time samples.
    fn sample(&mut self, name: &[u8]) {
        let array = self.splats.as_mut().and_then(|arrays| arrays.named(name));
        let counts = array.is_some() || name == b"visibility" || name.starts_with(b"xformOp:");
        if let Some(array) = array {
            array.sampled = true;
        }
        if name.starts_with(b"xformOp:") {
            self.transform.sample(name);
        }
        if counts {
            self.sampled.push(String::from_utf8_lossy(name).into_owned());
        }
    }

    /// What a user should know of its time samples; those of transforms count where it has an order of them.
    fn doubt(&self) -> Option<String> {
        let counts = |name: &&str| !name.starts_with("xformOp:") || !self.transform.order.is_empty();
        let names: Vec<&str> = self.sampled.iter().map(String::as_str).filter(counts).collect();
        (!names.is_empty()).then(|| {
            format!(
                "prim {} has time samples of {}, which are not read: its default values are used; to get another time, \
                 export that frame",
                shown(&self.name, 40),
                shown(&names.join(", "), 120)
            )
        })
    }
}

/// Reads a text layer; its prims with Gaussians are one model.
pub(in super::super) fn read(text: &[u8]) -> Result<Parsed, Fault> {
    let mut reader =
        Reader { scan: Scan::new(text), layer: Metadata::default(), refers: false, hidden: false, parts: Vec::new() };
    reader.layer()?;
    let Reader { refers, hidden, parts, layer: Metadata { tag: of_layer, z_up, unit, .. }, .. } = reader;
    let upright = DAffine3::from_rotation_x(if z_up == Some(true) { -std::f64::consts::FRAC_PI_2 } else { 0.0 });
    let metres = unit.filter(|unit| UNITS.contains(unit)).unwrap_or(1.0);
    let in_metres = DAffine3::from_scale(DVec3::splat(metres)) * upright;
    let (mut model, mut tags, mut origin) = (None, Vec::new(), None);
    for Part { mut gaussians, tag, map, .. } in parts {
        let mut tag = tag.or(&of_layer);
        if let Some(doubt) = place(&mut gaussians, &(in_metres * map), &mut origin, "a prim")? {
            tag.add_doubt(doubt);
        }
        tags.push(tag);
        match &mut model {
            None => model = Some(gaussians),
            Some(model) => model.append(&gaussians),
        }
    }
    let Some(mut model) = model else {
        let why = match (refers, hidden) {
            (true, _) => ELSEWHERE,
            (false, true) => HIDDEN,
            (false, false) => "this USD holds no Gaussians; give another file",
        };
        return Err(Fault::Unsupported(format!(
            "no {}prim of type {PRIM}: {why}",
            if hidden { "visible " } else { "" }
        )));
    };
    convert(&mut model, RIGHT_UP_BACK, RIGHT_DOWN_FRONT);
    let mut tag = Tag::of_parts(tags);
    tag.add_first(refers.then(|| ELSEWHERE.to_owned()).into_iter().chain(unit.and_then(of_unit)));
    tag.origin = convert_place(origin.unwrap_or_default(), RIGHT_UP_BACK, RIGHT_DOWN_FRONT).to_array();
    Ok(Parsed { gaussians: model, format: Format::Usd, tag, trailing_bytes: 0 })
}

/// What a user should know of a layer's unit, in metres.
fn of_unit(unit: f64) -> Option<String> {
    if !UNITS.contains(&unit) {
        return Some(format!("its metersPerUnit, {unit}, is no length; its coordinates are taken as metres"));
    }
    (unit != 1.0).then(|| format!("its unit is {unit} m; positions and sizes were converted to metres"))
}

struct Reader<'a> {
    scan: Scan<'a>,
    layer: Metadata,
    /// True if a prim or the layer adds the content of others.
    refers: bool,
    /// True if a prim with Gaussians is not shown.
    hidden: bool,
    parts: Vec<Part>,
}

impl Reader<'_> {
    fn layer(&mut self) -> Result<(), Fault> {
        let mut scopes: Vec<Scope> = Vec::new();
        while let Some(first) = self.scan.peek() {
            match first {
                b'(' => {
                    let Metadata { tag, z_up, unit, .. } = self.metadata()?;
                    if scopes.is_empty() {
                        let layer = &mut self.layer;
                        layer.tag = tag.or(&layer.tag);
                        (layer.z_up, layer.unit) = (z_up.or(layer.z_up), unit.or(layer.unit));
                    }
                }
                b'{' => {
                    self.scan.at += 1;
                    scopes.push(Scope::default());
                }
                b'}' => {
                    self.scan.at += 1;
                    let Some(mut scope) = scopes.pop() else {
                        return Err(self.scan.fault("a brace that was not opened"));
                    };
                    if scope.hidden || scopes.iter().any(|scope| scope.hidden) {
                        self.hidden |= scope.splats.is_some() || !scope.parts.is_empty();
                        continue;
                    }
                    let aside = scope.aside.or_else(|| scopes.iter().rev().find_map(|scope| scope.aside));
                    if aside == Some(true) && scope.splats.take().is_some() {
                        self.hidden = true;
                    }
                    let doubt = scope.doubt();
                    if let Some(arrays) = scope.splats {
                        let (gaussians, tag) = gaussians(arrays, &scope.name)?;
                        scope.parts.push(Part { gaussians, tag, map: DAffine3::IDENTITY, reset: false });
                    }
                    if scope.value && !scope.parts.is_empty() {
                        return Err(Fault::Unsupported(
                            "a variant set holds Gaussians; select one variant by `usdcat --flatten`".into(),
                        ));
                    }
                    let around = scopes.last_mut().map_or(&mut self.parts, |scope| &mut scope.parts);
                    for mut part in scope.parts {
                        part.tag = part.tag.or(&scope.tag);
                        if let Some(doubt) = &doubt {
                            part.tag.add_doubt(doubt.clone());
                        }
                        if !part.reset {
                            part.map = scope.transform.map()? * part.map;
                            part.reset = scope.transform.resets();
                        }
                        around.push(part);
                    }
                }
                _ => self.statement(&mut scopes)?,
            }
            if scopes.len() > DEEPEST {
                return Err(self.scan.fault("prims nested too deeply"));
            }
        }
        if scopes.is_empty() { Ok(()) } else { Err(self.scan.fault("the text ends within a prim")) }
    }

    /// The begin of a prim, or a property.
    fn statement(&mut self, scopes: &mut Vec<Scope>) -> Result<(), Fault> {
        let word = self.scan.word().unwrap_or_default();
        if matches!(word, b"def" | b"over" | b"class") {
            let quoted = |b: u8| matches!(b, b'"' | b'\'');
            // A prim may have no type.
            let kind: &[u8] =
                if self.scan.peek().is_some_and(quoted) { b"" } else { self.scan.word().unwrap_or_default() };
            if !self.scan.peek().is_some_and(quoted) {
                return Ok(());
            }
            let name = String::from_utf8_lossy(self.scan.word().unwrap_or_default()).into_owned();
            let metadata = if self.scan.peek() == Some(b'(') { self.metadata()? } else { Metadata::default() };
            if self.scan.peek() != Some(b'{') {
                return Err(self.scan.fault("a prim without a brace"));
            }
            self.scan.at += 1;
            let splats = (kind == PRIM.as_bytes()).then(Arrays::default);
            let hidden = word != b"def" || metadata.inactive;
            scopes.push(Scope { splats, name, tag: metadata.tag, hidden, ..Scope::default() });
            return Ok(());
        }
        // The words of a property up to its value; the last of them is its name.
        let mut name = word;
        while !self.scan.line_ends() {
            match self.scan.peek() {
                Some(b'=') => {
                    self.scan.at += 1;
                    return self.property(name, scopes);
                }
                Some(b'(' | b'{' | b'}') | None => break,
                Some(_) => name = self.scan.word().unwrap_or_default(),
            }
        }
        if let Some(scope) = scopes.last_mut().filter(|_| name.starts_with(b"xformOp:")) {
            scope.transform.declare(name);
        }
        Ok(())
    }

    fn property(&mut self, name: &[u8], scopes: &mut Vec<Scope>) -> Result<(), Fault> {
        let Some(first) = self.scan.peek() else { return Err(self.scan.fault("the text ends before a value")) };
        if name == b"xformOpOrder" {
            let start = self.scan.at;
            self.scan.pass()?;
            let end = std::mem::replace(&mut self.scan.at, start);
            while self.scan.at < end {
                let word = self.scan.word().unwrap_or_default();
                if let Some(scope) =
                    scopes.last_mut().filter(|_| word.starts_with(b"xformOp:") || word.starts_with(b"!"))
                {
                    scope.transform.order.push(word.to_owned());
                }
            }
            return Ok(());
        }
        if first == b'{' {
            self.scan.at += 1;
            if let (Some(scope), Some(sampled)) = (scopes.last_mut(), name.strip_suffix(b".timeSamples")) {
                scope.sample(sampled);
            }
            scopes.push(Scope { value: true, ..Scope::default() });
            return Ok(());
        }
        if name == b"visibility" || name == b"purpose" {
            let word = self.scan.word();
            if let Some(scope) = scopes.last_mut() {
                scope.hidden |= matches!(word, Some(b"invisible"));
                if name == b"purpose" {
                    scope.aside = Some(matches!(word, Some(b"guide" | b"proxy")));
                    // Prims that stand before the purpose of the prim around them.
                    if scope.aside == Some(true) && !scope.parts.is_empty() {
                        scope.parts.clear();
                        self.hidden = true;
                    }
                }
            }
            return Ok(());
        }
        if let Some(scope) =
            scopes.last_mut().filter(|_| name.starts_with(b"xformOp:") && b"(-+.0123456789".contains(&first))
        {
            scope.transform.operations.insert(name.to_owned(), self.scan.numbers()?);
            return Ok(());
        }
        let is_none = first == b'N';
        if let Some(scope) = scopes.last_mut().filter(|_| name.starts_with(b"xformOp:") && is_none) {
            scope.transform.declare(name);
        }
        let Some(arrays) = scopes.last_mut().and_then(|scope| scope.splats.as_mut()) else { return self.scan.pass() };
        if is_none {
            return self.scan.pass();
        }
        if name == b"radiance:sphericalHarmonicsDegree" {
            arrays.degree = self.scan.numbers()?.first().copied();
            return Ok(());
        }
        let Some(array) = arrays.named(name) else { return self.scan.pass() };
        let numbers = self.scan.numbers()?;
        // An attribute may stand in both types; float counts.
        if array.values.as_ref().is_none_or(Vec::is_empty) || (!name.ends_with(b"h") && !numbers.is_empty()) {
            array.values = Some(numbers);
        }
        Ok(())
    }

    /// A group of metadata in parentheses; notes references.
    fn metadata(&mut self) -> Result<Metadata, Fault> {
        let mut metadata = Metadata::default();
        let start = self.scan.at;
        self.scan.pass()?;
        let end = std::mem::replace(&mut self.scan.at, start);
        let mut last: &[u8] = b"";
        let mut depth = 0_usize;
        while self.scan.at < end {
            let Some(word) = self.scan.word() else { break };
            match word {
                b"(" | b"{" => depth += 1,
                b")" | b"}" => depth = depth.saturating_sub(1),
                _ => {}
            }
            if word == b"=" && last == b"metersPerUnit" && depth == 1 {
                metadata.unit = self.scan.numbers()?.first().copied();
            } else if word == b"=" {
                let value = if self.scan.at < end { self.scan.word().unwrap_or_default() } else { b"" };
                depth += usize::from(matches!(value, b"(" | b"{"));
                match last {
                    b"upAxis" if depth == 1 => metadata.z_up = Some(value == b"Z"),
                    _ if depth == 1 && ARCS.contains(&last) => {
                        let mut next = || if self.scan.at < end { self.scan.word().unwrap_or_default() } else { b"" };
                        self.refers |= value != b"None" && (value != b"[" || next() != b"]");
                    }
                    b"active" if depth == 1 => metadata.inactive = matches!(value, b"false" | b"0"),
                    _ if last == TAG.as_bytes() => {
                        metadata.tag.comment(&[&format!("{TAG}:"), &String::from_utf8_lossy(value)]);
                    }
                    _ => {}
                }
            }
            last = word;
        }
        self.scan.at = end;
        Ok(metadata)
    }
}
