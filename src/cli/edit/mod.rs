//! `qirf-vk edit IN... -o OUT`.

mod operations;
mod parse;

use super::console::Console;
use super::convert::warn_of_clipped;
use super::inspect::{open_scene, read_model};
use super::show::Show;
use super::style::Rendering;
use super::{Global, check_file, check_model, values};
use crate::edit::{Edit, Editor, Step, common_origin, floater_warning, merge, numbers, rounding, rounding_warning};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, Loaded, RenderMode};
use crate::job::output::bytes_on_disk;
use crate::job::records::FloaterCounts;
use crate::job::{Error, Selection, Session};
use crate::metrics::Networks;
use crate::pipeline::floaters;
use crate::pipeline::place::seen;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::scene::OpenOptions;
use crate::wording::counted;
use clap::Arg;
use glam::DVec3;
use operations::{Asked, Operation, Operations};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk edit flowers.ply -o cut.ply --crop-sphere 0,0.2,0,1.5 --min-opacity 0.02
  qirf-vk edit model.ply -o upright.spz --rotate x:12.5 --translate 0,1.2,0 --scale 0.1 --up y
  qirf-vk edit model.ply -o seen.ply --crop-views capture --least-views 3
  qirf-vk edit model.ply -o clean.ply --remove invisible --remove needles --order morton --json
  qirf-vk edit house.ply garden.spz -o both.ply
  qirf-vk edit model.ply --max-size 0.5 --count-only

Operations apply in the order of the command line, to all models as one. View-dependent colours rotate with the model.";

/// The help of `--antialias`, which sets the tag of the written file here.
const ANTIALIAS: &str = "Render mode that the written file is tagged with: anti-aliased (on) or plain (off). Pictures for --remove floaters \
    are drawn in this mode; without a value, on; true and false stand for on and off [default: as the model's file says]";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(mut_arg("antialias", |arg| arg.help(ANTIALIAS)))]
#[command(mut_arg("dilation", |arg| of_floaters(arg)), mut_arg("depth_order", |arg| of_floaters(arg)))]
pub(super) struct Arguments {
    /// Models: .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz files, or SOG folders; several become one
    #[arg(value_name = "IN", required = true)]
    inputs: Vec<PathBuf>,
    /// Model to write: .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda or .usdz
    #[arg(short, long, value_name = "OUT", required_unless_present = "count_only")]
    output: Option<PathBuf>,
    /// Print the number of Gaussians that each operation leaves, and write nothing
    #[arg(long)]
    count_only: bool,
    /// Print the removed Gaussians and the reasons as JSON on standard output
    #[arg(long)]
    json: bool,
    /// Minimum number of photos that show the centre of a Gaussian, for --crop-views [default: 1]
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    least_views: Option<u32>,
    #[command(flatten)]
    operations: Operations,
    /// Scene whose photos show which Gaussians are floaters, for --remove floaters [default: pictures of the model]
    #[arg(long, value_name = "SCENE", help_heading = "Floaters")]
    scene: Option<PathBuf>,
    /// Photo folder, such as images_4 [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Floaters", requires = "scene")]
    images: Option<PathBuf>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Floaters", requires = "scene", value_parser = values::resolution_text)]
    resolution: Option<String>,
    #[command(flatten)]
    rendering: Rendering,
}

