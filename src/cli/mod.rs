//! The command line. One file per command: its arguments, and its work.

mod choices;
mod compare;
mod completions;
mod compress;
mod compression;
mod console;
mod convert;
mod device;
mod diagnostics;
mod edit;
mod eval;
mod inspect;
mod interrupt;
mod lpips;
mod outputs;
mod plan;
mod pose;
mod pulse;
mod remedy;
mod render;
mod resources;
mod run;
mod scratch;
mod selftest;
mod shard;
mod show;
mod style;
mod sweep;
mod synth;
mod training;
mod values;
mod view;
mod viewer;

use crate::gpu::{self, Device, DeviceOptions, Milliseconds, TuningChoice};
use crate::job::output::check_file;
use crate::job::{Error, Exit};
use clap::{ArgAction, Args, ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};
use console::{Colour, Console};
use lpips::tell_of_missing;
use outputs::{check_folder, check_model, check_no_run, holds_run};
use std::io::{self, IsTerminal};
use std::process::ExitCode;
use tracing_subscriber::filter::LevelFilter;

/// Train, prune and measure 3D Gaussian Splatting scenes with Vulkan compute.
#[derive(Debug, Parser)]
#[command(name = "qirf-vk", version, max_term_width = 110, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: Global,
}

/// Options of every command.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Global options")]
struct Global {
    /// Vulkan device: its index, a part of its name, uuid:UUID, pci:ADDRESS, or free: one without another process's lease
    /// [default: $QIRF_DEVICE, else the fastest kind available]
    #[arg(long, global = true, value_name = "NAME|INDEX|uuid:|pci:|free")]
    device: Option<String>,
    /// Kernel parameters: a class of devices (cpu, gpu, nvidia, ...), fields such as sort_rows_max=8, or both, separated by commas
    /// [default: $QIRF_TUNING, else the result of `qirf-vk device --tune`, else those of the device's class]
    #[arg(long, global = true, value_name = "CLASS,FIELD=VALUE")]
    tuning: Option<TuningChoice>,
    /// Maximum length of a submission to the device, in milliseconds: for slow devices on systems that reset a busy driver, as
    /// Windows does after 2,000 [default: $QIRF_MAX_SUBMISSION, else 1000 for GPUs on Windows, and no limit elsewhere]
    #[arg(long, global = true, value_name = "MS")]
    max_submission: Option<Milliseconds>,
    /// Print only results and errors
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Print more details; -vv prints even more
    #[arg(short, long, global = true, action = ArgAction::Count, conflicts_with = "quiet")]
    verbose: u8,
    /// When to colour text
    #[arg(long, global = true, value_name = "WHEN", default_value = "auto", value_parser = values::one_of::<Colour>("a choice"))]
    color: Colour,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Train and prune a model from photos, a scene or a video
    #[command(visible_alias = "train")]
    Run(run::Arguments),
    /// Compare pruning methods on a scene, all from one checkpoint
    Compare(compare::Arguments),
    /// Measure accuracy against time along each axis of the engine
    Sweep(sweep::Arguments),
    /// Score a model against held-out photos of a scene, or against another model
    Eval(eval::Arguments),
    /// Prune an existing model, and write a smaller file
    Compress(compress::Arguments),
    /// Divide a large compression, or a training in blocks, into tasks for one device or a cluster
    Shard(shard::Arguments),
    /// Render pictures of a model, from a scene's cameras or on a circle around it
    Render(render::Arguments),
    /// Look at a model, a run or a capture in a browser
    View(view::Arguments),
    /// Crop, move, rotate, clean and merge models
    Edit(edit::Arguments),
    /// Convert a model between file formats
    Convert(convert::Arguments),
    /// Show the contents of a model or a scene
    Inspect(inspect::Arguments),
    /// Estimate the camera poses of photos or of a video, with COLMAP or OpenMVG-rs
    Pose(pose::Arguments),
    /// Make a synthetic capture: ray-traced photos, cameras and points
    Synth(synth::Arguments),
    /// List the Vulkan devices, and which one would be used
    Device(device::Arguments),
    /// Compare the device's results with those of the CPU
    Selftest(selftest::Arguments),
    /// Print completions for a shell
    Completions(completions::Arguments),
}

