//! The forward pass: buffers of one frame, and the list of its stages.

use super::settings::{Settings, tile_size, view};
use super::{bin, project, rasterise};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result, Timings};
use crate::kernels::View;
use crate::primitives::{Count, Pairs, Scan, Sort};
use crate::scene::camera::Camera;

/// The stages of a frame, in order: scope names of its timings.
pub const STAGES: [&str; 5] = ["project", "depth sort", "bin", "tile sort", "rasterise"];

/// A rendered picture on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue (background blended in) and alpha, row by row.
    pub pixels: Vec<[f32; 4]>,
}

/// What a device and settings choose once.
pub(super) struct Shape {
    pub settings: Settings,
    pub tile: u32,
    /// Invocations that walk one tile.
    pub workgroup: u32,
    /// Splats staged in shared memory at a time; 0 for none.
    pub batch: u32,
}

impl Shape {
    fn new(device: &Device, settings: Settings) -> Self {
        let info = device.info();
        let tile = tile_size(info);
        if info.kind == "cpu" {
            // One subgroup walks a tile, its pixels in registers: no barriers, and a splat is read once.
            Self { settings, tile, workgroup: info.subgroup_size, batch: 0 }
        } else {
            Self { settings, tile, workgroup: tile * tile, batch: tile * tile }
        }
    }
}

/// Intermediate arrays of one frame.
pub(super) struct Frame {
    pub view: Buffer<View>,
    pub geometry: Buffer<[f32; 4]>,
    pub shape: Buffer<[f32; 4]>,
    pub colour: Buffer<[f32; 2]>,
    pub depth: Buffer<u32>,
    pub tile_counts: Buffer<u32>,
    pub visible: Buffer<u32>,
    pub offsets: Buffer<u32>,
    pub visible_count: Count,
    pub by_depth: Pairs,
    pub scan: Scan,
    pub depth_sort: Sort,
    pub pairs: PairBuffers,
    pub starts: Buffer<u32>,
    pub image: Buffer<[f32; 4]>,
}

/// What grows with the number of (tile, Gaussian) pairs.
pub(super) struct PairBuffers {
    pub count: Count,
    pub by_tile: Pairs,
    pub owners: Buffer<u32>,
    pub sort: Sort,
}

impl PairBuffers {
    fn new(device: &Device, capacity: u32) -> Result<Self> {
        let sizes = [Sort::block(device, capacity)];
        Ok(Self {
            count: Count::new(device, "pairs", capacity, &sizes)?,
            by_tile: Pairs::new(device, "pairs by tile", capacity)?,
            owners: device.buffer("pair owners", capacity as usize)?,
            sort: Sort::new(device, capacity)?,
        })
    }
}

impl Frame {
    fn new(device: &Device, gaussians: usize, pixels: usize, tiles: usize, pairs: u32) -> Result<Self> {
        let n = gaussians.max(1);
        let sizes = [Scan::block(device), Sort::block(device, n as u32)];
        Ok(Self {
            view: device.buffer("view", 1)?,
            geometry: device.buffer("splat geometry", n)?,
            shape: device.buffer("splat shape", n)?,
            colour: device.buffer("splat colour", n)?,
            depth: device.buffer("depth keys", n)?,
            tile_counts: device.buffer("tile counts", n)?,
            visible: device.buffer("visible flags", n)?,
            offsets: device.buffer("offsets", n)?,
            visible_count: Count::new(device, "visible", n as u32, &sizes)?,
            by_depth: Pairs::new(device, "by depth", n as u32)?,
            scan: Scan::new(device, n as u32)?,
            depth_sort: Sort::new(device, n as u32)?,
            pairs: PairBuffers::new(device, pairs)?,
            starts: device.buffer("tile starts", tiles + 1)?,
            image: device.buffer("image", pixels)?,
        })
    }
}

/// Renders models of up to a number of Gaussians at up to a number of pixels; grows as asked.
pub struct Renderer {
    device: Device,
    shape: Shape,
    frame: Frame,
    gaussians: usize,
}

