//! A method of another paper, as `config.toml` names it. The methods themselves are above this floor: the caller of a job
//! passes their constructors.

use crate::gpu::Device;
use crate::job::Error;
use crate::train::method::Method;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A method by name, with its settings: the table `[method]` of `config.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodConfig {
    /// Its name.
    pub name: String,
    /// Its settings, which the method reads.
    #[serde(flatten)]
    pub settings: toml::Table,
}

/// Makes the method that a configuration names.
pub type Methods = fn(&MethodConfig, &Device) -> Result<Arc<dyn Method>, Error>;

/// For jobs that know no methods: refuses every name.
pub fn no_methods(config: &MethodConfig, _: &Device) -> Result<Arc<dyn Method>, Error> {
    Err(Error::Usage(format!("config.toml: [method] names '{}', and this program has no methods", config.name)))
}

impl MethodConfig {
    /// A method with these settings.
    ///
    /// # Panics
    /// If the settings are no table of what TOML can hold.
    pub fn new(name: &str, settings: &impl Serialize) -> Self {
        let settings = toml::Table::try_from(settings).expect("settings are a table of plain values");
        Self { name: name.to_owned(), settings }
    }

    /// The settings as a method's own type.
    ///
    /// # Errors
    /// A sentence that names the setting that is wrong.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, String> {
        self.settings.clone().try_into().map_err(|e: toml::de::Error| format!("method: {}", e.message()))
    }
}
