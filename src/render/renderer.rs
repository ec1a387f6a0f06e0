//! Buffers of one frame, and the lists of its stages forward and backward.

use super::frame::{Frame, Launch, PairBuffers, Purpose, Uses};
use super::settings::{Settings, view};
use super::{bin, project, rasterise};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result, Timings};
use crate::scene::camera::Camera;

/// The stages of a frame, in order: scope names of its timings.
pub const STAGES: [&str; 5] = ["project", "depth sort", "bin", "tile sort", "rasterise"];

/// Least initial capacity in (tile, Gaussian) pairs.
pub const LEAST_PAIRS: u32 = 1 << 14;

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

/// The capacities of a renderer before [`Renderer::release`].
#[derive(Clone, Copy, Debug)]
pub struct Released {
    pixels: usize,
    tiles: usize,
    pairs: u32,
}

/// Renders models; its buffers grow with the numbers of Gaussians and pixels. [`super::TrainingRenderer`] also runs the backward pass.
pub struct Renderer {
    pub(super) device: Device,
    pub(super) launch: Launch,
    pub(super) frame: Frame,
    gaussians: usize,
    pub(super) uses: Uses,
}

/// Number of tiles of this side in a picture.
fn tiles(side: u32, [width, height]: [u32; 2]) -> usize {
    width.div_ceil(side) as usize * height.div_ceil(side) as usize
}

impl AsMut<Self> for Renderer {
    fn as_mut(&mut self) -> &mut Self {
        self
    }
}

impl Renderer {
    /// A renderer with room for `gaussians` and one `width` x `height` picture.
    pub fn new(device: &Device, settings: Settings, gaussians: usize, width: u32, height: u32) -> Result<Self> {
        let pairs = (gaussians as u32).saturating_mul(4).max(LEAST_PAIRS);
        Self::with(device, settings, gaussians, [width, height], pairs, Purpose::Pictures)
    }

    pub(super) fn with(
        device: &Device,
        settings: Settings,
        gaussians: usize,
        [width, height]: [u32; 2],
        pairs: u32,
        purpose: Purpose,
    ) -> Result<Self> {
        let launch = Launch::new(device, settings);
        let tiles = tiles(launch.tuning.tile, [width, height]);
        let uses = Uses { purpose, responses: purpose == Purpose::Scores, style: settings.style };
        let frame = Frame::new(device, gaussians, width as usize * height as usize, tiles, pairs, uses)?;
        let renderer = Self { device: device.clone(), launch, frame, gaussians, uses };
        let mut recording = Recording::new();
        renderer.reset_overflow(&mut recording);
        device.run(recording)?;
        Ok(renderer)
    }

    /// Bytes of a renderer with room for the given numbers of Gaussians and pairs, and one `width` x `height` picture.
    pub fn bytes(device: &Device, gaussians: usize, [width, height]: [u32; 2], pairs: u32, uses: Uses) -> u64 {
        let (pixels, tiles) = (width as usize * height as usize, tiles(device.tuning().tile, [width, height]));
        let guards = if uses.purpose == Purpose::Pictures { 0 } else { Buffer::<u32>::bytes_of(2) };
        device.bytes_of(|counts| Frame::new(counts, gaussians, pixels, tiles, pairs, uses)) + guards
    }

