//! `qirf-vk convert IN OUT`.

use super::compress::outcome;
use super::console::Console;
use super::inspect::read_model;
use super::show::Show;
use super::style;
use super::values;
use super::viewer;
use super::{Global, check_file};
use crate::extension::{folder_of, has_extension};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, Loaded, Precision, SpzPrecision, SpzVersion};
use crate::job::output::make_place;
use crate::job::records::Aim;
use crate::job::{Error, Session};
use crate::metrics::Networks;
use crate::pipeline::compress::fit::Target;
use crate::pipeline::compress::levels::levels;
use crate::pipeline::compress::remarks::{poor, remarks};
use crate::pipeline::compress::{CompressConfig, Input, ViewSource, compress_to, cost};
use crate::pipeline::eval;
use crate::pipeline::place::shift_to;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::render::{Settings, Style};
use crate::scene::orbit::UP;
use crate::scene::{OpenOptions, Scene};
use crate::view::alone::{Fit, PageOptions, Shell};
use crate::wording::{counted, file_size};
use glam::DVec3;
use std::fs;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk convert model.ply model.spz
  qirf-vk convert model.ply model.glb
  qirf-vk convert model.ply model.html --title Garden --background white
  qirf-vk convert model.ply small.html --size 2MB
  qirf-vk convert garden.ply garden/lod-meta.json --lod 4
  qirf-vk convert playbot-sog/ playbot.compressed.ply

Formats read: PLY (binary, text, compressed), SPZ 1 to 4, .splat, .ksplat, SOG, glTF (.glb, .gltf), USD (.usda, .usdz).
Formats written: PLY (exact), glTF (.glb, .gltf) and USD (exact but for rounding), SPZ, SOG and .compressed.ply (quantised; the PSNR against the model's pictures is printed).
A name in .html gives one page that holds the model as SPZ and draws it in any browser with WebGL 2, without a network.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Model to write: .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda, .usdz, .html, or lod-meta.json with --lod
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Version of a written SPZ: 3 for readers from before 2026; the values are the same [default: 4]
    #[arg(long, value_name = "3|4", value_parser = spz_version)]
    spz_version: Option<SpzVersion>,
    /// Origin of coordinates if the model lies far from its world's origin
    #[arg(long, value_name = "WHERE", default_value = "local")]
    origin: Origin,
    /// Bits of SH coefficients in an SPZ, 1 to 8: of band 1, and of the others if they differ [default: as many as pictures
    /// need]
    #[arg(long, value_name = "N[,N]", value_parser = values::sh_bits)]
    sh_bits: Option<SpzPrecision>,
    /// Write N levels of detail as streamed SOG; OUT is a lod-meta.json in a folder of its own. Each level is merged to a third
    /// of the Gaussians of the level before
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=16))]
    lod: Option<u32>,
    /// Title of the page [default: the model's file name]
    #[arg(long, value_name = "TEXT", help_heading = "Pages (.html)")]
    title: Option<String>,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white [default: as in the model's run, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Pages (.html)")]
    background: Option<[f32; 3]>,
    /// World axis that is up: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: up in the photos of --scene, else
    /// auto]
    #[arg(long, value_name = "AXIS", value_parser = values::up, allow_hyphen_values = true, help_heading = "Pages (.html)")]
    up: Option<DVec3>,
    #[command(flatten)]
    rendering: style::Rendering,
    /// Maximum size of the page, such as 5MB: find the page with the highest PSNR
    #[arg(long, value_name = "BYTES", allow_hyphen_values = true, value_parser = file_size, help_heading = "Pages (.html)")]
    size: Option<u64>,
    /// Scene whose first camera shows the model first, and whose up direction and near plane the page takes [default: the whole
    /// model]
    #[arg(long, value_name = "SCENE", help_heading = "Pages (.html)")]
    scene: Option<PathBuf>,
}

/// Origin of the coordinates of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Origin {
    /// An origin near the model.
    Local,
    /// The world's origin, at any distance.
    Keep,
}

fn spz_version(text: &str) -> Result<SpzVersion, String> {
    match text {
        "3" => Ok(SpzVersion::Three),
        "4" => Ok(SpzVersion::Four),
        _ => Err("write 3 or 4".into()),
    }
}

