//! `qirf-vk compare SCENE`.

use super::choices::{Choices, checked};
use super::console::Console;
use super::resources::Resources;
use super::show::Show;
use super::training::Training;
use super::{Global, check_folder, holds_run, tell_of_missing};
use crate::job::config::{PruneRule, Pruning};
use crate::job::{Error, Output, RunConfig, earlier};
use crate::lab::compare::{Arm, CompareRecord, arms_help, compare, compare_seeds, of_seeds, write};
use crate::qirf::select::budget::Keep;
use std::path::PathBuf;

const ARMS: &str =
    "default,gnso,ordinary,lowdin,importance,css,radsplat,lightgaussian,contribution,opacity,random,dense";
/// The paper's tables: with and without the detail safeguard, and both metrics over counts.
const ABLATION: &str =
    "dense,gnso,gnso-detail,ordinary,gnso@0.1,ordinary@0.1,gnso@0.2,ordinary@0.2,gnso@0.4,ordinary@0.4";

/// Methods of the paper's Tables 1 and 2: QIRF, 3DGS, `RadSplat`, `LightGaussian`, Compact3DGS, `MaskGaussian`, GaussianPOP, GNS,
/// 3DGS-MCMC, and growth to the same count.
const PAPER_TABLES: &str = "dense,dense+thresholds,default,paper,gnso,radsplat:global-detail+twice,lightgaussian:global-detail,\
     compact3dgs,maskgaussian,pop,gns,mcmc,importance,grown";

const EXAMPLES: &str = "Examples:
  qirf-vk compare capture -o compared --preset quick --resolution 256
  qirf-vk compare capture -o compared --arms default,importance,css:hybrid+merge,dense --keep 0.2
  qirf-vk compare capture -o compared --ablation
  qirf-vk compare capture -o compared --arms paper-tables --seeds 3";

const FILES: &str =
    "The folder holds compare.html, compare.csv, compare.json, and each arm's model, pictures and figures in arms/.";

