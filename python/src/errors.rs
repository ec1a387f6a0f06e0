//! The engine's errors as Python's exceptions, with the engine's words in Python's terms.

use crate::words::in_python;
use engine::gaussians::formats::SpzPrecision;
use engine::gpu;
use engine::job::{Error, Exit, Relief};
use engine::wording::{counted, file_size};
use pyo3::exceptions::{
    PyKeyboardInterrupt, PyMemoryError, PyOSError, PyOverflowError, PyRuntimeError, PyTypeError, PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyByteArray, PyBytes};
use std::error::Error as _;
use std::io;
use std::path::{Path, PathBuf};

pyo3::create_exception!(
    qirf_vk,
    DeviceError,
    PyRuntimeError,
    "A device that is missing, unsuitable or lost, or that computes wrong numbers."
);

/// The system's reason behind an error, if there is one.
fn system(error: &Error) -> Option<&io::Error> {
    let mut cause = error.source();
    while let Some(at) = cause {
        if let Some(io) = at.downcast_ref::<io::Error>() {
            return Some(io);
        }
        cause = at.source();
    }
    None
}

pub fn raised(error: impl Into<Error>) -> PyErr {
    let error = error.into();
    let text = in_python(&format!("{error}{}", remedy(&error)));
    match (Exit::of(&error), system(&error)) {
        (Exit::Interrupted, _) => PyKeyboardInterrupt::new_err(text),
        (Exit::Device, _) => DeviceError::new_err(text),
        (Exit::Resources, None) => PyMemoryError::new_err(text),
        (_, Some(io)) => of_system(io, path(&error), text),
        _ => PyValueError::new_err(text),
    }
}

/// Python makes a FileNotFoundError, a PermissionError ... of the system's number, and writes number and file itself.
fn of_system(io: &io::Error, path: Option<&Path>, text: String) -> PyErr {
    let Some(number) = io.raw_os_error().filter(|_| cfg!(unix)) else { return PyOSError::new_err(text) };
    let ending = format!(" (os error {number})");
    match path {
        Some(path) => PyOSError::new_err((number, io.to_string().replace(&ending, ""), path.as_os_str().to_owned())),
        None => PyOSError::new_err((number, text.replace(&ending, ""))),
    }
}

/// The file or folder that could not be read or written.
fn path(error: &Error) -> Option<&Path> {
    match error {
        Error::Read { path, .. } | Error::Write { path, .. } => Some(path),
        _ => None,
    }
}

/// The remedy of what a device has no room for.
const SMALLER: &str = ": give a smaller size or resolution, fewer Gaussians, or another device";

/// The remedy of an error whose own text names none, as the end of its sentence.
fn remedy(error: &Error) -> String {
    match error {
        Error::Unfinished(checkpoint) => {
            format!(": give resume=True to go on with it, or delete {} to begin anew", checkpoint.display())
        }
        Error::Finished(_) => ": name another output, or replace that run with overwrite=True".to_owned(),
        Error::OtherRun { .. } => ": give its own options and photos, or another output".to_owned(),
        Error::NothingHeldOut(_) => ": give eval_every=1 to score all of them".to_owned(),
        Error::NothingToTrainOn(_) => ": give a larger eval_every, or eval_every=0 to train on every photo".to_owned(),
        Error::Picture { .. } => ": give a smaller size".to_owned(),
        Error::Memory { relief: Relief::OtherDevice, .. } | Error::Buffer { relief: Relief::OtherDevice, .. } => {
            ": give another device, or a larger memory_limit if you set one: an interrupted run keeps its options"
                .to_owned()
        }
        Error::Buffer { relief: Relief::Gaussians { most, degree }, .. } => {
            let degree = degree.map_or_else(String::new, |degree| format!(", sh_degree={degree}"));
            format!(": give max_gaussians={most}{degree}, or another device")
        }
        Error::Buffer { .. } | Error::Device(gpu::Error::TooLarge { .. }) => SMALLER.to_owned(),
        Error::Memory { .. } | Error::Device(_) if Exit::of(error) == Exit::Resources => {
            format!("{SMALLER}, or a larger memory_limit if you set one")
        }
        _ => String::new(),
    }
}

/// The path of a file or folder, as text or bytes, without NUL, which Python's `open` refuses too.
pub fn file(object: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
    let path: PathBuf = object.py().import("os")?.call_method1("fsdecode", (object,))?.extract()?;
    if path.as_os_str().as_encoded_bytes().contains(&0) {
        return Err(wrong(format!("{:?}: embedded null byte", path.to_string_lossy())));
    }
    Ok(path)
}

/// As [`file`], or None.
pub fn some_file(object: &Bound<'_, PyAny>) -> PyResult<Option<PathBuf>> {
    if object.is_none() { Ok(None) } else { file(object).map(Some) }
}

pub fn share(keep: f64) -> PyResult<f64> {
    if keep > 0.0 && keep <= 1.0 {
        return Ok(keep);
    }
    Err(wrong(format!("keep={keep}: give a share above 0 and up to 1")))
}

/// The argument `keep`, or None.
pub fn some_keep(object: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
    object.extract::<Option<f64>>().map_err(|e| named("keep", e, object.py()))
}

/// A whole number of any size; what 64 bits cannot hold becomes the nearest that they can.
pub fn whole(object: &Bound<'_, PyAny>) -> PyResult<i64> {
    match object.extract::<i64>() {
        Err(e) if e.is_instance_of::<PyOverflowError>(object.py()) => {
            Ok(if object.lt(0)? { i64::MIN } else { i64::MAX })
        }
        read => read,
    }
}

