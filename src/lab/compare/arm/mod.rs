//! The arms of a comparison: ways to continue from the prune point, or to train from the beginning.

mod suffix;

use crate::job::RunConfig;
use crate::job::config::{PruneRule, Pruning};
use crate::lab::methods::learnt_mask::{LearntMasks, MaskMethod};
use crate::lab::methods::mcmc::Mcmc;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use crate::wording::unknown;
use suffix::{Suffix, Suffixes};

/// Shares of the run at which an arm with two prunes makes them, as in `RadSplat`.
pub const TWICE: [f64; 2] = [16.0 / 30.0, 24.0 / 30.0];

/// The meaning of an arm with a name of its own.
#[derive(Clone, Copy)]
enum Base {
    /// The pruning that was given to the comparison.
    Given,
    /// The pruning of the QIRF paper.
    Paper,
    /// Another arm in full, and the shares of the run for its prunes if there are two.
    Other(&'static str, [f64; 2]),
    /// Not pruned; it grows only to the number that the other arms keep.
    NotPruned(fn(Keep) -> Grown),
}

/// An arm with a name of its own instead of a selector's.
struct Named {
    name: &'static str,
    about: &'static str,
    base: Base,
    /// The suffixes that it takes; `None` for all.
    takes: Option<&'static [Suffix]>,
}

const PROCESS: &[Suffix] = &[Suffix::Rewarm, Suffix::Thresholds, Suffix::Share];
/// Pairs are merged over the whole model: without budget or detail safeguard.
const PAIRS: &[Suffix] = &[Suffix::Attrition, Suffix::Twice, Suffix::Rewarm, Suffix::Thresholds, Suffix::Share];

const NAMED: [Named; 9] = [
    Named { name: "default", about: "the pruning that the other options describe", base: Base::Given, takes: None },
    Named { name: "paper", about: "the pruning of the QIRF paper", base: Base::Paper, takes: None },
    // Natural selection: pressure on opacities, the rest cut by opacity.
    Named {
        name: "gns",
        about: "opacity:global-detail+attrition",
        base: Base::Other("opacity:global-detail+attrition", TWICE),
        takes: Some(PROCESS),
    },
    // GaussianPOP: the change of the pictures if one Gaussian is removed, in two cuts.
    Named {
        name: "pop",
        about: "change:global-detail in two cuts",
        base: Base::Other("change:global-detail+twice", [15.0 / 30.0, 20.0 / 30.0]),
        takes: Some(PROCESS),
    },
    Named {
        name: "dense",
        about: "not pruned; dense+thresholds grows as the 3DGS reference does",
        base: Base::NotPruned(|_| Grown::Together),
        takes: Some(&[Suffix::Thresholds]),
    },
    Named {
        name: "grown",
        about: "not pruned, grown only to the number that the others keep",
        base: Base::NotPruned(Grown::To),
        takes: Some(&[Suffix::Share]),
    },
    Named {
        name: "mcmc",
        about: "the same, grown by relocation as in 3DGS-MCMC",
        base: Base::NotPruned(Grown::Relocating),
        takes: Some(&[Suffix::Share]),
    },
    Named {
        name: "compact3dgs",
        about: "trained from the beginning with learnt masks, by a threshold",
        base: Base::NotPruned(|keep| Grown::Masked(MaskMethod::Compact3dgs, keep)),
        takes: Some(&[Suffix::Share]),
    },
    Named {
        name: "maskgaussian",
        about: "the same, with randomly drawn masks",
        base: Base::NotPruned(|keep| Grown::Masked(MaskMethod::MaskGaussian, keep)),
        takes: Some(&[Suffix::Share]),
    },
];

/// The possible arms, for help: suffixes, then the arms with names of their own.
pub fn help() -> String {
    let mut text = format!(
        "An arm is a selector's name, followed by any of {}, in any order; +twice prunes at 16/30 and 24/30 of the run. Other arms \
         are:",
        Suffix::list(None)
    );
    for Named { name, about, .. } in NAMED {
        text += &format!("\n  {name:<13} {about}");
    }
    text
}

/// Growth of an arm's model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Grown {
    /// Shared with the other arms: it continues from their checkpoint at the prune point.
    Together,
    /// By the thresholds of the 3DGS reference, from the beginning.
    ByThresholds,
    /// From the beginning to the number that would be kept of the other arms' Gaussians; not pruned.
    To(Keep),
    /// From the beginning to that number by relocation, as in 3DGS-MCMC; not pruned.
    Relocating(Keep),
    /// From the beginning like the other arms, with learnt masks that leave that number; not pruned otherwise.
    Masked(MaskMethod, Keep),
}

/// One way to obtain a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Its name, as given on the command line.
    pub name: String,
    /// Its choice of Gaussians; `None` if it is not pruned.
    pub compression: Option<PruneRule>,
    /// True if attrition precedes the prune.
    pub attrition: bool,
    /// True if rates are re-warmed after the prune.
    pub rewarm: bool,
    /// Shares of the run for its prunes, if there are two.
    pub twice: Option<[f64; 2]>,
    /// Growth of its model.
    pub grown: Grown,
}