    /// The device of this renderer.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.launch.settings
    }

    /// Sets the colour behind the Gaussians of later pictures.
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.launch.settings.background = background;
    }

    /// The uses this renderer was allocated for.
    pub fn uses(&self) -> Uses {
        self.uses
    }

    /// Tile side in pixels.
    pub fn tile(&self) -> u32 {
        self.launch.tuning.tile
    }

    /// Renders one picture. Besides the picture, only the number of pairs is read back: if they did not fit, the pair
    /// buffers grow and the picture is rendered again.
    pub fn render(&mut self, model: &Resident, camera: &Camera) -> Result<Image> {
        self.render_timed(model, camera).map(|(image, _, _)| image)
    }

    /// Number of Gaussians that each pixel blends, row by row. The picture is drawn as in [`Renderer::render`].
    pub fn count_blended(&mut self, model: &Resident, camera: &Camera) -> Result<Vec<u32>> {
        self.launch.count_blended = true;
        let image = self.render(model, camera);
        self.launch.count_blended = false;
        Ok(image?.pixels.iter().map(|p| p[0] as u32).collect())
    }

    /// Makes the green of a pixel the red of the Gaussian with which half of its light is stopped, front to back; 0
    /// where less is stopped. Of a model whose colours are depths, that is the median depth.
    #[must_use]
    pub fn with_medians(mut self) -> Self {
        self.launch.medians = true;
        self
    }

    /// Renders one picture; also returns the stages' times and the number of (tile, Gaussian) pairs.
    pub fn render_timed(&mut self, model: &Resident, camera: &Camera) -> Result<(Image, Timings, u32)> {
        self.make_room(model, camera)?;
        loop {
            let (timings, pairs) = self.draw_counted(model, camera)?;
            if !self.make_room_for_pairs(pairs)? {
                return Ok((self.read_image(camera)?, timings, pairs));
            }
        }
    }

    /// The picture drawn last.
    pub(super) fn read_image(&self, camera: &Camera) -> Result<Image> {
        let pixels = self.frame.image.read_first(&self.device, (camera.width * camera.height) as usize)?;
        Ok(Image { width: camera.width, height: camera.height, pixels })
    }

    /// Draws into device memory without reading anything back; benchmarks time this.
    pub fn draw(&self, model: &Resident, camera: &Camera) -> Result<Timings> {
        self.device.run(self.drawing(model, camera))
    }

    /// Draws as [`Renderer::draw`] does, and returns what [`Renderer::run`] returns.
    pub(super) fn draw_counted(&self, model: &Resident, camera: &Camera) -> Result<(Timings, u32)> {
        self.run(self.drawing(model, camera))
    }

    fn drawing(&self, model: &Resident, camera: &Camera) -> Recording {
        let mut recording = Recording::new();
        self.reset_overflow(&mut recording);
        self.record(&mut recording, model, camera);
        recording
    }

    /// Runs the recording of a picture. Returns the time of its scopes, and the picture's number of (tile, Gaussian) pairs,
    /// even if they did not fit: one wait brings both.
    pub fn run(&self, recording: Recording) -> Result<(Timings, u32)> {
        let pairs = &self.frame.pairs.count.value;
        let mut seen = self.device.readback("pairs seen", pairs.len())?;
        seen.submit(&self.device, recording, &[(pairs, pairs.len())])?;
        let (words, timings) = seen.wait()?;
        Ok((timings, words[1]))
    }

    /// Number of (tile, Gaussian) pairs of the last picture, even if they did not fit.
    pub fn pairs(&self) -> Result<u32> {
        Ok(self.frame.pairs.count.value.read(&self.device)?[1])
    }

    /// Makes room for a model and a picture, which may need nearly all of the device: the old buffers are freed first. The
    /// next recording begins with [`Renderer::reset_overflow`].
    pub fn make_room(&mut self, model: &Resident, camera: &Camera) -> Result<()> {
        let pixels = camera.width as usize * camera.height as usize;
        let (had, tiles) = (self.frame.image.len(), self.tiles(camera));
        if model.len > self.gaussians || pixels > had || tiles > self.frame.tiles() {
            let (gaussians, pairs) = (model.len.max(self.gaussians), self.frame.pairs.count.limit());
            let tiles = tiles.max(self.frame.tiles());
            self.release()?;
            self.rebuild(gaussians, pixels.max(had), tiles, pairs)?;
        }
        Ok(())
    }

    /// Frees the buffers until [`Renderer::restore`], so that other work has memory.
    pub fn release(&mut self) -> Result<Released> {
        let (pixels, tiles) = (self.frame.image.len(), self.frame.tiles());
        let released = Released { pixels, tiles, pairs: self.frame.pairs.count.limit() };
        self.rebuild(1, 1, 1, 1)?;
        Ok(released)
    }

    /// Restores room for pictures and pairs as before [`Renderer::release`], and for `gaussians` Gaussians. The next recording
    /// begins with [`Renderer::reset_overflow`].
    pub fn restore(&mut self, released: Released, gaussians: usize) -> Result<()> {
        self.rebuild(gaussians, released.pixels, released.tiles, released.pairs)
    }

    fn rebuild(&mut self, gaussians: usize, pixels: usize, tiles: usize, pairs: u32) -> Result<()> {
        self.frame = Frame::new(&self.device, gaussians, pixels, tiles, pairs, self.uses)?;
        self.gaussians = gaussians;
        Ok(())
    }

    /// Records the reset of the pair buffers' overflow, which is undefined in buffers that were made anew. If pairs do not fit
    /// from then on, all later iterations have no effect.
    pub fn reset_overflow(&self, recording: &mut Recording) {
        self.frame.pairs.count.reset(recording);
    }

    pub(super) fn tiles(&self, camera: &Camera) -> usize {
        tiles(self.tile(), [camera.width, camera.height])
    }

    /// Records the forward pass of one picture.
    pub fn record(&self, recording: &mut Recording, model: &Resident, camera: &Camera) {
        self.record_lists(recording, model, camera);
        self.record_blending(recording, camera);
    }

    /// Records the first part of a forward pass: each tile's list of Gaussians.
    pub fn record_lists(&self, recording: &mut Recording, model: &Resident, camera: &Camera) {
        let (launch, frame) = (&self.launch, &self.frame);
        let tiles = self.tiles(camera) as u32;
        recording.update(&frame.view, &[view(camera, &launch.settings, model.degree, launch.tuning.tile)]);
        recording.scope(STAGES[0], |r| project::record(r, launch, frame, model));
        let order = recording.scope(STAGES[1], |r| bin::depth_sort(r, launch, frame, model));
        recording.scope(STAGES[2], |r| bin::record(r, launch, frame, model, order));
        bin::depth_order(recording, frame);
        recording.scope(STAGES[3], |r| bin::tile_sort(r, frame, tiles));
    }

    /// Records the rest of the forward pass: the picture, from the lists of [`Renderer::record_lists`].
    pub fn record_blending(&self, recording: &mut Recording, camera: &Camera) {
        let (launch, frame) = (&self.launch, &self.frame);
        let tiles = self.tiles(camera) as u32;
        recording.scope(STAGES[4], |r| rasterise::record(r, launch, frame, bin::sorted(frame, tiles), tiles));
    }

    /// The picture drawn last, in device memory: row by row, red, green, blue, alpha.
    pub fn image(&self) -> &Buffer<[f32; 4]> {
        &self.frame.image
    }

    /// Makes room for at least `pairs` pairs. Returns true if the buffers were replaced, which invalidates earlier
    /// recordings; the next one begins with [`Renderer::reset_overflow`].
    pub fn make_room_for_pairs(&mut self, pairs: u32) -> Result<bool> {
        let grow = pairs > self.frame.pairs.count.limit();
        if grow {
            let room = |pairs: u32| PairBuffers::new(&self.device, pairs, self.uses);
            // The old lists go first; after an error there are none until the next picture asks for room.
            self.frame.pairs = room(1)?;
            // A quarter more, if it fits, avoids growing again soon.
            self.frame.pairs = match room(pairs.saturating_add(pairs / 4)) {
                Err(error) if error.is_resources() => room(pairs)?,
                made => made?,
            };
        }
        Ok(grow)
    }
}