/// An option of rendering, for pictures that show floaters.
fn of_floaters(option: Arg) -> Arg {
    let help = option.get_help().map(ToString::to_string).unwrap_or_default();
    option.help(format!("For --remove floaters only. {help}")).help_heading("Floaters")
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        self.check_output()?;
        let operations = self.operations.in_order()?;
        self.check_operations(&operations)?;
        let mut models = Vec::with_capacity(self.inputs.len());
        for path in &self.inputs {
            models.push((path.clone(), read_model(path, console)?));
        }
        let inputs: Vec<Value> = models.iter().map(|(path, loaded)| input(path, loaded)).collect();
        let origin = same_origin(&mut models, console);
        if origin != [0.0; 3] {
            let [x, y, z] = origin;
            console.note(format_args!(
                "coordinates, including those of operations, are relative to the local origin {x},{y},{z}"
            ));
        }
        let numbers = self.json.then(|| numbers(&models));
        let (model, mode) = merge(models, self.rendering.mode())?;
        let (mut far, merged) = (rounding(&model).is_some(), left(model.len(), model.degree()));
        let mut editor = Editor::new(model, numbers);
        if self.inputs.len() > 1 && !self.json {
            console.print(format_args!("{}: {merged}", counted(self.inputs.len(), "model")))?;
        }
        if operations.is_empty() && self.count_only && !self.json {
            console.print(&merged)?;
        }
        for asked in &operations {
            let before = bounds_before(asked, &mut editor, (&mut far, console))?;
            let step = self.apply((asked, mode, origin), &mut editor, (console, global))?.clone();
            if !self.json {
                tell(console, &step, editor.degree())?;
            }
            if step.after == 0 && step.before > 0 && !self.count_only {
                return Err(nothing_left(asked, before));
            }
        }
        let (model, steps) = editor.finish()?;
        if let Some(step) = rounding(&model).filter(|_| !far) {
            console.warn(rounding_warning("the model now lies far from its origin", step));
        }
        let written = if self.count_only { None } else { self.output.as_deref() };
        if let Some(path) = written {
            formats::write_at(path, &model, mode, origin).map_err(Error::writing)?;
            warn_of_clipped(path, &model, console);
        }
        if self.json {
            return console.json(&json!({
                "input": inputs,
                "steps": steps,
                "output": output(written, &model, mode),
            }));
        }
        if let Some(path) = written {
            let left = left(model.len(), model.degree());
            console.note(format_args!("{left} in {} ({} bytes)", path.display(), bytes_on_disk(path)));
        }
        Ok(())
    }

    /// Refuses an output that cannot be written or would overwrite an input, before any work.
    fn check_output(&self) -> Result<(), Error> {
        let Some(output) = self.output.as_deref().filter(|_| !self.count_only) else { return Ok(()) };
        check_model(output)?;
        for input in &self.inputs {
            formats::refuse_overwrite(input, output).map_err(Error::writing)?;
        }
        check_file(output)
    }

    /// Refuses options of operations that are absent.
    fn check_operations(&self, operations: &[Asked]) -> Result<(), Error> {
        let has = |wanted: fn(&Operation) -> bool| operations.iter().any(|asked| wanted(&asked.what));
        let floaters = has(|what| matches!(what, Operation::Floaters));
        let why = if self.scene.is_some() && !floaters {
            "--scene is for --remove floaters; to crop by cameras, use --crop-views"
        } else if self.rendering.is_of_pictures() && !floaters {
            "--dilation and --depth-order are for the pictures of --remove floaters"
        } else if self.least_views.is_some() && !has(|what| matches!(what, Operation::Views { .. })) {
            "--least-views needs --crop-views"
        } else {
            return Ok(());
        };
        Err(Error::Usage(why.to_owned()))
    }

    fn apply<'e>(
        &self,
        (asked, mode, origin): (&Asked, RenderMode, [f64; 3]),
        editor: &'e mut Editor,
        (console, global): (&Console, &Global),
    ) -> Result<&'e Step, Error> {
        let edit = match &asked.what {
            Operation::Edit(edit) => edit.clone(),
            Operation::Views { scene, outside } => {
                let least = self.least_views.unwrap_or(1) as usize;
                let scene = open_scene(scene, &OpenOptions::default(), console)?;
                Edit::Crop { region: seen(editor.model()?, origin, &scene, least)?, outside: *outside }
            }
            Operation::Matrix(path) => operations::of_matrix(path)?,
            Operation::Floaters => return self.without_floaters((asked, mode, origin), editor, (console, global)),
        };
        Ok(editor.apply(&edit, &asked.name, &asked.why)?)
    }

    /// Removes floaters, by photos or by pictures of the model.
    fn without_floaters<'e>(
        &self,
        (asked, mode, origin): (&Asked, RenderMode, [f64; 3]),
        editor: &'e mut Editor,
        (console, global): (&Console, &Global),
    ) -> Result<&'e Step, Error> {
        let device = global.open()?;
        let (networks, watcher) = (Networks::default(), Show::new(console));
        let session = Session { watcher: &watcher, ..Session::new(&device, &networks) };
        let (model, style) = (editor.model()?, self.rendering.of(mode));
        let found = match &self.scene {
            Some(scene) => {
                let (images, resolution) = (self.images.clone(), self.resolution.clone());
                let selection = Selection { images, resolution, ..Selection::of(scene.clone()) };
                floaters::by_photos(&session, model, origin, &selection, style)?
            }
            None => floaters::by_own_pictures(&session, model, &VirtualCameras::default(), style)?,
        };
        let counts = FloaterCounts::of(&found);
        let removed = found.iter().flatten().count();
        if let Some(warning) = floater_warning(removed, found.len(), self.scene.is_some()) {
            console.warn(warning);
        } else if self.scene.is_none() {
            console
                .note("without photos, most large floaters and groups of them stay; --scene finds them by the photos");
        }
        let why = if self.scene.is_some() { counts.to_string() } else { counts.without_photos() };
        Ok(editor.remove(&found, &asked.name, &why))
    }
}

