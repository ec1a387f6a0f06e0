//! Methods of other papers that change how a model is trained, each an implementation of [`Method`]: the training loop
//! knows none of them. `compare` has an arm for each, and `run --config` repeats such an arm.

pub mod learnt_mask;
pub mod mcmc;

use crate::gpu::Device;
use crate::job::Error;
use crate::job::config::MethodConfig;
use crate::train::method::Method;
use crate::wording::unknown;
use learnt_mask::{LearntMask, LearntMasks};
use mcmc::Mcmc;
use std::fmt::Display;
use std::sync::Arc;

/// Reads a method's settings, and creates the method.
type Make = fn(&MethodConfig, &Device) -> Result<Arc<dyn Method>, Error>;

/// All methods, by their names in `config.toml`.
const METHODS: [(&str, Make); 2] = [
    (mcmc::NAME, |config, _| Ok(Arc::new(Mcmc::read(config).map_err(wrong)?))),
    (learnt_mask::NAME, |config, device| {
        let settings = LearntMasks::read(config).map_err(wrong)?;
        Ok(Arc::new(LearntMask::new(device, settings)?))
    }),
];

fn wrong(what: impl Display) -> Error {
    Error::Usage(format!("config.toml: {what}"))
}

/// Creates the method that a configuration names, for [`Session::methods`](crate::job::Session::methods).
///
/// # Errors
/// [`Error::Usage`] for an unknown name or a wrong setting; device memory.
pub fn make(config: &MethodConfig, device: &Device) -> Result<Arc<dyn Method>, Error> {
    let known = METHODS.iter().find(|(name, _)| *name == config.name);
    let (_, make) = known.ok_or_else(|| wrong(unknown(&config.name, "a method", METHODS.map(|(name, _)| name))))?;
    make(config, device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use learnt_mask::MaskMethod;

    #[test]
    fn settings_come_back_and_what_no_run_can_mean_is_refused_by_name() {
        let mcmc = Mcmc { noise: 0.1, ..Mcmc::default() };
        assert_eq!(Mcmc::read(&mcmc.config()), Ok(mcmc));
        let masks = LearntMasks::of(MaskMethod::MaskGaussian, 9, 100);
        assert_eq!(LearntMasks::read(&masks.config()), Ok(masks));
        let shaken = Mcmc { noise: f64::NAN, ..mcmc }.config();
        assert!(Mcmc::read(&shaken).unwrap_err().starts_with("method.noise = NaN: write a number from 0"));
        let late = LearntMasks { until: 1.5, ..masks }.config();
        assert!(LearntMasks::read(&late).unwrap_err().starts_with("method.until = 1.5: write"));
        let misspelt = MethodConfig::new(mcmc::NAME, &toml::toml! { noize = 1.0 });
        assert!(Mcmc::read(&misspelt).unwrap_err().contains("noize"));
    }
}
