//! `cargo bench --bench training -- [OPTIONS]`: an iteration of training by stage, at a fixed number of Gaussians, as
//! one JSON document.
//!
//! Nothing moves (`Schedule::still`), so that every iteration of a photo does the same work. Compared variants are
//! measured in turns, and each round measures every model before the next begins: a measurement that is stopped has as
//! many models as possible. What cannot be measured has a row with its `problem` in place of `ms`.
#![allow(missing_docs)] // as other benchmarks

mod imbalance;
#[path = "../engine/scenes.rs"]
mod scenes;

use clap::Parser;
use imbalance::Imbalance;
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::gpu::{Device, DeviceKind, DeviceOptions, TuningChoice};
use qirf_vk::render::{Renderer, Settings, TrainingRenderer};
use qirf_vk::scene::{LoadOptions, OpenOptions, Photo, Scene};
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, STAGES, Trainer};
use serde_json::{Map, Value, json};
use std::error::Error;
use std::fs;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

/// Gaussians of the generated crowds on GPUs; on CPU devices only the first of these numbers, divided by 50.
const CROWDS: [usize; 3] = [500_000, 1_000_000, 3_000_000];
/// Size of generated pictures: 1.01 Mpixel.
const SIZE: [u32; 2] = [1216, 832];
/// Generated views.
const VIEWS: usize = 8;

#[derive(Parser)]
struct Arguments {
    /// A capture, whose photos are trained on; else pictures of another crowd.
    #[arg(long)]
    scene: Option<PathBuf>,
    /// A model to train; else crowds of 0.5, 1 and 3 M Gaussians, 10 k on CPU devices.
    #[arg(long)]
    model: Vec<PathBuf>,
    /// Another variant: a folder of modules that replace the program's own.
    #[arg(long)]
    shaders: Vec<PathBuf>,
    /// Another variant: a tuning.
    #[arg(long)]
    tuning: Vec<String>,
    /// Iterations that are timed.
    #[arg(long, default_value_t = 128)]
    iterations: u32,
    /// Times that each variant is measured.
    #[arg(long, default_value_t = 1)]
    rounds: u32,
    /// The document of an earlier measurement: its times stand beside these.
    #[arg(long)]
    compare: Option<PathBuf>,
    /// File of the document, rewritten after each row; else the document is printed in the end.
    #[arg(long)]
    output: Option<PathBuf>,
    /// Given by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

/// A way to open the device.
struct Variant {
    name: String,
    options: DeviceOptions,
}

impl Arguments {
    fn variants(&self) -> Result<Vec<Variant>, String> {
        let environment = DeviceOptions::from_env().expect("options of the environment");
        let mut variants = vec![Variant { name: "as built".into(), options: environment.clone() }];
        for folder in &self.shaders {
            let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            let mut options = environment.clone();
            options.harness.shaders = Some(folder.clone());
            variants.push(Variant { name, options });
        }
        for text in &self.tuning {
            let tuning: TuningChoice = text.parse()?;
            let options = DeviceOptions { tuning: Some(tuning), ..environment.clone() };
            variants.push(Variant { name: text.clone(), options });
        }
        Ok(variants)
    }

    /// The models, by name.
    fn models(&self, device: &Device) -> Result<Vec<(String, Gaussians)>, Box<dyn Error>> {
        if self.model.is_empty() {
            let crowds = if is_cpu(device) { vec![CROWDS[0] / 50] } else { CROWDS.to_vec() };
            return Ok(crowds.into_iter().map(|n| (format!("crowd of {n}"), scenes::crowd(n, 3, 1.0, 4))).collect());
        }
        let read = |path: &PathBuf| Ok((path.display().to_string(), formats::read(path)?.gaussians));
        self.model.iter().map(read).collect()
    }

