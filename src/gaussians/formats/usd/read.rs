//! Reading a USD text layer.

use glam::DAffine3;

use super::super::axes::{RIGHT_DOWN_FRONT, RIGHT_UP_BACK, convert, convert_place};
use super::super::linear::{log_scale, logit};
use super::super::turn::place;
use super::scan::Scan;
use super::transform::Transform;
use super::{AGAIN, Fault, Format, Gaussians, PRIM, Parsed, TAG, Tag, malformed};
use crate::gaussians::MAX_SH_DEGREE;
use crate::wording::shown;

/// Deepest nesting of prims.
const DEEPEST: usize = 1000;

/// Attributes of a prim with Gaussians.
#[derive(Default)]
struct Arrays {
    positions: Option<Vec<f32>>,
    orientations: Option<Vec<f32>>,
    scales: Option<Vec<f32>>,
    opacities: Option<Vec<f32>>,
    degree: Option<f32>,
    coefficients: Option<Vec<f32>>,
}

/// Gaussians, and the map from their axes to those of the scope that they are in.
type Part = (Gaussians, DAffine3);

/// An open pair of braces.
#[derive(Default)]
struct Scope {
    /// Its prim's arrays, if it is one with Gaussians.
    splats: Option<Arrays>,
    name: String,
    transform: Transform,
    /// The contents of the prims in it.
    parts: Vec<Part>,
}

/// Reads a text layer; its prims with Gaussians are one model.
pub(in super::super) fn read(text: &[u8]) -> Result<Parsed, Fault> {
    let mut reader = Reader { scan: Scan::new(text), tag: Tag::default(), z_up: false, parts: Vec::new() };
    reader.layer()?;
    let Reader { z_up, parts, mut tag, .. } = reader;
    let upright = DAffine3::from_rotation_x(if z_up { -std::f64::consts::FRAC_PI_2 } else { 0.0 });
    let (mut model, mut origin) = (None, None);
    for (mut part, map) in parts {
        if !place(&mut part, &(upright * map), &mut origin) {
            return Err(Fault::Unsupported(
                "a prim is scaled by different factors along its axes; apply its transform in the program that made the \
                 file"
                    .into(),
            ));
        }
        match &mut model {
            None => model = Some(part),
            Some(model) => model.append(&part),
        }
    }
    let Some(mut model) = model else {
        return Err(Fault::Unsupported(format!(
            "no prim of type {PRIM}: this USD holds no Gaussians; give another file"
        )));
    };
    convert(&mut model, RIGHT_UP_BACK, RIGHT_DOWN_FRONT);
    tag.origin = convert_place(origin.unwrap_or_default(), RIGHT_UP_BACK, RIGHT_DOWN_FRONT).to_array();
    Ok(Parsed { gaussians: model, format: Format::Usd, tag, trailing_bytes: 0 })
}

struct Reader<'a> {
    scan: Scan<'a>,
    tag: Tag,
    z_up: bool,
    parts: Vec<Part>,
}

