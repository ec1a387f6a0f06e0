//! The arms of a comparison: ways to continue from the prune point.

use super::config::{Compression, Pruning, RunConfig};
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};

/// What is before `suffix`, and true if it was there.
fn flag<'a>(text: &'a str, suffix: &str) -> (&'a str, bool) {
    text.strip_suffix(suffix).map_or((text, false), |rest| (rest, true))
}

/// One way to continue from the prune point.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Its name, as given on the command line.
    pub name: String,
    /// Its choice of Gaussians; none for the dense arm.
    pub compression: Option<Compression>,
    /// True if attrition goes before it.
    pub attrition: bool,
    /// True if rates are re-warmed after it.
    pub rewarm: bool,
}

impl Arm {
    /// Reads `dense`, `default`, `paper`, or a selector's name followed by any of `:BUDGET`, `+merge`, `-detail`,
    /// `+attrition`, `+rewarm` and `@SHARE`. A selector alone divides its count per block and does not merge. `given` is the
    /// meaning of `default`, and gives every arm its share, its detail and its blocks.
    ///
    /// # Errors
    /// A sentence that names the fault.
    pub fn parse(text: &str, given: &Compression) -> Result<Self, String> {
        let name = text.to_owned();
        let (rest, keep) = match text.split_once('@') {
            None => (text, given.keep),
            Some((rest, share)) => {
                let share = share.parse::<f64>().ok().filter(|s| *s > 0.0 && *s <= 1.0);
                (rest, Keep::Share(share.ok_or_else(|| format!("'{text}': write a share such as 0.2 after @"))?))
            }
        };
        let (rest, rewarm) = flag(rest, "+rewarm");
        let (rest, attrition) = flag(rest, "+attrition");
        let (rest, without_detail) = flag(rest, "-detail");
        let (rest, merge) = flag(rest, "+merge");
        let (selector, budget) = rest.split_once(':').map_or((rest, None), |(s, b)| (s, Some(b)));
        let named = |budget: &str| match budget {
            "per-block" => Ok(Budget::PerBlock),
            "hybrid" => Ok(Budget::Hybrid),
            "global" => Ok(Budget::Global),
            other => Err(format!("'{text}': there is no budget '{other}'; choose per-block, hybrid or global")),
        };
        let mut compression = match selector {
            "dense" if text == selector => return Ok(Self { name, compression: None, attrition, rewarm }),
            "dense" => return Err(format!("'{text}': the dense arm is not pruned; write dense alone")),
            "default" => given.clone(),
            "paper" => Compression::paper(),
            selector => Compression {
                selector: selector.parse::<Selector>().map_err(|e| format!("{e}, or default, paper or dense"))?,
                budget: Budget::PerBlock,
                merge: false,
                ..given.clone()
            },
        };
        if compression.selector == Selector::Pairs && (budget.is_some() || merge || without_detail) {
            return Err(format!(
                "'{text}': pairs merges over the whole model; it takes +attrition, +rewarm and @SHARE alone"
            ));
        }
        if selector != "paper" || keep != given.keep {
            compression.keep = keep;
        }
        if let Some(budget) = budget {
            compression.budget = named(budget)?;
        }
        compression.merge |= merge;
        if without_detail {
            compression.detail = 0.0;
        }
        Ok(Self { name, compression: Some(compression), attrition, rewarm })
    }

    /// Its folder's name, valid on every file system.
    #[must_use]
    pub fn folder(name: &str) -> String {
        name.replace([':', '@'], "-")
    }

    /// The arm's run: the shared one's, with the arm's pruning.
    pub fn configuration(&self, shared: &RunConfig) -> RunConfig {
        let prune = match (&self.compression, &shared.prune) {
            (Some(compression), Some(pruning)) => Some(Pruning {
                compression: compression.clone(),
                attrition: self.attrition.then(|| pruning.attrition.unwrap_or_default()).or(pruning.attrition),
                rewarm: self.rewarm || pruning.rewarm,
                ..pruning.clone()
            }),
            (None, Some(pruning)) => Some(Pruning { at: Vec::new(), ..pruning.clone() }),
            _ => None,
        };
        RunConfig { prune, checkpoint_every: 0, ..shared.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Preset;
    use crate::train::attrition::Attrition;

    #[test]
    fn arms_change_the_process_of_the_shared_run() {
        let shared = RunConfig::sample(Preset::Quick).pruned(Pruning::default());
        let process = |text: &str| {
            let arm = Arm::parse(text, &Compression::default()).unwrap();
            let prune = arm.configuration(&shared).prune.unwrap();
            (prune.at.len(), prune.attrition, prune.rewarm)
        };
        assert_eq!(process("dense"), (0, None, false));
        assert_eq!(process("css+rewarm"), (1, None, true));
        assert_eq!(process("default+attrition"), (1, Some(Attrition::default()), false));
    }

    #[test]
    fn arms_by_name() {
        let given = Compression { merge: true, ..Compression::default() };
        let arm = |text: &str| Arm::parse(text, &given).unwrap().compression;
        assert_eq!(arm("dense"), None);
        assert_eq!(arm("default"), Some(given.clone()));
        let css = arm("css").unwrap();
        assert_eq!((css.selector, css.budget, css.merge), (Selector::Css, Budget::PerBlock, false));
        let all = arm("gnso:global+merge-detail@0.1").unwrap();
        assert_eq!((all.budget, all.merge, all.detail, all.keep), (Budget::Global, true, 0.0, Keep::Share(0.1)));
        assert_eq!(arm("paper").unwrap().keep, Keep::Paper { kappa: 0.22 });
        let faded = Arm::parse("css-detail+attrition+rewarm@0.5", &given).unwrap();
        assert!(faded.attrition && faded.rewarm && faded.compression.unwrap().keep == Keep::Share(0.5));
        assert!(!Arm::parse("css+merge", &given).unwrap().attrition);
        for wrong in [
            "dense+rewarm",
            "dense@0.2",
            "css+rewarm+attrition",
            "",
            "nothing",
            "css:half",
            "css@2",
            "css@",
            "../up",
            "pairs:global",
            "pairs+merge",
        ] {
            assert!(Arm::parse(wrong, &given).is_err(), "{wrong}");
        }
    }
}