fn left(gaussians: usize, degree: usize) -> String {
    format!("{} of SH degree {degree}", counted(gaussians, "Gaussian"))
}

/// The least and the greatest coordinates of a model's means.
type Bounds = ([f32; 3], [f32; 3]);

/// Applies pending moves before an operation that is no move, and returns the model's bounds. Warns if the moves took
/// the model far from its origin and it was not `far` before.
fn bounds_before(
    asked: &Asked,
    editor: &mut Editor,
    (far, console): (&mut bool, &Console),
) -> Result<Option<Bounds>, Error> {
    if asked.what.is_move() {
        return Ok(None);
    }
    if let Some(step) = editor.settle()?.filter(|_| !*far) {
        let what = format!("the model lies far from its origin at {}", asked.name);
        console.warn(rounding_warning(&what, step));
        *far = true;
    }
    Ok(editor.model()?.bounds())
}

fn tell(console: &Console, step: &Step, degree: usize) -> Result<(), Error> {
    let Step { edit, after, removed, why, .. } = step;
    match why {
        Some(why) => console.print(format_args!("{edit}: {after} left, {removed} removed ({why})")),
        None => console.print(format_args!("{edit}: {}", left(*after, degree))),
    }
}

/// Lets the means of all models be relative to one origin.
fn same_origin(models: &mut [(PathBuf, Loaded)], console: &Console) -> [f64; 3] {
    let origins: Vec<_> = models.iter().map(|(_, loaded)| (&loaded.gaussians, loaded.origin)).collect();
    let origin = common_origin(&origins);
    for (path, loaded) in models {
        let shift = DVec3::from(loaded.origin) - DVec3::from(origin);
        loaded.gaussians.shift(shift);
        if let Some(step) = rounding(&loaded.gaussians).filter(|_| shift != DVec3::ZERO) {
            let what = format!("{} lies far from the origin of the merged model", path.display());
            console.warn(rounding_warning(&what, step));
        }
    }
    origin
}

/// An error that says where the Gaussians were.
fn nothing_left(asked: &Asked, before: Option<([f32; 3], [f32; 3])>) -> Error {
    let where_from = before.map_or_else(String::new, |(low, high)| {
        let point = |p: [f32; 3]| format!("{:.4},{:.4},{:.4}", p[0], p[1], p[2]);
        format!(" of a model from {} to {}", point(low), point(high))
    });
    let Asked { name, why, .. } = asked;
    Error::Usage(format!("{name} leaves no Gaussians{where_from} ({why}): nothing was written"))
}

fn input(path: &Path, loaded: &Loaded) -> Value {
    json!({
        "path": path.to_string_lossy(),
        "format": loaded.format.to_string(),
        "gaussians": loaded.gaussians.len(),
        "sh_degree": loaded.gaussians.degree(),
        "render_mode": loaded.mode,
        "repairs": loaded.repairs,
    })
}

fn output(path: Option<&Path>, model: &Gaussians, mode: RenderMode) -> Value {
    json!({
        "path": path.map(Path::to_string_lossy),
        "bytes": path.map(bytes_on_disk),
        "gaussians": model.len(),
        "sh_degree": model.degree(),
        "render_mode": mode,
    })
}
