//! Ray-traces the embedded scene on the CPU into a capture of photos, cameras and points; nothing is downloaded.
//!
//! The folder looks like a COLMAP project: `images/*.png`, `sparse/0/{cameras,images,points3D}.txt`, `masks/*.png` if
//! something moves, and `synth.json`, which records the options. Equal options give equal bytes on any number of
//! threads.

mod builder;
mod bvh;
mod colmap;
mod dots;
mod error;
mod folder;
mod geometry;
mod lens;
mod materials;
mod noise;
mod options;
mod path;
mod place;
mod plaza;
mod points;
mod random;
mod render;
mod shade;
mod sky;
mod terrain;
mod tiles;

use std::{
    fs,
    path::Path,
    sync::atomic::{AtomicU64, Ordering},
};

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use self::{colmap::Point, path::View, place::Place, render::Picture};
pub use self::{
    error::Error,
    lens::Calibration,
    options::{Effect, Kind, SynthOptions},
};

/// Counts of a synthetic capture.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthReport {
    /// Number of photos.
    pub photos: usize,
    /// Number of photos that the evaluation protocol (every 8th name) holds out.
    pub test_photos: usize,
    /// Number of points in `points3D.txt`.
    pub points: usize,
    /// Number of observations of points in `images.txt`.
    pub observations: usize,
    /// Share of the photos' pixels that the masks hide, 0..=1.
    pub masked: f64,
    /// The scene's effects, besides view-dependent colour.
    pub effects: Vec<Effect>,
}

/// Writes the synthetic scene into `dir`, which must be new, empty or an earlier synth scene.
///
/// `progress` is called after each photo with the number of photos finished so far.
///
/// # Errors
/// Options out of range, a folder that holds anything else (nothing is written then), or a file that cannot be written.
pub fn write(dir: &Path, options: &SynthOptions, progress: &(dyn Fn(u64) + Sync)) -> Result<SynthReport, Error> {
    options.check()?;
    let devices = path::devices(options)?;
    let views = path::views(options, &devices);
    folder::prepare(dir)?;
    folder::mark(dir, options, &views, false)?;
    for (folder, wanted) in [("masks", options.has(Effect::Masks)), ("depth", options.depth)] {
        let folder = dir.join(folder);
        if wanted {
            fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
        }
    }

    let (points, masked) = match options.kind {
        Kind::Dots => (dotted(dir, &views, options, progress)?, 0.0),
        _ => traced(dir, &views, options, progress)?,
    };
    colmap::write(&dir.join("sparse/0"), &devices, &views, &points)?;
    folder::mark(dir, options, &views, true)?;
    Ok(SynthReport {
        photos: views.len(),
        test_photos: (0..views.len()).filter(|&i| View::is_test(i)).count(),
        points: points.len(),
        observations: points.iter().map(|p| p.seen.len()).sum(),
        masked,
        effects: options.sorted_effects(),
    })
}

/// Writes photos of dots, and returns the dots that they show.
fn dotted(
    dir: &Path,
    views: &[View],
    options: &SynthOptions,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Vec<Point>, Error> {
    let (places, done) = (dots::places(options.points), AtomicU64::new(0));
    let photo = |view: &View| {
        let (photo, shown) = dots::picture(view, &places);
        save(dir, view, &photo, options)?;
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        Ok(shown)
    };
    let shown: Vec<Vec<Option<DVec2>>> = views.par_iter().map(photo).collect::<Result<_, Error>>()?;
    let point = |(i, position): (usize, &DVec3)| {
        let seen = shown.iter().enumerate().filter_map(|(view, dots)| Some((view, dots[i]?))).collect();
        Point { position: *position, colour: [255; 3], seen }
    };
    Ok(places.iter().enumerate().map(point).filter(|point| !point.seen.is_empty()).collect())
}

/// Writes ray-traced photos, with masks and depth maps; returns surface points, and the share of the photos' pixels that masks hide.
fn traced(
    dir: &Path,
    views: &[View],
    options: &SynthOptions,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<(Vec<Point>, f64), Error> {
    let place = Place::new(options);
    let mut candidates = points::candidates(&place, views, options);
    let mut wanted: Vec<Vec<DVec2>> = vec![Vec::new(); views.len()];
    for candidate in &candidates {
        for &(view, pixel) in &candidate.seen {
            wanted[view].push(pixel);
        }
    }

    let done = AtomicU64::new(0);
    let colours = (0..views.len())
        .into_par_iter()
        .map(|i| {
            let photo = render::picture(&place, &views[i], options, i);
            save(dir, &views[i], &photo, options)?;
            progress(done.fetch_add(1, Ordering::Relaxed) + 1);
            let hidden = photo.mask.iter().filter(|free| !**free).count() as f64 / photo.pixels.len() as f64;
            Ok((wanted[i].iter().map(|&pixel| photo.colour_at(pixel)).collect::<Vec<_>>(), hidden))
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let masked = colours.iter().map(|(_, hidden)| hidden).sum::<f64>() / views.len() as f64;

    // Candidates list their views in the order in which each view listed its pixels.
    let mut next = vec![0usize; views.len()];
    let needed = 2.min(views.len());
    let points = candidates
        .drain(..)
        .filter_map(|candidate| {
            let (mut sum, mut seen) = ([0.0; 3], Vec::with_capacity(candidate.seen.len()));
            for (view, pixel) in candidate.seen {
                let colour = colours[view].0[next[view]];
                next[view] += 1;
                if let Some(colour) = colour {
                    sum = std::array::from_fn(|c| sum[c] + colour[c]);
                    seen.push((view, pixel));
                }
            }
            let colour = sum.map(|s: f32| (s / seen.len().max(1) as f32 + 0.5) as u8);
            (seen.len() >= needed).then_some(Point { position: candidate.position, colour, seen })
        })
        .collect();
    Ok((points, masked))
}

/// A file of NumPy: its header fills a multiple of 64 bytes.
fn npy([rows, columns]: [u32; 2], values: &[f32]) -> Vec<u8> {
    let head = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    let len = (10 + head.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((len as u16).to_le_bytes());
    bytes.extend(format!("{head:<width$}\n", width = len - 1).bytes());
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

/// Writes a photo, its mask if it has one, and its depth map if asked for, under the same name.
fn save(dir: &Path, view: &View, photo: &Picture, options: &SynthOptions) -> Result<(), Error> {
    let picture = |path: &Path, bytes: &[u8], kind| {
        image::save_buffer_with_format(path, bytes, photo.width, photo.height, kind, image::ImageFormat::Png)
            .map_err(|source| Error::Picture { path: path.to_path_buf(), source })
    };
    let path = dir.join("images").join(&view.name);
    if options.has(Effect::Alpha) {
        picture(&path, photo.pixels.as_flattened(), image::ExtendedColorType::Rgba8)?;
    } else {
        let rgb: Vec<u8> = photo.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
        picture(&path, &rgb, image::ExtendedColorType::Rgb8)?;
    }
    if !photo.mask.is_empty() {
        let grey: Vec<u8> = photo.mask.iter().map(|&free| if free { 255 } else { 0 }).collect();
        picture(&dir.join("masks").join(&view.name), &grey, image::ExtendedColorType::L8)?;
    }
    if !photo.depths.is_empty() {
        let path = dir.join("depth").join(view.name.replace(".png", ".npy"));
        fs::write(&path, npy([photo.height, photo.width], &photo.depths)).map_err(Error::io(&path))?;
    }
    Ok(())
}
