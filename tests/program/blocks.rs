//! A scene trained in blocks, by the parts that a cluster's tasks call: coarse model, cells, shares of views, crops, frozen
//! surroundings, and what each block hands on.

use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::cells::{Cells, Contraction};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gpu::{Device, DeviceOptions};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::Session;
use qirf_vk::pipeline::blocks::{GROWN, Layout, Members, joined, owned, seen, with_tail};
use qirf_vk::render::{Renderer, Settings};
use qirf_vk::response::Wanted;
use qirf_vk::scene::camera::{Camera, mean_centre};
use qirf_vk::scene::{LoadOptions, OpenOptions, Photo, Point, Scene};
use qirf_vk::synth::{self, Kind, SynthOptions};
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::initialise::{Seed, from_points};
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer};

const COARSE: u32 = 120;
const DENSE: u32 = 240;
const TUNE: u32 = 60;

/// A strip of land: its photos, a model of its points, the extent and the mean of its cameras.
struct Land {
    photos: Vec<Photo>,
    start: Gaussians,
    extent: f64,
    cameras: [f32; 3],
}

impl Land {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let options = SynthOptions {
            kind: Kind::Terrain,
            views: 24,
            width: 80,
            height: 60,
            points: 1500,
            ..SynthOptions::default()
        };
        synth::write(folder.path(), &options, &|_| ()).unwrap();
        let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| ()).unwrap();
        let colour = |p: &Point| DVec3::from(p.colour.map(|c| f64::from(c) / 255.0));
        let seeds: Vec<Seed> = scene.points.iter().map(|p| Seed { position: p.position, colour: colour(p) }).collect();
        let cameras = mean_centre(photos.iter().map(|p| &p.camera)).as_vec3().to_array();
        let extent = scene.extent(&(0..photos.len()).collect::<Vec<_>>());
        Self { photos, start: from_points(&seeds), extent, cameras }
    }

    fn options(&self, iterations: u32, tail: usize, views: usize) -> Options {
        let schedule = Schedule { iterations, densify_until: 0.0, position_rate_end: 1.6e-5, ..Schedule::default() };
        let schedule = schedule.for_block(views, self.photos.len());
        Options { schedule, degree: 1, tail, cameras: Some(self.cameras), ..Options::default() }
    }

    fn cameras(&self) -> Vec<Camera> {
        self.photos.iter().map(|p| p.camera.clone()).collect()
    }

    /// Mean PSNR of a model over all photos, in dB.
    fn psnr(&self, device: &Device, model: &Gaussians) -> f64 {
        let resident = Resident::upload(device, model).unwrap();
        let mut renderer = Renderer::new(device, Settings::default(), model.len(), 80, 60).unwrap();
        let one = |photo: &Photo| {
            let image = renderer.render(&resident, &photo.camera).unwrap();
            let pixels = photo.pixels.read().unwrap();
            let colours = image.pixels.iter().zip(pixels.chunks_exact(4));
            let squares: f64 = colours
                .flat_map(|(a, b)| (0..3).map(|c| (f64::from(a[c].clamp(0.0, 1.0)) - f64::from(b[c]) / 255.0).powi(2)))
                .sum();
            -10.0 * (squares / (3.0 * 4800.0)).log10()
        };
        self.photos.iter().map(one).sum::<f64>() / self.photos.len() as f64
    }
}

fn train(trainer: &mut Trainer, until: u32) -> Snapshot {
    while trainer.iteration() < until {
        trainer.advance(until).unwrap();
    }
    trainer.snapshot().unwrap()
}

#[test]
fn a_strip_trained_in_blocks_is_as_good_as_in_one_piece() {
    let device = Device::open(&DeviceOptions { validation: true, ..DeviceOptions::default() }).unwrap();
    let networks = Networks::default();
    let session = Session::new(&device, &networks);
    let land = Land::new();
    let new = |model: &Gaussians, photos: Vec<Photo>, options: Options| {
        Trainer::new(&device, model, photos, land.extent, options).unwrap()
    };

    let mut trainer = new(&land.start, land.photos.clone(), land.options(COARSE, 0, 24));
    let coarse = train(&mut trainer, COARSE).model;
    let weights: Vec<f32> = trainer.responses(Wanted::SCORES).unwrap().scores.iter().map(|score| score.hits).collect();
    drop(trainer);
    let centres = land.photos.iter().map(|p| p.camera.centre());
    let cells = Cells::new(Contraction::around(centres), &coarse.means, &weights, 3);
    assert_eq!(cells.count(), 3);
    let owners = cells.owners(&coarse.means);
    let seen = seen(&session, &coarse, (&owners, 3), &land.cameras(), Settings::default()).unwrap();

    // Each block trains on the parts of photos that show it, before the rest of the coarse model.
    let layout = Layout::new(cells.clone(), &coarse, &weights, &land.cameras(), &seen);
    let photos_of = |cell: usize| -> Vec<Photo> {
        layout.blocks[cell]
            .crops
            .iter()
            .map(|crop| land.photos[crop.view].part(crop.corner, crop.size).unwrap())
            .collect()
    };
    // As often as in one piece, each photo is trained on.
    let epochs = |iterations: u32, photos: usize| iterations * photos as u32 / 24;
    let dense: Vec<Snapshot> = (0..3)
        .map(|cell| {
            let members = Members::of(&cells, cell, GROWN, &coarse);
            let photos = photos_of(cell);
            assert!((3..24).contains(&photos.len()), "{} photos of block {cell}", photos.len());
            let until = epochs(DENSE, photos.len());
            let options = land.options(until, members.seen.len(), photos.len());
            let mut trainer = new(&members.arranged(&coarse), photos, options);
            owned(&train(&mut trainer, until), &cells, cell)
        })
        .collect();
    let omega = layout.omega;
    let (gathered, starts) = joined(&dense);

    // From here blocks own Gaussians by number: each goes on before its real neighbours.
    let tuned: Vec<Snapshot> = (0..3)
        .map(|b| {
            let rows = starts[b]..starts[b] + dense[b].model.len();
            let others = gathered.select(&(0..gathered.len()).filter(|i| !rows.contains(i)).collect::<Vec<_>>());
            let state = with_tail(&dense[b], &others);
            let photos = photos_of(b);
            let until = state.iteration + epochs(TUNE, photos.len());
            let options = land.options(until, 0, photos.len());
            let mut trainer = Trainer::resume(&device, &state, photos, land.extent, options).unwrap();
            train(&mut trainer, until)
        })
        .collect();
    let (scene, _) = joined(&tuned);
    assert_eq!(scene.len(), gathered.len());

    let mut single = new(&coarse, land.photos.clone(), land.options(DENSE + TUNE, 0, 24));
    let single = train(&mut single, DENSE + TUNE).model;
    let psnr = |model: &Gaussians| land.psnr(&device, model);
    let [start, dense, blocks, single] = [&coarse, &gathered, &scene, &single].map(psnr);
    println!(
        "coarse {start:.2} dB; in blocks {dense:.2}, tuned {blocks:.2}; in one piece {single:.2}; omega {omega:.2}, {} of {} Gaussians",
        scene.len(),
        coarse.len()
    );
    assert!(blocks > start + 1.0 && blocks > single - 0.5, "{start:.2} {dense:.2} {blocks:.2} {single:.2}");
    assert!(blocks > dense, "real neighbours are better than coarse ones: {dense:.2} {blocks:.2}");
    assert!(omega < 2.5, "{omega:.2}");
    assert_eq!(Device::validation_messages(), 0);
}