/// Minimum ratio of the size that is asked for to the picture that a page begins with; a larger picture is left out.
const TO_POSTER: u64 = 50;

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        formats::refuse_overwrite(&self.input, &self.output).map_err(Error::writing)?;
        if self.output.is_dir() {
            let what = format!("{} is a folder; name a file, such as model.spz", self.output.display());
            return Err(Error::Usage(what));
        }
        let is_page = has_extension(&self.output, &["html"]);
        self.check(is_page)?;
        if self.lod.is_none() || folder_of(&self.output).is_dir() {
            check_file(&self.output)?;
        }
        let mut loaded = self.placed(read_model(&self.input, console)?, console);
        if self.lod.is_some() {
            make_place(&self.output)?;
        }
        let style = self.rendering.style(&self.input, &loaded, None, console);
        loaded.mode = style.mode();
        let format = if is_page { self.output.with_extension("spz") } else { self.output.clone() };
        // Quantised files are measured where there is a device.
        let exact = formats::is_exact(&format) && self.lod.is_none();
        let device = (!exact).then(|| global.open());
        let device =
            if self.size.is_some() || self.lod.is_some() { device.transpose()? } else { device.and_then(Result::ok) };
        let (networks, watcher) = (Networks::default(), Show::new(console));
        let session = device.as_ref().map(|d| Session { watcher: &watcher, ..Session::new(d, &networks) });
        if let Some((levels, session)) = self.lod.zip(session.as_ref()) {
            return self.write_levels(session, &loaded, levels as usize, console);
        }
        let background =
            if is_page { style::background_beside(&self.input, self.background, console) } else { [0.0; 3] };
        let page = is_page.then(|| self.page(session.as_ref(), &loaded, (style, background))).transpose()?;
        let up = page.as_ref().map_or(UP, |options| options.up);
        // From here on, a page's model is in the page's coordinates.
        let shell = page.map(|options| fitted(&mut loaded.gaussians, options));
        let wrap = |packed: &[u8]| shell.as_ref().map_or_else(Vec::new, |shell| shell.page(packed).into_bytes());
        let target = Target {
            path: &self.output,
            format: &format,
            spz: if is_page { SpzVersion::Three } else { self.spz_version.unwrap_or_default() },
            precision: self.sh_bits.map(Precision::Spz),
            wrap: if is_page { Some(&wrap) } else { None },
            origin: loaded.origin,
        };
        if let Some((size, session)) = self.size.zip(session.as_ref()) {
            return self.write_within(session, (loaded, style.over(background), up), (&target, size), console);
        }
        let cost = if exact {
            formats::write_at(&self.output, &loaded.gaussians, loaded.mode, loaded.origin).map_err(Error::writing)?;
            String::new()
        } else {
            write_measured(session.as_ref(), (&loaded, style), &target, console)?
        };
        watcher.rest();
        let bytes = fs::metadata(&self.output).map_or(0, |m| m.len());
        console.note(format_args!(
            "{}: {} from {}, {bytes} bytes{cost}",
            self.output.display(),
            counted(
                loaded.gaussians.len(),
                if loaded.mode.antialiased() { "anti-aliased Gaussian" } else { "Gaussian" }
            ),
            loaded.format
        ));
        Ok(())
    }

    /// A model with the coordinates that were asked for.
    fn placed(&self, mut loaded: Loaded, console: &Console) -> Loaded {
        let [x, y, z] = loaded.origin;
        if loaded.origin == [0.0; 3] {
            return loaded;
        }
        if self.origin == Origin::Local {
            console.note(format_args!(
                "coordinates are relative to the local origin {x},{y},{z}, which georeference.json also records"
            ));
            return loaded;
        }
        loaded.gaussians.shift(DVec3::new(x, y, z));
        loaded.origin = [0.0; 3];
        console.warn(format_args!(
            "float32 rounds coordinates so far from the origin; without --origin keep they stay exact"
        ));
        loaded
    }

    /// Refuses options that the output does not read.
    fn check(&self, is_page: bool) -> Result<(), Error> {
        let for_pages = self.title.is_some() || self.background.is_some() || self.up.is_some() || self.scene.is_some();
        let is_spz = has_extension(&self.output, &["spz"]);
        let why = if self.rendering.is_given() && !is_page {
            "--antialias and --dilation apply only to pages here; `qirf-vk edit --antialias` sets a file's tag"
        } else if self.rendering.depth_order() {
            "--depth-order: pages have one order of depths for the whole picture"
        } else if for_pages && !is_page {
            "--title, --background, --up and --scene are for pages: name an .html file"
        } else if self.size.is_some() && !is_page {
            "--size applies only to pages here; for model files use `qirf-vk compress --size`"
        } else if self.spz_version.is_some() && !is_spz {
            "--spz-version applies only to SPZ: name an .spz file"
        } else if self.sh_bits.is_some() && !is_page && !is_spz {
            "--sh-bits applies only to SPZ, and to pages, which contain one"
        } else if self.lod.is_some() != formats::is_levels(&self.output) {
            "--lod N writes streamed SOG, whose name is lod-meta.json: name one, such as garden/lod-meta.json"
        } else if is_page || self.lod.is_some() {
            return Ok(());
        } else {
            return formats::check_output(&self.output).map_err(|error| {
                let pages = ", .html for a page, or lod-meta.json with --lod N";
                Error::Usage(format!("{error}{pages}"))
            });
        };
        Err(Error::Usage(why.to_owned()))
    }

    /// Writes the best page of at most this size.
    fn write_within(
        &self,
        session: &Session<'_>,
        (loaded, drawn, up): (Loaded, Settings, DVec3),
        (target, size): (&Target<'_>, u64),
        console: &Console,
    ) -> Result<(), Error> {
        let cameras = VirtualCameras { up, ..VirtualCameras::default() };
        let views = ViewSource::OwnPictures { cameras, background: drawn.background };
        let config = CompressConfig { views, style: drawn.style, ..CompressConfig::default() };
        let input = Input { path: &self.input, model: loaded.gaussians, read_s: 0.0 };
        let record = compress_to(session, input, &config, Some(Aim::Bytes(size)), target)?;
        console.tell(remarks(&record));
        console.note(format_args!("{}: {}", self.output.display(), outcome(&record)));
        Ok(())
    }

    /// Writes levels of detail, reads them back, and says what each shows.
    fn write_levels(
        &self,
        session: &Session<'_>,
        loaded: &Loaded,
        count: usize,
        console: &Console,
    ) -> Result<(), Error> {
        let (model, style) = (&loaded.gaussians, Style::of(loaded.mode));
        let views = ViewSource::OwnPictures { cameras: VirtualCameras::default(), background: [0.0; 3] };
        let config = CompressConfig { views, style, ..CompressConfig::default() };
        let levels = levels(session, model, &config, count)?;
        formats::write_levels(&self.output, &levels, (loaded.mode, loaded.origin)).map_err(Error::writing)?;
        for number in 0..levels.len() {
            let level = formats::read_level(&self.output, number)?;
            let scores = eval::against(session, [(&level, style), (model, style)], [0.0; 3])?;
            let psnr = scores.mean().and_then(|mean| mean.psnr);
            let psnr = psnr.map_or_else(|| "equal pictures".to_owned(), |psnr| format!("{psnr:.1} dB"));
            console.note(format_args!("level {number}: {}, {psnr}", counted(level.len(), "Gaussian")));
        }
        let all = counted(levels.len(), "level");
        console.note(format_args!("{all} of {} in {}", counted(model.len(), "Gaussian"), self.output.display()));
        Ok(())
    }

    /// The contents of the page besides its model; with a device, it begins with a picture.
    fn page(
        &self,
        session: Option<&Session<'_>>,
        loaded: &Loaded,
        (style, background): (Style, [f32; 3]),
    ) -> Result<PageOptions, Error> {
        let stem = || self.input.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let title = self.title.clone().filter(|title| !title.trim().is_empty()).unwrap_or_else(stem);
        let mut options = PageOptions { title, background, style, ..PageOptions::default() };
        if let Some(path) = &self.scene {
            let scene = Scene::open(path, &OpenOptions::default())?;
            let first = scene.views.get(scene.ahead(0)).map(|view| &view.camera);
            options.place_in(&scene, first, shift_to(&loaded.gaussians, loaded.origin, &scene));
        }
        options.up = self.up.unwrap_or(options.up);
        if let Some(session) = session {
            let has_room = |uri: &String| self.size.is_none_or(|size| TO_POSTER * uri.len() as u64 <= size);
            options.poster = viewer::poster(session, &loaded.gaussians, &options)?.filter(has_room);
        }
        Ok(options)
    }
}