/// Groups of commands in the top-level help.
const GROUPS: [(&str, &[&str]); 4] = [
    ("Training and compression", &["run", "compress", "shard", "compare", "sweep", "eval"]),
    ("Models and pictures", &["view", "render", "edit", "convert", "inspect"]),
    ("Data", &["pose", "synth"]),
    ("This machine", &["device", "selftest", "completions"]),
];

const EXAMPLES: &str = "Examples:
  qirf-vk run photos -o trained --preset quick --resolution 256
  qirf-vk compare capture -o compared --arms default,importance,dense
  qirf-vk sweep capture -o swept
  qirf-vk eval trained/model.ply --config trained/config.toml
  qirf-vk compress flowers.ply -o small.ply --keep 0.28
  qirf-vk view flowers.ply
  qirf-vk render flowers.ply --orbit 8 -o pictures
  qirf-vk render model.spz --scene capture --resolution /2 -o pictures
  qirf-vk inspect capture
  qirf-vk selftest

Exit codes: 0 success, 2 usage, 3 bad input, 4 device, 5 out of memory or disk space, 130 interrupted.
`qirf-vk COMMAND --help` lists a command's options.";

/// Lets options of all commands take negative numbers as values, so that their parsers can say what is wrong with them.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let takes = |arg: &clap::Arg| {
        let values = arg.get_num_args().is_none_or(|range| range.takes_values());
        arg.get_long().is_some() && arg.get_action().takes_values() && values
    };
    command
        .mut_args(move |arg| {
            let negative = takes(&arg) && !arg.is_allow_hyphen_values_set();
            if negative { arg.allow_negative_numbers(true) } else { arg }
        })
        .mut_subcommands(with_negative_numbers)
}

/// Options that only experiments use: `compare` shows them, and `run`, `compress` and their plans take them without showing them.
const EXPERIMENTS: [&str; 6] = ["partition", "overlap", "dilate", "solver", "epsilon", "init_count"];

/// Leaves the options of experiments out of a command's help, which then says where they are.
fn without_experiments(command: clap::Command) -> clap::Command {
    let examples = command.get_after_help().map(|text| format!("{text}\n\n")).unwrap_or_default();
    let elsewhere = "`qirf-vk compare --help` lists options for experiments, such as --solver; this command accepts those on compression, too.";
    command.after_help(examples + elsewhere).mut_args(|arg| {
        let hidden = EXPERIMENTS.contains(&arg.get_id().as_str());
        if hidden { arg.hide(true) } else { arg }
    })
}

/// The command line for clap, with commands in groups.
fn command() -> clap::Command {
    let command = Cli::command();
    let line = |name: &&str| {
        let about = command.find_subcommand(name).and_then(clap::Command::get_about);
        format!("  {name:<12} {}\n", about.map(ToString::to_string).unwrap_or_default())
    };
    let group = |(heading, names): &(&str, &[&str])| {
        format!("{heading}:\n{}\n", names.iter().map(line).collect::<Vec<_>>().concat())
    };
    let list = GROUPS.iter().map(group).collect::<Vec<_>>().concat();
    with_negative_numbers(command)
        .mut_subcommand("run", without_experiments)
        .mut_subcommand("compress", without_experiments)
        .mut_subcommand("shard", |shard| {
            shard.mut_subcommand("plan", |plan| {
                ["run", "compress"].into_iter().fold(plan, |plan, job| plan.mut_subcommand(job, without_experiments))
            })
        })
        .help_template(format!(
            "{{about}}\n\n{{usage-heading}} {{usage}}\n\n{list}Global options:\n{{options}}{{after-help}}"
        ))
        .after_help(EXAMPLES)
}