#[derive(Debug, clap::Args)]
#[command(after_help = format!("{EXAMPLES}\n\n{}\n\n{FILES}", arms_help()))]
pub(super) struct Arguments {
    /// Scene: a COLMAP, Blender, instant-ngp or nerfstudio folder
    scene: PathBuf,
    /// Folder for the results; created if absent
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Arms to compare, separated by commas, or paper-tables, the methods of the QIRF paper's tables [default: default, dense and
    /// most selectors]
    #[arg(long, value_name = "ARM,...")]
    arms: Option<String>,
    /// Compare the arms of the paper's ablations
    #[arg(long, conflicts_with = "arms")]
    ablation: bool,
    /// Number of seeds, from --seed on, for every arm; each seed has a folder of its own, and figures are means and spreads
    /// [default: 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    seeds: Option<u32>,
    /// Reuse finished parts of an earlier comparison with the same options, and continue interrupted ones
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    resources: Resources,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    // Behind options without a heading: its own would hold for them.
    #[command(flatten)]
    choices: Choices,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let pruning = self.training.pruning(&self.choices)?;
        let asked = match self.arms.as_deref() {
            Some("paper-tables") => PAPER_TABLES,
            Some(arms) => arms,
            None if self.ablation => ABLATION,
            None => ARMS,
        };
        let arms: Vec<Arm> = asked
            .split(',')
            .map(|text| Arm::parse(text.trim(), &pruning))
            .collect::<Result<_, _>>()
            .map_err(|e| Error::Usage(format!("--arms: {e}")))?;
        if let Some(twice) = (1..arms.len()).find(|i| arms[..*i].iter().any(|a| a.name == arms[*i].name)) {
            return Err(Error::Usage(format!("--arms: {} is given twice", arms[twice].name)));
        }
        // The arms share everything up to the checkpoint: another choice of arms continues from it. A count decides how far
        // the model grows.
        let keep = match pruning.compression.keep {
            count @ Keep::Count(_) => count,
            _ => PruneRule::default().keep,
        };
        let compression = PruneRule { keep, ..PruneRule::default() };
        let config = self.training.configuration(self.scene.clone(), console)?;
        // Arms prune by the options.
        checked(config.clone().pruned(pruning.clone()))?;
        let config = config.pruned(Pruning { compression, ..pruning });
        check_folder(&self.output)?;
        let _claimed = Output::claim(&self.output)?;
        self.check_earlier(&config)?;
        let networks = self.resources.networks()?;
        let device = self.resources.device(global)?;
        let watcher = Show::new(console);
        let session = self.resources.session((&device, &networks), &watcher);
        let compared = match self.seeds {
            None => compare(&session, &config, &arms, &self.output, Some(self.resume))?,
            Some(seeds) => compare_seeds(&session, &config, &arms, seeds, &self.output, self.resume)?,
        };
        tell_of_missing(&networks, console);
        write(&compared, &self.output)?;
        watcher.rest();
        if self.json { console.json(&compared) } else { self.report(console, &compared) }
    }

    /// Refuses to lose an interrupted comparison, and to continue one with other options, before any work.
    fn check_earlier(&self, config: &RunConfig) -> Result<(), Error> {
        if self.output.join("model.ply").exists() {
            return Err(holds_run(&self.output));
        }
        for (config, folder) in of_seeds(config, self.seeds, &self.output) {
            let output = Output::new(&folder)?;
            // A finished comparison keeps its checkpoint. Its figures go when one begins or continues in its folder.
            if !self.resume && output.checkpoint().exists() && !self.output.join("compare.json").exists() {
                return Err(Error::Unfinished(output.checkpoint()));
            }
            if self.resume && output.checkpoint().exists() {
                earlier::check(&output, &config)?;
            }
        }
        Ok(())
    }

    fn report(&self, console: &Console, compared: &CompareRecord) -> Result<(), Error> {
        let number = |v: Option<f64>, digits: usize| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"));
        // Names of arms may be long.
        let width = compared.arms.iter().map(|a| a.name.len()).max().unwrap_or(0).max("arm".len());
        console.print(format_args!(
            "{:<width$} {:>8} {:>9} {:>18} {:>8} {:>8} {:>10} {:>8} {:>8} {:>8} {:>8}",
            "arm", "PSNR/dB", "deviation", "difference", "SSIM", "LPIPS", "Gaussians", "removed", "MB", "FPS", "s"
        ))?;
        for arm in &compared.arms {
            console.print(format_args!(
                "{:<width$} {:>8} {:>9} {:>18} {:>8} {:>8} {:>10} {:>7.1}% {:>8.2} {:>8} {:>8.1}",
                arm.name,
                number(arm.psnr, 3),
                number(arm.psnr_spread, 2),
                arm.paired.map_or_else(|| "-".to_owned(), |paired| paired.to_string()),
                number(arm.ssim, 4),
                number(arm.lpips_vgg, 4),
                arm.gaussians,
                100.0 * arm.removed,
                arm.ply_bytes as f64 / 1e6,
                number(arm.fps, 1),
                arm.seconds,
            ))?;
        }
        if let Some(first) = compared.arms.first().filter(|_| compared.arms.iter().any(|arm| arm.paired.is_some())) {
            console.note(format_args!(
                "difference: PSNR minus that of {} in dB, ± its standard error; (tie): too small to tell the arms apart",
                first.name
            ));
        }
        console.print(format_args!("report {}", self.output.join("compare.html").display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_arms_are_known_and_other_names_are_refused_with_all_arms() {
        let arms =
            |list: &str| list.split(',').map(|a| Arm::parse(a, &Pruning::default())).collect::<Result<Vec<_>, _>>();
        for list in [
            ARMS,
            ABLATION,
            PAPER_TABLES,
            "default,paper,gns,pop,dense,dense+thresholds,grown,mcmc,compact3dgs,maskgaussian@0.5",
            "css-detail@0.1,gnso-detail,pairs+rewarm",
        ] {
            assert!(arms(list).is_ok(), "{list}");
        }
        let refused = arms("abc:global+merge").unwrap_err();
        assert!(
            refused.starts_with("'abc' is not an arm; possible values: default, paper, gns, pop, dense,"),
            "{refused}"
        );
        assert!(refused.contains("dense, grown, mcmc") && refused.ends_with("pairs"), "{refused}");
    }
}
