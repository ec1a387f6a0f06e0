//! The arms of a comparison: ways to continue from the prune point, or to train from the beginning.

use crate::pipeline::config::{Compression, Pruning, RunConfig};
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use crate::train::growth::Growth;
use crate::train::learnt_masks::{LearntMasks, Method};
use crate::train::relocation::Relocation;
use crate::train::schedule::Schedule;
use crate::wording::unknown;

/// Removes `suffix` from the end of `text`. Returns what is left, and whether the suffix was there.
fn without<'a>(text: &'a str, suffix: &str) -> (&'a str, bool) {
    text.strip_suffix(suffix).map_or((text, false), |rest| (rest, true))
}

/// Shares of the run at which an arm prunes that does so in two steps, as `RadSplat` does.
pub const TWICE: [f64; 2] = [16.0 / 30.0, 24.0 / 30.0];

/// Methods by name: their arm in full, and the shares of the run at which they prune in two steps.
const METHODS: [(&str, &str, [f64; 2]); 2] = [
    // Natural selection: pressure on opacities, the rest cut by opacity.
    ("gns", "opacity:global-detail+attrition", TWICE),
    // GaussianPOP: what the pictures change if one Gaussian goes, in two cuts.
    ("pop", "change:global-detail+twice", [15.0 / 30.0, 20.0 / 30.0]),
];

/// Names of arms that are no selectors' names.
const OWN_NAMES: [&str; 10] =
    ["default", "paper", "gns", "pop", "dense", "dense+thresholds", "grown", "mcmc", "compact3dgs", "maskgaussian"];

/// How an arm's model grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Grown {
    /// With the other arms: it continues from their checkpoint at the prune point.
    Together,
    /// By the thresholds of the 3DGS reference, from the beginning.
    ByThresholds,
    /// From the beginning to the number that would be kept of the other arms' Gaussians; it is not pruned.
    To(Keep),
    /// From the beginning to that number by relocation, as in 3DGS-MCMC; it is not pruned.
    Relocating(Keep),
    /// From the beginning as the other arms, with learnt masks that leave that number; it is not pruned otherwise.
    Masked(Method, Keep),
}

/// One way to reach a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Its name, as given on the command line.
    pub name: String,
    /// Its choice of Gaussians; none if it is not pruned.
    pub compression: Option<Compression>,
    /// True if attrition goes before it.
    pub attrition: bool,
    /// True if rates are re-warmed after it.
    pub rewarm: bool,
    /// Shares of the run at which it prunes, if it does so in two steps.
    pub twice: Option<[f64; 2]>,
    /// How its model grows.
    pub grown: Grown,
}

