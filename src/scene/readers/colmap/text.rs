//! COLMAP's text files: one record a line (images: two), fields split by spaces, `#` starts a comment line.

use std::path::Path;
use std::str::FromStr;

use glam::DVec2;

use super::super::files;
use super::{Cameras, ImageRow, Mark, PointRow, cameras_of, few};
use crate::scene::Error;
use crate::scene::lens::{Lens, LensModel};

/// The fields of one line.
struct Fields<'a> {
    rest: &'a str,
    taken: usize,
}

impl<'a> Fields<'a> {
    fn new(line: &'a str) -> Self {
        Self { rest: line.trim(), taken: 0 }
    }

    fn word(&mut self, what: &str) -> Result<&'a str, String> {
        let (word, rest) = self.rest.split_once(char::is_whitespace).unwrap_or((self.rest, ""));
        self.rest = rest.trim_start();
        self.taken += 1;
        if word.is_empty() { Err(format!("ends before its {what} (field {})", self.taken)) } else { Ok(word) }
    }

    fn value<T: FromStr>(&mut self, what: &str) -> Result<T, String> {
        let word = self.word(what)?;
        let told = |_| format!("its {what} (field {}) is not a number of its kind: {word:?}", self.taken);
        // Whole numbers may be written as 1920.0.
        let whole = word.trim_end_matches('0').strip_suffix('.').unwrap_or(word);
        // C++ writes NaN in several ways: nan, -nan(ind).
        let nan = if word.trim_start_matches('-').to_ascii_lowercase().starts_with("nan") { "NaN" } else { word };
        word.parse().or_else(|_| whole.parse()).or_else(|_| nan.parse()).map_err(told)
    }

    fn values<const N: usize>(&mut self, what: &str) -> Result<[f64; N], String> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.value(what)?;
        }
        Ok(values)
    }
}

/// Lines that hold a record, with their numbers from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| is_record(line))
}

fn is_record(line: &str) -> bool {
    !line.trim().is_empty() && !line.trim_start().starts_with('#')
}

/// cameras.txt.
pub(super) fn cameras(path: &Path) -> Result<Cameras, Error> {
    let text = files::read_text(path)?;
    let read = |(number, line)| {
        let record = format!("line {number}");
        match camera(line) {
            Ok((id, lens)) => Ok((record, id, lens)),
            Err(what) => Err(Error::malformed(path, record, what)),
        }
    };
    let read: Vec<_> = lines(&text).map(read).collect::<Result<_, Error>>()?;
    cameras_of(path, read.into_iter())
}

/// A camera's id, and its lens or what is wrong with that.
fn camera(line: &str) -> Result<(u32, Result<Lens, String>), String> {
    let mut fields = Fields::new(line);
    let id = fields.value("camera id")?;
    let name = fields.word("model")?;
    let model = LensModel::from_name(&name.to_uppercase());
    let model = model.ok_or_else(|| LensModel::unsupported(name, LensModel::ALL))?;
    let (width, height) = (fields.value("width")?, fields.value("height")?);
    let mut parameters = Vec::with_capacity(model.parameters());
    while !fields.rest.is_empty() {
        parameters.push(fields.value("parameter")?);
    }
    Ok((id, Lens::from_colmap(model, width, height, &parameters)))
}

/// images.txt: each image takes two lines; the second, its 2D points, is kept if `marks` is set.
pub(super) fn images(path: &Path, marks: bool) -> Result<Vec<ImageRow>, Error> {
    let text = files::read_text(path)?;
    let mut rows = Vec::new();
    let mut all = text.lines().enumerate();
    while let Some((i, line)) = all.next() {
        if !is_record(line) {
            continue;
        }
        let fault = |what: String| Error::malformed(path, format!("line {}", i + 1), what);
        let mut row = image(line).map_err(fault)?;
        let points = all.next().map_or("", |(_, line)| line);
        // If the writer forgot these lines, every other image would be lost silently.
        if !is_points(points) {
            let what = "is not a list of 2D points (triples X Y POINT3D_ID): each image takes two lines, the second may \
                        be empty";
            return Err(Error::malformed(path, format!("line {}", i + 2), what));
        }
        if marks {
            row.marks = marks_of(points);
        }
        rows.push(row);
    }
    Ok(rows)
}

/// The triples that name a point.
fn marks_of(line: &str) -> Vec<Mark> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let id = |word: &str| word.trim_end_matches('0').strip_suffix('.').unwrap_or(word).parse::<u64>().ok();
    let mark = |t: &[&str]| Some((DVec2::new(t[0].parse().ok()?, t[1].parse().ok()?), id(t[2])?));
    few(words.chunks_exact(3).filter_map(mark).collect())
}

/// True for triples of two numbers and an index; the names of other images may have as many words.
fn is_points(line: &str) -> bool {
    let words: Vec<&str> = line.split_whitespace().collect();
    let number = |word: &&str| word.parse::<f64>();
    // Some writers give -1 as the largest number of 64 bits, or as a float.
    let triple =
        |t: &[&str]| t[..2].iter().all(|w| number(w).is_ok()) && number(&t[2]).is_ok_and(|id| id.fract() == 0.0);
    words.len().is_multiple_of(3) && words.chunks_exact(3).all(triple)
}

fn image(line: &str) -> Result<ImageRow, String> {
    let mut fields = Fields::new(line);
    let id = fields.value("image id")?;
    let quaternion = fields.values("quaternion")?;
    let translation = fields.values("translation")?;
    let camera_id = fields.value("camera id")?;
    let name = fields.rest.to_owned(); // to the line's end: names may hold spaces
    if name.is_empty() {
        return Err("ends before its name (field 10)".to_owned());
    }
    Ok(ImageRow { id, quaternion, translation, camera_id, name, marks: Vec::new() })
}

/// points3D.txt.
pub(super) fn points(path: &Path) -> Result<Vec<PointRow>, Error> {
    let text = files::read_text(path)?;
    let rows = lines(&text)
        .map(|(number, line)| point(line).map_err(|what| Error::malformed(path, format!("line {number}"), what)))
        .collect::<Result<Vec<_>, _>>()?;
    // Some programs write colours from 0 to 1.
    let colours = || rows.iter().flat_map(|(_, colour)| *colour);
    let shares = colours().all(|c| c <= 1.0) && colours().any(|c| c.fract() != 0.0);
    // Saturates; NaN gives 0.
    let byte = |c: f64| if shares { (255.0 * c).round() as u8 } else { c as u8 };
    Ok(rows.into_iter().map(|(row, colour)| PointRow { colour: colour.map(byte), ..row }).collect())
}

/// A point without its colour, and that.
fn point(line: &str) -> Result<(PointRow, [f64; 3]), String> {
    let mut fields = Fields::new(line);
    let id = fields.value("point id")?;
    let position = fields.values("position")?;
    let colour = fields.values("colour")?;
    let error = fields.value("error")?;
    let mut track = Vec::new();
    while !fields.rest.is_empty() {
        track.push(fields.value("track's image id")?);
        fields.value::<i64>("track's 2D point index")?;
    }
    Ok((PointRow { id, position, colour: [0; 3], error, track }, colour))
}