/// Runs the program on the process's arguments.
pub fn main() -> ExitCode {
    // Colour must be known before clap prints an error.
    let asked: Vec<String> = std::env::args_os().skip(1).map(|a| a.to_string_lossy().into_owned()).collect();
    let never = asked.iter().any(|a| a == "--color=never") || asked.windows(2).any(|w| w == ["--color", "never"]);
    let choice = if never { ColorChoice::Never } else { ColorChoice::Auto };
    let parsed = command().color(choice).try_get_matches().and_then(|m| Cli::from_arg_matches(&m));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(u8::try_from(e.exit_code()).unwrap_or(2));
        }
    };
    let console = Console { quiet: cli.global.quiet, colour: cli.global.color };
    log(&cli.global);
    interrupt::outlive_the_file_size_limit();
    interrupt::end_at_once();
    let pool = rayon::ThreadPoolBuilder::new().build_global();
    match pool.map_err(|e| Error::Threads(e.to_string())).and_then(|()| cli.run(&console)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Error::Print(e)) if e.kind() == io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(e) => {
            let head = console.paint("1;31", "error:", io::stderr().is_terminal());
            let remedy = cli.remedy(&e).map(|r| format!("; {r}")).unwrap_or_default();
            console.error(format_args!("{head} {e}{remedy}"));
            ExitCode::from(Exit::of(&e).code())
        }
    }
}

impl Cli {
    /// Advice on an error of this command.
    fn remedy(&self, error: &Error) -> Option<String> {
        match (error, &self.command) {
            (Error::Interrupted, Command::Compress(compress)) if compress.curve.is_some() => {
                Some("no curve was written".to_owned())
            }
            (Error::Interrupted, Command::Compress(_) | Command::Convert(_) | Command::Edit(_)) => {
                Some("no model was written".to_owned())
            }
            (Error::Interrupted, Command::Run(_) | Command::Compare(_)) => {
                Some("what was finished is kept: continue with --resume".to_owned())
            }
            (Error::Interrupted, Command::Eval(_)) => Some("no figures were written".to_owned()),
            (Error::Interrupted, Command::Render(render)) if render.is_one_file() => {
                Some("no file was written".to_owned())
            }
            (Error::Interrupted, Command::Sweep(sweep)) => Some(sweep.kept()),
            (Error::Interrupted, _) => Some("what was finished is kept".to_owned()),
            (Error::Device(gpu::Error::TooLarge { .. }), Command::Compress(_)) => {
                Some("use fewer Gaussians or a smaller image, or --selector pairs, which has room for more".to_owned())
            }
            (Error::Device(gpu::Error::TooLarge { .. }), Command::Run(_)) => Some(
                "use a smaller --resolution or --max-gaussians, with another -o, or a device that can bind larger buffers"
                    .to_owned(),
            ),
            (Error::OtherRun { .. }, Command::Compare(_)) => {
                Some("use the original options and photos, or another folder with -o".to_owned())
            }
            _ => remedy::remedy(error),
        }
    }

    fn run(&self, console: &Console) -> Result<(), Error> {
        match &self.command {
            Command::Run(a) => a.run(console, &self.global),
            Command::Compare(a) => a.run(console, &self.global),
            Command::Sweep(a) => a.run(console, &self.global),
            Command::Eval(a) => a.run(console, &self.global),
            Command::Compress(a) => a.run(console, &self.global),
            Command::Shard(a) => a.run(console, &self.global),
            Command::Render(a) => a.run(console, &self.global),
            Command::View(a) => a.run(console, &self.global),
            Command::Edit(a) => a.run(console, &self.global),
            Command::Convert(a) => a.run(console, &self.global),
            Command::Inspect(a) => a.run(console, &self.global),
            Command::Pose(a) => a.run(console),
            Command::Synth(a) => a.run(console),
            Command::Device(a) => a.run(console, &self.global),
            Command::Selftest(a) => a.run(console, &self.global),
            Command::Completions(a) => a.run(console),
        }
    }
}

impl Global {
    /// The environment's options, under those of the command line.
    fn options(&self) -> Result<DeviceOptions, Error> {
        let options = DeviceOptions::from_env()?;
        Ok(DeviceOptions {
            device: self.device.clone().or(options.device),
            tuning: self.tuning.clone().or(options.tuning),
            max_submission: self.max_submission.map(|ms| ms.0).or(options.max_submission),
            ..options
        })
    }

    /// Opens the device that the options select.
    fn open(&self) -> Result<Device, Error> {
        self.open_with(None)
    }

    /// Opens another handle of a device that is open.
    fn open_again(&self, device: &Device) -> Result<Device, Error> {
        let index = Some(device.info().index.to_string());
        Ok(Device::open(&DeviceOptions { device: index, ..self.options()? })?)
    }