/// As [`whole`], or None.
pub fn some_whole(object: &Bound<'_, PyAny>) -> PyResult<Option<i64>> {
    if object.is_none() { Ok(None) } else { whole(object).map(Some) }
}

/// True for what [`whole`] makes of numbers beyond 64 bits: nobody gave that number.
fn clamped(value: i64) -> bool {
    [i64::MIN, i64::MAX].contains(&value)
}

/// An argument with the value that was given, as far as 64 bits hold it.
pub fn given(name: &str, value: i64) -> String {
    if clamped(value) { name.to_owned() } else { format!("{name}={value}") }
}

/// A width and a height in pixels.
fn pixels(name: &str, object: &Bound<'_, PyAny>) -> PyResult<(u32, u32)> {
    let with_name = |e: PyErr| named(name, e, object.py());
    let sides = object.try_iter().map_err(with_name)?;
    let sides = sides.map(|side| whole(&side?)).collect::<PyResult<Vec<i64>>>().map_err(with_name)?;
    let [width, height] = sides[..] else {
        return Err(wrong(format!("{name} has {}: give a width and a height", counted(sides.len(), "number"))));
    };
    let side = |pixels: i64| u32::try_from(pixels).ok().filter(|pixels| (1..=65_536).contains(pixels));
    let both = side(width).zip(side(height));
    both.ok_or_else(|| {
        let shown = if clamped(width) || clamped(height) { String::new() } else { format!("=({width}, {height})") };
        wrong(format!("{name}{shown}: give 1 to 65,536 pixels each"))
    })
}

/// The argument `size`, in pixels.
pub fn size(object: &Bound<'_, PyAny>) -> PyResult<(u32, u32)> {
    pixels("size", object)
}

/// The argument `size`, or None.
pub fn some_size(object: &Bound<'_, PyAny>) -> PyResult<Option<(u32, u32)>> {
    if object.is_none() { Ok(None) } else { size(object).map(Some) }
}

/// The argument `picture_size`, or None.
pub fn some_picture_size(object: &Bound<'_, PyAny>) -> PyResult<Option<(u32, u32)>> {
    if object.is_none() { Ok(None) } else { pixels("picture_size", object).map(Some) }
}

/// A number of views or cameras, at least `least`.
pub fn views<T: TryFrom<i64>>(name: &str, value: i64, least: i64) -> PyResult<T> {
    if value > 100_000 {
        return Err(wrong(format!("{}: give at most 100,000", given(name, value))));
    }
    number(name, value, least)
}

/// A size of a file in bytes: a whole number, or a text with a unit such as "5MB", "800kB", "4.5MiB" or "1165B"; or None.
pub fn some_bytes(object: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
    let Ok(text) = object.extract::<String>() else {
        return some_whole(object)?.map(|size| number("size", size, 1)).transpose();
    };
    let form = "give a number of bytes, or a text such as \"5MB\", \"800kB\" or \"4.5MiB\"";
    file_size(&text).map(Some).map_err(|_| wrong(format!("size={text:?}: {form}")))
}

/// The argument `sh_bits`: one number for all bands of an SPZ, or that of band 1 and that of the others; or None.
pub fn some_sh_bits(object: &Bound<'_, PyAny>) -> PyResult<Option<SpzPrecision>> {
    if object.is_none() {
        return Ok(None);
    }
    let is_bool = |item: &Bound<'_, PyAny>| item.is_instance_of::<PyBool>();
    let holds_bool =
        || object.try_iter().is_ok_and(|mut items| items.any(|item| item.is_ok_and(|item| is_bool(&item))));
    let is_bytes = object.is_instance_of::<PyBytes>() || object.is_instance_of::<PyByteArray>();
    let is_refused = is_bytes || is_bool(object) || holds_bool();
    let both = object.extract::<u8>().map(|bits| [bits; 2]).or_else(|_| object.extract::<[u8; 2]>());
    let within = both.ok().filter(|both| !is_refused && both.iter().all(|bits| (1..=8).contains(bits)));
    let Some([first, others]) = within else {
        return Err(wrong(format!("sh_bits={object}: give 1 to 8, or two of these, such as (6, 5)")));
    };
    Ok(Some(SpzPrecision { first, others, means: None }))
}

/// Warns, at the line of Python that called.
pub fn warn(py: Python<'_>, what: &str) -> PyResult<()> {
    let category = py.get_type::<pyo3::exceptions::PyUserWarning>();
    PyErr::warn(py, &category, &std::ffi::CString::new(what)?, 1)
}

/// A number of things that has to be at least `least`.
pub fn number<T: TryFrom<i64>>(name: &str, value: i64, least: i64) -> PyResult<T> {
    if value < least {
        return Err(wrong(format!("{}: give {least} or more", given(name, value))));
    }
    T::try_from(value).map_err(|_| wrong(format!("{}: give a smaller number", given(name, value))))
}

/// A colour of red, green and blue in [0, 1].
pub fn colour(background: [f32; 3]) -> PyResult<[f32; 3]> {
    if background.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Ok(background);
    }
    let [r, g, b] = background;
    Err(wrong(format!("background=({r}, {g}, {b}): give red, green and blue from 0 to 1")))
}

/// A TypeError or ValueError with an argument's name before its text; other exceptions stay as they are.
pub fn named(name: &str, error: PyErr, py: Python<'_>) -> PyErr {
    let text = format!("{name}: {}", error.value(py));
    if error.is_instance_of::<PyTypeError>(py) {
        PyTypeError::new_err(text)
    } else if error.is_instance_of::<PyValueError>(py) {
        wrong(text)
    } else {
        error
    }
}

/// An exception for a value that makes no sense.
pub fn wrong(what: impl Into<String>) -> PyErr {
    PyValueError::new_err(what.into())
}