impl Renderer {
    /// A renderer with room for `gaussians` and one `width` x `height` picture.
    ///
    /// # Errors
    /// Device memory.
    pub fn new(device: &Device, settings: Settings, gaussians: usize, width: u32, height: u32) -> Result<Self> {
        let shape = Shape::new(device, settings);
        let tile = shape.tile;
        let pairs = (gaussians as u32).saturating_mul(4).max(1 << 14);
        let tiles = width.div_ceil(tile) as usize * height.div_ceil(tile) as usize;
        let frame = Frame::new(device, gaussians, width as usize * height as usize, tiles, pairs)?;
        Ok(Self { device: device.clone(), shape, frame, gaussians })
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.shape.settings
    }

    /// Tile side in pixels.
    pub fn tile(&self) -> u32 {
        self.shape.tile
    }

    /// Renders one picture. The only number read back is how many pairs there were, with the picture itself: when they
    /// did not fit, the pair buffers grow and the picture is rendered again.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn render(&mut self, model: &Resident, camera: &Camera) -> Result<Image> {
        self.render_timed(model, camera).map(|(image, _, _)| image)
    }

    /// Renders one picture; also gives the stages' times and the number of (tile, Gaussian) pairs.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn render_timed(&mut self, model: &Resident, camera: &Camera) -> Result<(Image, Timings, u32)> {
        self.make_room(model, camera)?;
        loop {
            let timings = self.draw(model, camera)?;
            let pairs = self.pairs()?;
            if pairs <= self.frame.pairs.count.limit() {
                let pixels = self.frame.image.read_first(&self.device, (camera.width * camera.height) as usize)?;
                return Ok((Image { width: camera.width, height: camera.height, pixels }, timings, pairs));
            }
            self.frame.pairs = PairBuffers::new(&self.device, pairs.saturating_add(pairs / 4))?;
        }
    }

    /// Draws into device memory without reading anything back: what benchmarks time.
    ///
    /// # Errors
    /// Device errors.
    pub fn draw(&self, model: &Resident, camera: &Camera) -> Result<Timings> {
        let mut recording = Recording::new();
        self.record(&mut recording, model, camera);
        self.device.run(recording)
    }

    /// The (tile, Gaussian) pairs that the last picture had, whether they fitted or not.
    ///
    /// # Errors
    /// Device errors.
    pub fn pairs(&self) -> Result<u32> {
        Ok(self.frame.pairs.count.value.read(&self.device)?[1])
    }

    fn make_room(&mut self, model: &Resident, camera: &Camera) -> Result<()> {
        let pixels = camera.width as usize * camera.height as usize;
        if model.len > self.gaussians
            || pixels > self.frame.image.len()
            || self.tiles(camera) >= self.frame.starts.len()
        {
            let gaussians = model.len.max(self.gaussians);
            let pixels = pixels.max(self.frame.image.len());
            let tiles = self.tiles(camera).max(self.frame.starts.len());
            self.frame = Frame::new(&self.device, gaussians, pixels, tiles, self.frame.pairs.count.limit())?;
            self.gaussians = gaussians;
        }
        Ok(())
    }

    fn tiles(&self, camera: &Camera) -> usize {
        camera.width.div_ceil(self.shape.tile) as usize * camera.height.div_ceil(self.shape.tile) as usize
    }

    fn record(&self, recording: &mut Recording, model: &Resident, camera: &Camera) {
        let (shape, frame) = (&self.shape, &self.frame);
        let tiles = self.tiles(camera) as u32;
        recording.update(&frame.view, &[view(camera, &shape.settings, model.degree, shape.tile)]);
        recording.update(&frame.pairs.count.value, &[0, 0]);
        recording.scope(STAGES[0], |r| project::record(r, shape, frame, model));
        let order = recording.scope(STAGES[1], |r| bin::depth_sort(r, frame, model));
        recording.scope(STAGES[2], |r| bin::record(r, shape, frame, order));
        let sorted = recording.scope(STAGES[3], |r| bin::tile_sort(r, frame, tiles));
        recording.scope(STAGES[4], |r| rasterise::record(r, shape, frame, sorted, tiles));
    }
}