impl Reader<'_> {
    fn layer(&mut self) -> Result<(), Fault> {
        let mut scopes: Vec<Scope> = Vec::new();
        while let Some(first) = self.scan.peek() {
            match first {
                b'(' => self.metadata()?,
                b'{' => {
                    self.scan.at += 1;
                    scopes.push(Scope::default());
                }
                b'}' => {
                    self.scan.at += 1;
                    let Some(mut scope) = scopes.pop() else {
                        return Err(self.scan.fault("a brace that was not opened"));
                    };
                    if let Some(arrays) = scope.splats {
                        scope.parts.push((gaussians(arrays, &scope.name)?, DAffine3::IDENTITY));
                    }
                    let around = scopes.last_mut().map_or(&mut self.parts, |scope| &mut scope.parts);
                    for (part, map) in scope.parts {
                        around.push((part, scope.transform.map()? * map));
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
            let mut kind = self.scan.word().unwrap_or_default();
            if self.scan.peek().is_some_and(|b| matches!(b, b'"' | b'\'')) {
                let name = String::from_utf8_lossy(self.scan.word().unwrap_or_default()).into_owned();
                if self.scan.peek() == Some(b'(') {
                    self.metadata()?;
                }
                if self.scan.peek() != Some(b'{') {
                    return Err(self.scan.fault("a prim without a brace"));
                }
                self.scan.at += 1;
                if word != b"def" {
                    kind = b"";
                }
                let splats = (kind == PRIM.as_bytes()).then(Arrays::default);
                scopes.push(Scope { splats, name, ..Scope::default() });
            } else if self.scan.peek() == Some(b'{') {
                // `def "name"`: what was taken for the type is the name.
                self.scan.at += 1;
                scopes.push(Scope::default());
            }
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
        Ok(())
    }

    fn property(&mut self, name: &[u8], scopes: &mut [Scope]) -> Result<(), Fault> {
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
            return Ok(()); // a variant set, whose braces are scopes
        }
        if let Some(scope) =
            scopes.last_mut().filter(|_| name.starts_with(b"xformOp:") && b"(-+.0123456789".contains(&first))
        {
            scope.transform.operations.insert(name.to_owned(), self.scan.numbers()?);
            return Ok(());
        }
        let Some(arrays) = scopes.last_mut().and_then(|scope| scope.splats.as_mut()) else { return self.scan.pass() };
        let values = match name {
            b"positions" | b"positionsh" => &mut arrays.positions,
            b"orientations" | b"orientationsh" => &mut arrays.orientations,
            b"scales" | b"scalesh" => &mut arrays.scales,
            b"opacities" | b"opacitiesh" => &mut arrays.opacities,
            b"radiance:sphericalHarmonicsCoefficients" | b"radiance:sphericalHarmonicsCoefficientsh" => {
                &mut arrays.coefficients
            }
            b"radiance:sphericalHarmonicsDegree" => {
                arrays.degree = self.scan.numbers()?.first().copied();
                return Ok(());
            }
            _ => return self.scan.pass(),
        };
        *values = Some(self.scan.numbers()?);
        Ok(())
    }

    /// A group of metadata in parentheses: which axis is up, and our tag.
    fn metadata(&mut self) -> Result<(), Fault> {
        let start = self.scan.at;
        self.scan.pass()?;
        let end = std::mem::replace(&mut self.scan.at, start);
        let mut last: &[u8] = b"";
        while self.scan.at < end {
            let Some(word) = self.scan.word() else { break };
            if word == b"=" {
                let value = if self.scan.at < end { self.scan.word().unwrap_or_default() } else { b"" };
                match last {
                    b"upAxis" => self.z_up = value == b"Z",
                    _ if last == TAG.as_bytes() => {
                        self.tag.comment(&[&format!("{TAG}:"), &String::from_utf8_lossy(value)]);
                    }
                    _ => {}
                }
            }
            last = word;
        }
        self.scan.at = end;
        Ok(())
    }
}

/// The Gaussians of a prim, in the layer's axes.
fn gaussians(arrays: Arrays, name: &str) -> Result<Gaussians, Fault> {
    let record = format!("prim {}", shown(name, 40));
    let need = |values: Option<Vec<f32>>, what: &str| {
        values.ok_or_else(|| {
            malformed(&record, format!("has no {what} of its own, only perhaps in time samples; {AGAIN}"))
        })
    };
    let positions = need(arrays.positions, "positions")?;
    let n = positions.len() / 3;
    let of = |values: Option<Vec<f32>>, what: &str, width: usize| -> Result<Vec<f32>, Fault> {
        let values = need(values, what)?;
        if values.len() == n * width && positions.len() == 3 * n {
            return Ok(values);
        }
        Err(malformed(&record, format!("{} numbers of {what} for {n} positions; {AGAIN}", values.len())))
    };
    let rotations = of(arrays.orientations, "orientations", 4)?.as_chunks().0.to_vec();
    let scales: Vec<f32> = of(arrays.scales, "scales", 3)?.into_iter().map(log_scale).collect();
    let opacities = of(arrays.opacities, "opacities", 1)?;
    let coefficients = need(arrays.coefficients, "radiance:sphericalHarmonicsCoefficients")?;
    let degrees = 0..=MAX_SH_DEGREE;
    // The schema's own default is 3.
    let degree = degrees.into_iter().find(|l| *l as f32 == arrays.degree.unwrap_or(3.0));
    let degree = degree.ok_or_else(|| {
        let what = format!(
            "SH degree {}; 0 to {MAX_SH_DEGREE} are read, export it with one of these",
            arrays.degree.unwrap_or(3.0)
        );
        Fault::Unsupported(what)
    })?;
    let width = 3 * (degree + 1).pow(2);
    if coefficients.len() != n * width {
        let what = format!("{} numbers of SH for {n} positions and degree {degree}; {AGAIN}", coefficients.len());
        return Err(malformed(record, what));
    }
    let band = |l: usize| -> Vec<f32> {
        coefficients.chunks_exact(width).flat_map(|row| &row[3 * l * l..3 * (l + 1) * (l + 1)]).copied().collect()
    };
    Ok(Gaussians {
        means: positions.as_chunks().0.to_vec(),
        log_scales: scales.as_chunks().0.to_vec(),
        rotations,
        opacity_logits: opacities.into_iter().map(logit).collect(),
        sh: (0..=degree).map(band).collect(),
    })
}
