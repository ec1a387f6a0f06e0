//! Variables of the environment that stand in for options of a device.

use super::error::Error;
use std::str::FromStr;

/// A variable's text, unless it is empty.
pub(super) fn text(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|text| !text.is_empty())
}

/// An option that was given, or else what a variable says.
pub(super) fn or<T: Copy + FromStr<Err = String>>(given: Option<T>, name: &'static str) -> Result<Option<T>, Error> {
    match (given, text(name)) {
        (None, Some(text)) => text.parse().map(Some).map_err(|what| Error::Variable { name, text, what }),
        (given, _) => Ok(given),
    }
}
