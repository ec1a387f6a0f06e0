//! NumPy's arrays: views of Rust's memory, and arrays from Python.

use numpy::ndarray::{ArrayView, Dimension};
use numpy::{Element, PyArray, PyArrayDescrMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyFloat, PyList, PyTuple};
use serde::Serialize;

use crate::errors::{named, wrong};
use engine::scene::Resize;

/// A read-only array over `view`, which keeps `owner` alive.
///
/// # Safety
/// The memory of `view` belongs to `owner`, and neither moves nor changes while `owner` lives.
#[allow(unsafe_code)]
pub unsafe fn borrowed<'py, D: Dimension>(
    view: ArrayView<'_, f32, D>,
    owner: Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray<f32, D>>> {
    // SAFETY: the caller vouches for the memory; the array is made read-only before anyone else sees it.
    let array = unsafe { PyArray::borrow_from_array(&view, owner) };
    array.call_method("setflags", (), Some(&[("write", false)].into_py_dict(array.py())?))?;
    Ok(array)
}

/// Most axes of an argument, bands of spherical harmonics in a list among them.
const AXES: usize = 4;

/// Refuses masked entries of a masked array, or of masked arrays in lists: NumPy's conversions leave out the mask.
pub fn unmasked(object: &Bound<'_, PyAny>, name: &str) -> PyResult<()> {
    let class = object.py().import("numpy.ma")?.getattr("MaskedArray")?;
    if is_masked(object, &class, AXES)? {
        return Err(wrong(format!("{name} is masked: fill it, or leave out what is masked")));
    }
    Ok(())
}

/// True if a masked array, or one within lists and tuples of this depth, has a masked entry.
fn is_masked(object: &Bound<'_, PyAny>, class: &Bound<'_, PyAny>, depth: usize) -> PyResult<bool> {
    if object.is_instance(class)? {
        return object.py().import("numpy.ma")?.call_method1("is_masked", (object,))?.is_truthy();
    }
    if depth == 0 || !(object.is_instance_of::<PyList>() || object.is_instance_of::<PyTuple>()) {
        return Ok(false);
    }
    for item in object.try_iter()? {
        let item = item?;
        if !item.is_exact_instance_of::<PyFloat>() && is_masked(&item, class, depth - 1)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// How many numbers of an array are infinite.
fn infinite(array: &Bound<'_, PyAny>) -> PyResult<usize> {
    array.py().import("numpy")?.call_method1("isinf", (array,))?.call_method0("sum")?.extract()
}

/// Real numbers of anything that NumPy makes an array of, row by row, with their shape.
fn numbers<T: Element + Clone>(object: &Bound<'_, PyAny>, name: &str) -> PyResult<(Vec<usize>, Vec<T>)> {
    let py = object.py();
    if object.is_none() {
        return Err(PyTypeError::new_err(format!("{name} is None: give an array")));
    }
    unmasked(object, name)?;
    let numpy = py.import("numpy")?;
    let given = numpy.call_method1("asarray", (object,)).map_err(|e| named(name, e, py))?;
    let kind = given.cast::<PyUntypedArray>()?.dtype().kind();
    if kind == b'c' {
        return Err(PyTypeError::new_err(format!("{name} has complex numbers: give real ones")));
    }
    let dtype = T::get_dtype(py);
    // ascontiguousarray would make an array of one of a number.
    let order = [("order", "C")].into_py_dict(py)?;
    // Infinities are looked for below.
    let quiet = numpy.call_method("errstate", (), Some(&[("over", "ignore")].into_py_dict(py)?))?;
    quiet.call_method0("__enter__")?;
    let array = numpy.call_method("asarray", (&given, &dtype), Some(&order));
    quiet.call_method1("__exit__", (py.None(), py.None(), py.None()))?;
    let array = array.map_err(|e| named(name, e, py))?;
    if kind == b'f' && infinite(&given)? != infinite(&array)? {
        return Err(wrong(format!("{name} has numbers that are too large for {dtype}")));
    }
    let array: PyReadonlyArrayDyn<'_, T> = array.extract()?;
    Ok((array.shape().to_vec(), array.as_slice()?.to_vec()))
}

/// Real numbers in float32, row by row, with their shape.
pub fn floats(object: &Bound<'_, PyAny>, name: &str) -> PyResult<(Vec<usize>, Vec<f32>)> {
    numbers(object, name)
}

/// A shape as Python writes it.
pub fn tuple(shape: &[usize]) -> String {
    let numbers: Vec<String> = shape.iter().map(ToString::to_string).collect();
    format!("({}{})", numbers.join(", "), if shape.len() == 1 { "," } else { "" })
}

pub fn rows<const N: usize>(object: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f32; N]>> {
    match floats(object, name)? {
        (shape, numbers) if shape.len() == 2 && shape[1] == N => Ok(numbers.as_chunks().0.to_vec()),
        (shape, _) => Err(wrong(format!("{name} has the shape {}, and should have (n, {N})", tuple(&shape)))),
    }
}

/// A float64 matrix of R x C numbers.
pub fn matrix<const R: usize, const C: usize>(object: &Bound<'_, PyAny>, name: &str) -> PyResult<[[f64; C]; R]> {
    let (shape, numbers) = numbers::<f64>(object, name)?;
    if shape != [R, C] {
        return Err(wrong(format!("{name} has the shape {}, and should have ({R}, {C})", tuple(&shape))));
    }
    Ok(std::array::from_fn(|r| std::array::from_fn(|c| numbers[r * C + c])))
}

/// A map of places, (3, 4) or (4, 4), as four rows; the last is 0, 0, 0, 1 where it is left out.
pub fn four_rows(object: &Bound<'_, PyAny>, name: &str) -> PyResult<[[f64; 4]; 4]> {
    let (shape, numbers) = numbers::<f64>(object, name)?;
    if shape != [3, 4] && shape != [4, 4] {
        return Err(wrong(format!("{name} has the shape {}, and should have (3, 4) or (4, 4)", tuple(&shape))));
    }
    let mut rows = [[0.0, 0.0, 0.0, 1.0]; 4];
    for (row, given) in rows.iter_mut().zip(numbers.as_chunks::<4>().0) {
        *row = *given;
    }
    Ok(rows)
}

/// Three numbers: a place or a direction.
fn three(object: &Bound<'_, PyAny>, name: &str) -> PyResult<[f64; 3]> {
    object.extract::<[f64; 3]>().map_err(|e| named(name, e, object.py()))
}

/// Functions that read an argument of three numbers; each has the argument's name, for its errors.
macro_rules! vectors {
    ($($name:ident),*) => {
        $(pub fn $name(object: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
            super::three(object, stringify!($name))
        })*
    };
}

/// Arguments of three numbers.
pub mod vector {
    use pyo3::prelude::*;
    vectors!(axis, centre, eye, high, low, offset, origin, target, up);
}

/// A record as Python's dictionaries and lists.
pub fn dictionary<'py>(py: Python<'py>, record: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    loads(py, &serde_json::to_string(record).map_err(|e| wrong(e.to_string()))?)
}

/// JSON as Python's dictionaries and lists.
pub fn loads<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (text,))
}