    /// The photos: of the capture at its own size, or pictures of a crowd other than the model, so that every pixel has
    /// an error.
    fn photos(&self, device: &Device) -> Result<Vec<Photo>, Box<dyn Error>> {
        if let Some(folder) = &self.scene {
            let mut scene = Scene::open(folder, &OpenOptions::default())?;
            scene.require_photos()?;
            return Ok(scene.load_photos(&LoadOptions::default(), &|_| {})?);
        }
        let target = scenes::crowd(20_000, 0, 1.0, 3);
        let [width, height] = if is_cpu(device) { SIZE.map(|side| side / 8) } else { SIZE };
        let resident = Resident::upload(device, &target)?;
        let mut renderer = Renderer::new(device, Settings::default(), target.len(), width, height)?;
        let turn = |view: usize| std::f64::consts::TAU * view as f64 / VIEWS as f64;
        let cameras = (0..VIEWS).map(|view| scenes::camera(width, height, turn(view)));
        let photos = cameras.map(|camera| scenes::photo(&mut renderer, &resident, &camera));
        Ok(photos.collect::<Result<_, _>>()?)
    }
}

fn is_cpu(device: &Device) -> bool {
    device.info().kind == DeviceKind::Cpu
}

/// Milliseconds of an iteration on a device of its own: by stage, their sum, and by the host's clock.
fn measure(
    options: &DeviceOptions,
    model: &Gaussians,
    photos: &[Photo],
    iterations: u32,
) -> Result<Value, Box<dyn Error>> {
    let device = &Device::open(options)?;
    let schedule = Schedule { degree_every: 0.0, half_until: 0.0, ..Schedule::still() };
    let pairs = u32::try_from(4 * model.len())?;
    let options = Options { schedule, degree: model.sh.len() - 1, most: model.len(), pairs, ..Options::default() };
    let mut trainer = Trainer::new(device, model, photos.to_vec(), 1.0, options)?;
    // Every photo once, so that pair lists grow and drivers compile.
    advance(&mut trainer, u32::try_from(photos.len())?.max(32))?;
    let (before, begun) = (trainer.timings().clone(), Instant::now());
    advance(&mut trainer, iterations)?;
    let per = |seconds: f64| (1e6 * seconds / f64::from(iterations)).round() / 1e3;
    let host = per(begun.elapsed().as_secs_f64());
    let stages = STAGES.map(|stage| trainer.timings().seconds(stage) - before.seconds(stage));
    let mut row: Map<String, Value> =
        STAGES.iter().zip(stages).map(|(s, seconds)| (s.to_string(), json!(per(seconds)))).collect();
    row.insert("sum".into(), json!(per(stages.iter().sum())));
    row.insert("host".into(), json!(host));
    row.insert("peak_bytes".into(), json!(device.memory_used().1));
    Ok(Value::Object(row))
}

/// Counts of the first photo's picture.
fn imbalance(device: &Device, model: &Gaussians, photo: &Photo) -> Result<Value, Box<dyn Error>> {
    let (resident, camera) = (Resident::upload(device, model)?, &photo.camera);
    let (size, pairs) = ([camera.width, camera.height], u32::try_from(4 * model.len())?);
    let mut renderer = TrainingRenderer::new(device, Settings::default(), model.len(), size, pairs)?;
    renderer.render(&resident, camera)?;
    Ok(serde_json::to_value(Imbalance::of(device, &renderer.slots(camera))?)?)
}

fn advance(trainer: &mut Trainer, iterations: u32) -> Result<(), Box<dyn Error>> {
    let until = trainer.iteration() + iterations;
    trainer.run_until(until, |_, _| ControlFlow::Continue(()))?;
    Ok(())
}

/// The document: whole in its file at every moment.
struct Document {
    contents: Value,
    output: Option<PathBuf>,
    /// Entries with a problem.
    problems: usize,
}

impl Document {
    /// Adds an entry to a list, with what was measured under this key, or with the problem.
    fn add(
        &mut self,
        list: &str,
        mut entry: Value,
        (key, measured): (&str, Result<Value, Box<dyn Error>>),
    ) -> Result<(), Box<dyn Error>> {
        match measured {
            Ok(value) => entry[key] = value,
            Err(problem) => {
                self.problems += 1;
                entry["problem"] = json!(problem.to_string());
            }
        }
        eprintln!("{entry}");
        if let Some(entries) = self.contents[list].as_array_mut() {
            entries.push(entry);
        }
        if let Some(path) = &self.output {
            formats::write_atomically(path, |out| writeln!(out, "{:#}", self.contents))?;
        }
        Ok(())
    }

    fn rows(&self) -> &[Value] {
        self.contents["rows"].as_array().map(Vec::as_slice).unwrap_or_default()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let earlier: Option<Value> = match &arguments.compare {
        Some(path) => Some(serde_json::from_slice(&fs::read(path)?)?),
        None => None,
    };
    let variants = arguments.variants()?;
    let device = Device::open(&variants[0].options)?;
    let (photos, models) = (arguments.photos(&device)?, arguments.models(&device)?);
    let size = photos.first().map(|photo| [photo.camera.width, photo.camera.height]);
    let contents = json!({
        "device": device.tuned(), "photos": photos.len(), "size": size, "iterations": arguments.iterations,
        "counts": [], "rows": [],
    });
    let mut document = Document { contents, output: arguments.output.clone(), problems: 0 };
    for (name, model) in &models {
        let counts = imbalance(&device, model, &photos[0]);
        document.add("counts", json!({ "model": name, "view": 0 }), ("imbalance", counts))?;
    }
    for round in 0..arguments.rounds {
        for (name, model) in &models {
            for variant in &variants {
                let row = json!({ "model": name, "gaussians": model.len(), "variant": variant.name, "round": round });
                let ms = measure(&variant.options, model, &photos, arguments.iterations);
                document.add("rows", row, ("ms", ms))?;
            }
        }
    }
    if document.output.is_none() {
        println!("{:#}", document.contents);
    }
    if let Some(earlier) = &earlier {
        compare(earlier, document.rows())?;
    }
    match document.problems {
        0 => Ok(()),
        problems => Err(format!("{problems} measurements failed: their entries say why").into()),
    }
}

/// The median time of a stage over the rounds of a model and a variant; `None` if it was not measured.
fn median(rows: &[Value], [model, variant, stage]: [&Value; 3]) -> Option<f64> {
    let same = rows.iter().filter(|row| row["model"] == *model && row["variant"] == *variant);
    let mut times: Vec<f64> = same.filter_map(|row| row["ms"][stage.as_str()?].as_f64()).collect();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}

/// Prints these times beside those of an earlier document, by model, variant and stage.
fn compare(earlier: &Value, rows: &[Value]) -> Result<(), Box<dyn Error>> {
    let before = earlier["rows"].as_array().ok_or("the other document has no rows")?;
    eprintln!("| model | variant | stage | before / ms | now / ms | now / before |\n|---|---|---|---:|---:|---:|");
    for row in rows.iter().filter(|row| row["round"] == 0) {
        for (stage, _) in row["ms"].as_object().into_iter().flatten().filter(|(stage, _)| *stage != "peak_bytes") {
            let key = [&row["model"], &row["variant"], &json!(stage)];
            if let (Some(before), Some(now)) = (median(before, key), median(rows, key)) {
                let (model, variant) = (row["model"].as_str().unwrap_or(""), row["variant"].as_str().unwrap_or(""));
                eprintln!("| {model} | {variant} | {stage} | {before:.3} | {now:.3} | {:.3} |", now / before);
            }
        }
    }
    Ok(())
}