impl Arm {
    /// Reads `dense`, `grown`, `mcmc`, `compact3dgs`, `maskgaussian`, `default`, `paper`, `gns`, `pop`, or a selector's name followed by any of `:BUDGET`, `+merge`, `-detail`,
    /// `+attrition`, `+twice`, `+rewarm`, `+thresholds` and `@SHARE`. A selector alone prunes without attrition, divides its count per
    /// block and does not merge. `given` is the meaning of `default`, and gives every arm its share, its detail and its blocks.
    ///
    /// # Errors
    /// A sentence that names the fault.
    pub fn parse(text: &str, given: &Pruning) -> Result<Self, String> {
        if let Some(arm) = Self::method(text, given) {
            return arm;
        }
        let process = given;
        let given = &process.compression;
        let (rest, keep) = match text.split_once('@') {
            None => (text, given.keep),
            Some((rest, share)) => {
                let share = share.parse::<f64>().ok().filter(|s| *s > 0.0 && *s <= 1.0);
                (rest, Keep::Share(share.ok_or_else(|| format!("'{text}': write a share such as 0.2 after @"))?))
            }
        };
        let (rest, thresholds) = without(rest, "+thresholds");
        let (rest, rewarm) = without(rest, "+rewarm");
        let (rest, twice) = without(rest, "+twice");
        let (rest, attrition) = without(rest, "+attrition");
        let (rest, without_detail) = without(rest, "-detail");
        let (rest, merge) = without(rest, "+merge");
        let grown = if thresholds { Grown::ByThresholds } else { Grown::Together };
        let (selector, budget) = rest.split_once(':').map_or((rest, None), |(s, b)| (s, Some(b)));
        let named = |budget: &str| match budget {
            "per-block" => Ok(Budget::PerBlock),
            "hybrid" => Ok(Budget::Hybrid),
            "global" => Ok(Budget::Global),
            other => Err(format!("'{text}': there is no budget '{other}'; choose per-block, hybrid or global")),
        };
        // Arms that are not pruned take a share alone, where one means something.
        let grown_arm =
            |grown| Ok(Self { name: text.to_owned(), compression: None, attrition, rewarm, twice: None, grown });
        let share_alone = rest == selector && text.split('@').next() == Some(rest);
        let mut compression = match selector {
            "dense" if text == selector || text == "dense+thresholds" => return grown_arm(grown),
            "grown" if share_alone => return grown_arm(Grown::To(keep)),
            "mcmc" if share_alone => return grown_arm(Grown::Relocating(keep)),
            "compact3dgs" if share_alone => return grown_arm(Grown::Masked(Method::Compact3dgs, keep)),
            "maskgaussian" if share_alone => return grown_arm(Grown::Masked(Method::MaskGaussian, keep)),
            "dense" | "grown" | "mcmc" | "compact3dgs" | "maskgaussian" => {
                return Err(format!("'{text}': this arm is not pruned; write {selector} without the rest"));
            }
            "default" => given.clone(),
            "paper" => Compression::paper(),
            selector => Compression {
                selector: selector.parse::<Selector>().map_err(|_| {
                    let selectors = Selector::NAMES.into_iter().map(|(_, name)| name);
                    unknown(selector, "an arm", OWN_NAMES.into_iter().chain(selectors))
                })?,
                budget: Budget::PerBlock,
                merge: false,
                ..given.clone()
            },
        };
        if compression.selector == Selector::Pairs && (budget.is_some() || merge || without_detail) {
            return Err(format!(
                "'{text}': pairs merges over the whole model; it takes +attrition, +twice, +rewarm, +thresholds and @SHARE alone"
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
        let twice = twice.then_some(TWICE);
        if attrition && twice.is_some() {
            return Err(format!("'{text}': choose one of +attrition and +twice"));
        }
        let default = selector == "default";
        let attrition = attrition || default && twice.is_none() && process.attrition.is_some();
        let rewarm = rewarm || default && process.rewarm;
        Ok(Self { name: text.to_owned(), compression: Some(compression), attrition, rewarm, twice, grown })
    }

    /// Reads the name of one of the [`METHODS`], followed by any of `+rewarm`, `+thresholds` and `@SHARE`; none for another name.
    fn method(text: &str, given: &Pruning) -> Option<Result<Self, String>> {
        let (short, full, at) = METHODS.iter().find(|m| text.split(['@', '+']).next() == Some(m.0))?;
        let arm = Self::parse(&format!("{full}{}", &text[short.len()..]), given).map_err(|e| format!("'{text}': {e}"));
        Some(arm.map(|arm| Self { name: text.to_owned(), twice: arm.twice.map(|_| *at), ..arm }))
    }

    /// Its folder's name, valid on every file system.
    #[must_use]
    pub fn folder(name: &str) -> String {
        name.replace([':', '@'], "-")
    }

    /// The arm's run: the shared one's, with the arm's pruning and growth. `gaussians` is their number at the
    /// shared run's prune point.
    pub fn configuration(&self, shared: &RunConfig, gaussians: usize) -> RunConfig {
        // All arms have the loss of the fine-tuning from the same iteration on, also those that prune later or not at all.
        let fork = |pruning: &Pruning| pruning.at.first().copied();
        let prune = match (&self.compression, &shared.prune) {
            (Some(compression), Some(pruning)) => Some(Pruning {
                compression: compression.clone(),
                attrition: self.attrition.then(|| pruning.attrition.unwrap_or_default()),
                rewarm: self.rewarm,
                ..pruning.clone()
            })
            .map(|pruning| match self.twice {
                Some(at) => twice(Pruning { l2_from: fork(&pruning), ..pruning }, at, gaussians),
                None => pruning,
            }),
            (None, Some(pruning)) => Some(Pruning {
                at: Vec::new(),
                l2_from: fork(pruning),
                attrition: None,
                rewarm: false,
                ..pruning.clone()
            }),
            _ => None,
        };
        let plan = shared.schedule.growth;
        let growth = match self.grown {
            Grown::Together | Grown::Masked(..) => plan,
            Grown::ByThresholds => None,
            Grown::To(keep) | Grown::Relocating(keep) => {
                Some(Growth { gaussians: Some(keep.count(gaussians)), ..plan.unwrap_or_default() })
            }
        };
        let relocation = matches!(self.grown, Grown::Relocating(_)).then(Relocation::default);
        let learnt_masks = match self.grown {
            Grown::Masked(method, keep) => {
                Some(LearntMasks::of(method, keep.count(gaussians), shared.schedule.iterations))
            }
            _ => None,
        };
        let schedule = Schedule { growth, relocation, learnt_masks, ..shared.schedule.clone() };
        // Initial points are thinned to the largest number allowed.
        let thinned = matches!(self.grown, Grown::To(_) | Grown::Relocating(_));
        let most = growth.filter(|_| thinned).and_then(|g| g.gaussians);
        let max_gaussians = most.map_or(shared.max_gaussians, |most| most.min(shared.max_gaussians));
        RunConfig { prune, schedule, max_gaussians, checkpoint_every: 0, ..shared.clone() }
    }
}

/// The same pruning in two steps at these shares of the run, to exactly as many of `gaussians`.
fn twice(mut pruning: Pruning, at: [f64; 2], gaussians: usize) -> Pruning {
    pruning.at = at.to_vec();
    if let Keep::Share(_) = pruning.compression.keep {
        pruning.compression.keep = Keep::Count(pruning.compression.keep.count(gaussians));
    }
    pruning
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Preset;

    #[test]
    fn arms_change_the_process_of_the_shared_run() {
        let shared = RunConfig::sample(Preset::Quick).pruned(Pruning::default());
        let process = |text: &str, given: &Pruning| {
            let arm = Arm::parse(text, given).unwrap();
            let RunConfig { prune, schedule, .. } = arm.configuration(&shared, 100);
            let prune = prune.unwrap();
            (prune.at.len(), prune.attrition.is_some(), prune.rewarm, schedule.growth.map(|g| g.gaussians))
        };
        let default = Pruning::default();
        assert_eq!(process("dense", &default), (0, false, false, Some(None)));
        assert_eq!(process("css+rewarm", &default), (1, false, true, Some(None)));
        assert_eq!(process("default", &default), (1, true, true, Some(None)));
        assert_eq!(process("default", &Pruning::at_once()), (1, false, false, Some(None)));
        assert_eq!(process("default+attrition", &Pruning::at_once()), (1, true, false, Some(None)));
        assert_eq!(process("radsplat:global+twice", &default), (2, false, false, Some(None)));
        assert_eq!(process("importance+thresholds", &default), (1, false, false, None));
        assert_eq!(process("dense+thresholds", &default), (0, false, false, None));
        assert_eq!(process("grown", &default), (0, false, false, Some(Some(28))));
        assert_eq!(process("grown@0.5", &default), (0, false, false, Some(Some(50))));
        assert_eq!(process("mcmc@0.5", &default), (0, false, false, Some(Some(50))));
        assert_eq!(process("compact3dgs", &default), (0, false, false, Some(None)));
        let masked = |text: &str| Arm::parse(text, &default).unwrap().configuration(&shared, 100);
        let masks = masked("maskgaussian@0.5").schedule.learnt_masks.unwrap();
        assert_eq!((masks.method, masks.survivors, masks.until), (Method::MaskGaussian, 50, 0.75));
        assert_eq!(masked("compact3dgs").max_gaussians, shared.max_gaussians);
        let mcmc = Arm::parse("mcmc", &default).unwrap().configuration(&shared, 100);
        assert!(mcmc.schedule.relocation.is_some() && mcmc.max_gaussians == 28 && shared.schedule.relocation.is_none());
    }

    #[test]
    fn arms_by_name() {
        let given = Compression { merge: true, ..Compression::default() };
        let process = Pruning { compression: given.clone(), ..Pruning::default() };
        let arm = |text: &str| Arm::parse(text, &process).unwrap().compression;
        assert_eq!(arm("dense"), None);
        assert_eq!(arm("default"), Some(given.clone()));
        let css = arm("css").unwrap();
        assert_eq!((css.selector, css.budget, css.merge), (Selector::Css, Budget::PerBlock, false));
        let all = arm("gnso:global+merge-detail@0.1").unwrap();
        assert_eq!((all.budget, all.merge, all.detail, all.keep), (Budget::Global, true, 0.0, Keep::Share(0.1)));
        assert_eq!(arm("paper").unwrap().keep, Keep::Paper { kappa: 0.22 });
        let faded = Arm::parse("css-detail+attrition+rewarm@0.5", &process).unwrap();
        assert!(faded.attrition && faded.rewarm && faded.compression.unwrap().keep == Keep::Share(0.5));
        assert!(!Arm::parse("css+merge", &process).unwrap().attrition);
        let gns = Arm::parse("gns+rewarm@0.2", &process).unwrap();
        let by = gns.compression.unwrap();
        assert!(gns.attrition && gns.rewarm && gns.twice.is_none() && gns.name == "gns+rewarm@0.2");
        assert_eq!((by.selector, by.budget, by.detail), (Selector::Opacity, Budget::Global, 0.0));
        assert_eq!((by.keep, by.merge), (Keep::Share(0.2), false));
        let pop = Arm::parse("pop", &process).unwrap();
        assert_eq!((pop.twice, pop.compression.unwrap().selector), (Some([0.5, 2.0 / 3.0]), Selector::Change));
        assert_eq!(Arm::parse("radsplat+twice", &process).unwrap().twice, Some(TWICE));
        for wrong in [
            "gns:global",
            "gns+attrition",
            "pop+merge",
            "dense+rewarm",
            "dense@0.2",
            "grown+thresholds",
            "mcmc+rewarm",
            "mcmc:global",
            "compact3dgs+merge",
            "maskgaussian+attrition",
            "css+thresholds+rewarm",
            "css+attrition+twice",
            "dense+twice",
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
            assert!(Arm::parse(wrong, &process).is_err(), "{wrong}");
        }
    }
}