/// A size of photos: a width in pixels as a number, or a text such as "640" or "/2".
pub struct Resolution(pub String);

impl Resolution {
    /// The size of this text; `given` is the argument as Python shows it.
    pub fn of(text: String, given: &str) -> PyResult<Self> {
        if text.parse::<Resize>().is_err() {
            let form = "give a width in pixels, such as 800, or a divisor, such as \"/4\"";
            return Err(wrong(format!("resolution={given}: {form}")));
        }
        Ok(Self(text))
    }
}

impl<'py> FromPyObject<'_, 'py> for Resolution {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        Self::of(object.str()?.extract()?, &object.repr()?.extract::<String>()?)
    }
}

/// What to give in place of a value that JSON has no form of.
fn unwritten(error: &PyErr, py: Python<'_>) -> String {
    if error.is_instance_of::<PyTypeError>(py) {
        return "give a number, a text, a path, a list or a dict".to_owned();
    }
    let text = error.value(py).to_string();
    let finite = error.is_instance_of::<PyValueError>(py) && text.starts_with("Out of range float");
    if finite { "give finite numbers".to_owned() } else { text }
}

/// Keyword arguments as JSON.
pub fn json(options: &Bound<'_, PyDict>) -> PyResult<serde_json::Map<String, serde_json::Value>> {
    // Paths, and NumPy's numbers and arrays, are written as text, numbers and lists.
    let py = options.py();
    let code = c"lambda value: __import__('json').dumps(value, default=lambda x: x.tolist() if hasattr(x, 'tolist') else __import__('os').fsdecode(x), allow_nan=False)";
    let dumps = py.eval(code, None, None)?;
    let one = |(name, value): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let text = dumps.call1((&value,)).map_err(|e| wrong(format!("{name}={value}: {}", unwritten(&e, py))))?;
        let value = serde_json::from_str::<serde_json::Value>(&text.extract::<String>()?);
        let value = value.map_err(|e| wrong(format!("{name}: {e}")))?;
        if value.as_str().is_some_and(|text| text.contains('\0')) {
            return Err(wrong(format!("{name}={value}: embedded null byte")));
        }
        Ok((name.extract()?, value))
    };
    options.iter().map(one).collect()
}