/// A page without its model, which is moved and scaled where a page needs that.
fn fitted(model: &mut Gaussians, mut options: PageOptions) -> Shell {
    if let Some(fit) = Fit::of(model) {
        fit.apply(model, &mut options);
    }
    Shell::new(model, &options)
}

/// Writes a quantised file; what it costs, for a message.
fn write_measured(
    session: Option<&Session<'_>>,
    (loaded, style): (&Loaded, Style),
    target: &Target<'_>,
    console: &Console,
) -> Result<String, Error> {
    let model = &loaded.gaussians;
    let (packed, cost) = match session {
        Some(session) if !model.is_empty() => {
            let (packed, psnr) = cost::pack(session, model, style, target)?;
            console.tell(poor(target.path, psnr.unwrap_or(f64::INFINITY)));
            let same = || ", pictures are equal".to_owned();
            (packed, psnr.map_or_else(same, |psnr| format!(", {psnr:.1} dB against the original")))
        }
        _ => {
            let precision = target.precision.unwrap_or_else(|| formats::unmeasured(target.format, model));
            let packed = target.pack(model, loaded.mode, precision)?;
            let is_chosen = target.precision.is_none() && !matches!(precision, Precision::Fixed);
            let chosen = if is_chosen { ", precision not chosen by pictures" } else { "" };
            let unknown = format!("{chosen}, loss not measured: there is no Vulkan device");
            (packed, if model.is_empty() { String::new() } else { unknown })
        }
    };
    target.write(Some(packed), model, loaded.mode)?;
    warn_of_clipped(target.path, model, console);
    Ok(cost)
}

/// Warns of Gaussians whose colours or sizes are cut off by the format of a model's file.
pub(super) fn warn_of_clipped(path: &Path, model: &Gaussians, console: &Console) {
    let colours = formats::clip_warning(path, formats::clipped(path, model));
    let sizes = formats::size_warning(path, formats::outsized(path, model));
    for warning in colours.into_iter().chain(sizes) {
        console.warn(warning);
    }
}