impl Arm {
    /// Reads the name of a selector, or of one of the arms that [`help`] lists, with suffixes. A selector alone prunes
    /// without attrition, divides its count per block and does not merge. `given` is the meaning of `default`, and
    /// gives every arm its share, detail and blocks.
    pub fn parse(text: &str, given: &Pruning) -> Result<Self, String> {
        let (name, suffixes) = Suffixes::split(text)?;
        let named = NAMED.into_iter().find(|row| row.name == name);
        let takes = match &named {
            Some(row) => row.takes,
            None if name == Selector::Pairs.name() => Some(PAIRS),
            None => None,
        };
        if takes.is_some_and(|takes| suffixes.given.iter().any(|suffix| !takes.contains(suffix))) {
            return Err(format!("'{text}': {name} takes only {}", Suffix::list(takes)));
        }
        let keep = suffixes.share.map_or(given.compression.keep, Keep::Share);
        let mut arm = match named.map(|row| row.base) {
            Some(Base::NotPruned(grown)) => Self::not_pruned(grown(keep)),
            Some(Base::Other(full, at)) => {
                let arm = Self::parse(full, given)?;
                Self { twice: arm.twice.map(|_| at), ..arm }
            }
            Some(Base::Given) => {
                let (attrition, rewarm) = (given.attrition.is_some() && !suffixes.has(Suffix::Twice), given.rewarm);
                Self { attrition, rewarm, ..Self::pruned(given.compression.clone()) }
            }
            Some(Base::Paper) => Self::pruned(PruneRule::paper()),
            None => {
                let selector = name.parse::<Selector>().map_err(|_| {
                    unknown(
                        name,
                        "an arm",
                        NAMED.map(|row| row.name).into_iter().chain(Selector::ALL.map(Selector::name)),
                    )
                })?;
                let given = given.compression.clone();
                Self::pruned(PruneRule { selector, budget: Budget::PerBlock, merge: false, ..given })
            }
        };
        arm.take(&suffixes);
        if arm.attrition && arm.twice.is_some() {
            return Err(format!("'{text}': choose one of +attrition and +twice"));
        }
        Ok(Self { name: text.to_owned(), ..arm })
    }

    fn not_pruned(grown: Grown) -> Self {
        Self { name: String::new(), compression: None, attrition: false, rewarm: false, twice: None, grown }
    }

    fn pruned(compression: PruneRule) -> Self {
        Self { compression: Some(compression), ..Self::not_pruned(Grown::Together) }
    }

    fn take(&mut self, suffixes: &Suffixes) {
        if let Some(compression) = &mut self.compression {
            if let Some(share) = suffixes.share {
                compression.keep = Keep::Share(share);
            }
            if let Some(budget) = suffixes.budget {
                compression.budget = budget;
            }
            if suffixes.has(Suffix::WithoutDetail) {
                compression.detail = 0.0;
            }
            compression.merge |= suffixes.has(Suffix::Merge);
        }
        self.attrition |= suffixes.has(Suffix::Attrition);
        self.rewarm |= suffixes.has(Suffix::Rewarm);
        if suffixes.has(Suffix::Twice) {
            self.twice = Some(TWICE);
        }
        if suffixes.has(Suffix::Thresholds) {
            self.grown = Grown::ByThresholds;
        }
    }

    /// The name of its folder, valid on every file system.
    #[must_use]
    pub fn folder(name: &str) -> String {
        name.replace([':', '@'], "-")
    }

    /// The arm's run: the shared run with the arm's pruning and growth. `gaussians` is their number at the shared run's
    /// prune point.
    pub fn configuration(&self, shared: &RunConfig, gaussians: usize) -> RunConfig {
        // All arms switch to the loss of the fine-tuning at the same iteration, even those that prune later or not at
        // all.
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
        let method = match self.grown {
            Grown::Relocating(_) => Some(Mcmc::default().config()),
            Grown::Masked(method, keep) => {
                Some(LearntMasks::of(method, keep.count(gaussians), shared.schedule.iterations).config())
            }
            _ => shared.method.clone(),
        };
        let schedule = Schedule { growth, ..shared.schedule.clone() };
        // Initial points are thinned to the largest number allowed.
        let thinned = matches!(self.grown, Grown::To(_) | Grown::Relocating(_));
        let most = growth.filter(|_| thinned).and_then(|g| g.gaussians);
        let max_gaussians = most.map_or(shared.max_gaussians, |most| most.min(shared.max_gaussians));
        RunConfig { prune, schedule, method, max_gaussians, checkpoint_every: 0, ..shared.clone() }
    }
}

/// The same pruning in two steps at these shares of the run, with the same final count of `gaussians`.
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
    use crate::job::Preset;

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
        let masks = LearntMasks::read(&masked("maskgaussian@0.5").method.unwrap()).unwrap();
        assert_eq!((masks.method, masks.survivors, masks.until), (MaskMethod::MaskGaussian, 50, 0.75));
        assert_eq!(masked("compact3dgs").max_gaussians, shared.max_gaussians);
        let mcmc = Arm::parse("mcmc", &default).unwrap().configuration(&shared, 100);
        assert!(mcmc.method == Some(Mcmc::default().config()) && mcmc.max_gaussians == 28 && shared.method.is_none());
    }

    #[test]
    fn arms_by_name() {
        let given = PruneRule { merge: true, ..PruneRule::default() };
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
            "css+attrition+twice",
            "css+merge:global+merge",
            "css@0.2@0.2",
            "css+speed",
            "dense+twice",
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

    /// The order of suffixes does not matter.
    #[test]
    fn suffixes_in_any_order() {
        let process = Pruning::default();
        let arm = |text: &str| Arm { name: String::new(), ..Arm::parse(text, &process).unwrap() };
        assert_eq!(arm("css+rewarm+attrition"), arm("css+attrition+rewarm"));
        let all = arm("css:global+merge-detail+attrition+rewarm+thresholds@0.1");
        for text in [
            "css@0.1+thresholds+rewarm+attrition-detail+merge:global",
            "css-detail:global@0.1+merge+attrition+thresholds+rewarm",
        ] {
            assert_eq!(arm(text), all, "{text}");
        }
        assert_eq!(arm("gns@0.2+rewarm"), arm("gns+rewarm@0.2"));
    }
}