    /// Opens the device that the options select to make its kernels, and to run nothing.
    fn open_to_compile(&self) -> Result<Device, Error> {
        Ok(Device::open(&DeviceOptions { compile_only: true, ..self.options()? })?)
    }

    /// Opens the device that the options select, with a limit on its memory in bytes.
    fn open_with(&self, memory_limit: Option<u64>) -> Result<Device, Error> {
        let device = Device::open(&DeviceOptions { memory_limit, ..self.options()? })?;
        tracing::info!("device {}: {} ({})", device.info().index, device.info().name, device.info().driver);
        Ok(device)
    }
}

fn log(global: &Global) {
    let level = match (global.quiet, global.verbose) {
        (true, _) => LevelFilter::ERROR,
        (_, 0) => LevelFilter::WARN,
        (_, 1) => LevelFilter::INFO,
        _ => LevelFilter::DEBUG,
    };
    let subscriber = tracing_subscriber::fmt()
        .with_max_level(level)
        // A log that cannot be written ends no job: internal errors would be printed, and that would panic.
        .log_internal_errors(false)
        .with_writer(io::stderr)
        .with_ansi(global.color.on(io::stderr().is_terminal()))
        .without_time()
        .with_target(false);
    // Fails only if a host program has installed its own subscriber.
    let _ = subscriber.try_init();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_sound_and_every_command_is_in_the_help() {
        command().debug_assert();
        let mut listed: Vec<_> = GROUPS.iter().flat_map(|g| g.1).copied().collect();
        listed.sort_unstable();
        let mut there: Vec<_> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        there.sort_unstable();
        assert_eq!(listed, there);
    }

    /// A heading of flattened options holds for all options behind them.
    #[test]
    fn a_command_s_own_options_have_no_heading() {
        fn check(command: &clap::Command) {
            for arg in
                command.get_arguments().filter(|arg| ["json", "overwrite", "resume"].contains(&arg.get_id().as_str()))
            {
                assert_eq!(arg.get_help_heading(), None, "{} --{}", command.get_name(), arg.get_id());
            }
            command.get_subcommands().for_each(check);
        }
        check(&command());
    }

    #[test]
    fn an_interrupted_command_says_what_is_kept() {
        for (line, kept) in [
            ("render m.ply --orbit 2 -o a", "what was finished is kept"),
            ("render m.ply --path orbit -o a.mp4", "no file was written"),
            ("render m.ply --panorama -o a.png", "no file was written"),
            ("sweep m.ply -o a", "no axis was measured"),
        ] {
            let cli = Cli::try_parse_from(["qirf-vk"].into_iter().chain(line.split(' '))).unwrap();
            assert_eq!(cli.remedy(&Error::Interrupted).as_deref(), Some(kept), "{line}");
        }
    }

    /// Clap wraps paragraphs to the terminal; lines broken by hand end up ragged.
    #[test]
    fn paragraphs_of_the_help_are_not_broken_by_hand() {
        fn check(command: &clap::Command) {
            let epilogue = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let lines: Vec<&str> = epilogue.lines().collect();
            for pair in lines.windows(2) {
                let text = |line: &str| line.starts_with(|c: char| !c.is_whitespace());
                let broken = text(pair[0]) && text(pair[1]) && !pair[0].ends_with(['.', ':']);
                assert!(!broken, "{}: {:?} goes on in {:?}", command.get_name(), pair[0], pair[1]);
            }
            command.get_subcommands().for_each(check);
        }
        check(&command());
    }

    #[test]
    fn defaults_have_one_form_and_help_lists_what_the_code_knows() {
        fn check(command: &clap::Command) {
            for arg in command.get_arguments() {
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                assert!(!help.contains("(default"), "{}: {help}", command.get_name());
                let at_end = help.find("[default").is_none_or(|at| help[at..].ends_with(']'));
                assert!(at_end, "{}: a default comes last: {help}", command.get_name());
            }
            command.get_subcommands().for_each(check);
        }
        check(&command());
        let run = command().find_subcommand("run").cloned().unwrap_or_default();
        let effect = run.get_arguments().find(|a| a.get_id() == "effect").and_then(|a| a.get_help());
        let effect = effect.map(ToString::to_string).unwrap_or_default();
        assert!(effect.contains("depth_order") && !effect.contains("cameras"), "{effect}");
    }
}
