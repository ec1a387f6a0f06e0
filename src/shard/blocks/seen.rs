//! Visibility of each block in each view.

use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::{Error, Session, Stage};
use crate::pipeline::pair_capacity;
use crate::render::{Settings, TrainingRenderer};
use crate::response::{Score, Views, Wanted, full_pass};
use crate::scene::camera::{self, Camera};
use crate::shard::kd_tree::Cells;
use glam::DVec3;

/// Least share of a view's picture that a block must contribute for the view to train it: in general, and if the camera
/// is in the block's cell.
const LEAST: f64 = 0.02;
const LEAST_INSIDE: f64 = 0.005;
/// Margin in pixels around a block's part of a picture.
const MARGIN: f64 = 16.0;
/// Corners of parts of pictures are multiples of this: the largest side of a tile, so that parts have the whole
/// picture's pixels.
const STEP: u32 = 16;
/// Share of a block's contribution that may lie beyond each side of its rectangle, so that single large Gaussians do
/// not decide it.
const STRAYS: f64 = 0.005;
/// Radius of a Gaussian's rectangle in standard deviations.
const WIDTH: f64 = 3.0;

/// Visibility of a block in a view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BlockVisibility {
    /// Sum of T alpha of the block's Gaussians over the picture's pixels.
    pub share: f64,
    /// The part of the picture that contains the block, with a margin: upper left corner and size in pixels; `None` if
    /// the view does not show it.
    pub part: Option<([u32; 2], [u32; 2])>,
}

impl BlockVisibility {
    /// True if the view is to train the block; `inside` is true if its camera is in the block's grown cell.
    pub fn trains(&self, inside: bool) -> bool {
        self.part.is_some() && self.share >= if inside { LEAST_INSIDE } else { LEAST }
    }
}

/// By view: the visibility of each block.
pub type Seen = Vec<Vec<BlockVisibility>>;

/// Draws `model` from each camera, at the size of the second list, and adds up the contributions of its blocks.
///
/// # Panics
/// If there is not one small camera per camera.
pub fn seen(
    session: &Session<'_>,
    model: &Gaussians,
    cells: &Cells,
    cameras: &[Camera],
    small: &[Camera],
    settings: Settings,
) -> Result<Seen, Error> {
    assert_eq!(small.len(), cameras.len(), "one size a camera");
    let (owners, blocks) = (cells.owners(&model.means), cells.count());
    let Session { device, watcher, .. } = *session;
    let resident = Resident::upload(device, model)?;
    let size = camera::largest(small);
    let pairs = pair_capacity::initial(device, model.len());
    let mut renderer = TrainingRenderer::for_scores(device, settings, model.len(), size, pairs)?;
    let gradient = device.buffer("image gradient", 1)?;
    let mut rows = Vec::with_capacity(cameras.len());
    for (done, (camera, drawn)) in cameras.iter().zip(small).enumerate() {
        watcher.progress(Stage::Responses, done, cameras.len());
        watcher.unless_stopped()?;
        let views = Views { cameras: std::slice::from_ref(drawn), follow: |_| Ok::<(), Error>(()), of: None };
        let responses = full_pass(&mut renderer, &resident, views, &gradient, Wanted::SCORES, |_, _, _, _| Ok(()))?;
        rows.push(of_view(model, &responses.scores, &owners, blocks, camera, drawn.pixels()));
    }
    watcher.progress(Stage::Responses, cameras.len(), cameras.len());
    Ok(rows)
}

/// Visibility of each block in one view, from the scores of its picture with this number of pixels.
fn of_view(
    model: &Gaussians,
    scores: &[Score],
    owners: &[u32],
    blocks: usize,
    camera: &Camera,
    pixels: u64,
) -> Vec<BlockVisibility> {
    let mut painted: Vec<Vec<Painted>> = vec![Vec::new(); blocks];
    for (i, score) in scores.iter().enumerate().filter(|(_, score)| score.contribution > 0.0) {
        let Some(of_block) = painted.get_mut(owners[i] as usize) else { continue };
        of_block.extend(Painted::of(model, i, f64::from(score.contribution), camera));
    }
    let shown = |of_block: &Vec<Painted>| {
        let sum: f64 = of_block.iter().map(|p| p.weight).sum();
        BlockVisibility { share: sum / pixels as f64, part: part(of_block, sum, camera) }
    };
    painted.iter().map(shown).collect()
}

/// The rectangle of a Gaussian in a picture, in pixels, and its contribution there.
#[derive(Clone, Copy)]
struct Painted {
    low: [f64; 2],
    high: [f64; 2],
    weight: f64,
}

impl Painted {
    fn of(model: &Gaussians, i: usize, weight: f64, camera: &Camera) -> Option<Self> {
        let local = camera.rotation * DVec3::from(model.means[i].map(f64::from)) + camera.translation;
        let largest = model.log_scales[i].iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let radius = WIDTH * f64::from(largest).exp() / local.z;
        let middle = local.truncate() / local.z;
        let edge =
            |sign: f64, axis: usize| (middle[axis] + sign * radius) * camera.focal[axis] + camera.principal[axis];
        let painted = Self { low: [edge(-1.0, 0), edge(-1.0, 1)], high: [edge(1.0, 0), edge(1.0, 1)], weight };
        (local.z > 0.0 && painted.low.iter().chain(&painted.high).all(|v| v.is_finite())).then_some(painted)
    }
}

/// The rectangle that contains a block's contribution, `sum` in all, except strays, with its margin.
fn part(painted: &[Painted], sum: f64, camera: &Camera) -> Option<([u32; 2], [u32; 2])> {
    if painted.is_empty() {
        return None;
    }
    let beyond = |mut edges: Vec<(f64, f64)>| {
        edges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut passed = 0.0;
        let at = edges.iter().position(|(_, weight)| {
            passed += weight;
            passed > STRAYS * sum
        });
        edges[at.unwrap_or(0)].0
    };
    let (mut corner, mut size) = ([0; 2], [0; 2]);
    for (axis, length) in [camera.width, camera.height].into_iter().enumerate() {
        let low = beyond(painted.iter().map(|p| (p.low[axis], p.weight)).collect());
        let high = -beyond(painted.iter().map(|p| (-p.high[axis], p.weight)).collect());
        let first = (low - MARGIN).clamp(0.0, f64::from(length)) as u32 / STEP * STEP;
        let last = ((high + MARGIN).clamp(0.0, f64::from(length)) as u32).next_multiple_of(STEP).min(length);
        if first >= last {
            return None;
        }
        (corner[axis], size[axis]) = (first, last - first);
    }
    Some((corner, size))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two spots before a camera that looks along z: block 0 on the left, block 1 on the right; one more that is not
    /// visible.
    fn view() -> (Gaussians, Vec<Score>, Camera) {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::Z, DVec3::NEG_Y, 1.0, 320, 240);
        let mut model = Gaussians::zeroed(3, 0);
        model.means = vec![[-0.5, 0.0, 2.0], [0.5, 0.2, 2.0], [0.0, 0.0, -1.0]];
        model.log_scales = vec![[0.05_f32.ln(); 3]; 3];
        let score = |contribution: f32| Score { contribution, ..Score::default() };
        (model, vec![score(3000.0), score(600.0), score(0.0)], camera)
    }

    #[test]
    fn shares_and_rectangles_of_blocks() {
        let (model, scores, camera) = view();
        let shown = of_view(&model, &scores, &[0, 1, 2], 3, &camera, camera.pixels());
        let pixels = 320.0 * 240.0;
        assert_eq!([shown[0].share, shown[1].share, shown[2].share], [3000.0 / pixels, 600.0 / pixels, 0.0]);
        assert!(shown[0].trains(false) && !shown[1].trains(false) && shown[1].trains(true) && !shown[2].trains(true));
        // Focal length 219.7: the left spot is 54.9 px left of the middle, and 16.5 px in radius.
        assert_eq!(shown[0].part, Some(([64, 80], [80, 80])));
        assert_eq!(shown[2].part, None);
        let (corner, size) = shown[1].part.unwrap();
        assert!(corner[0] >= 160 && corner[0] % 16 == 0 && corner[0] + size[0] <= 320, "{corner:?} {size:?}");
    }

    #[test]
    fn strays_do_not_widen_a_rectangle_and_pictures_bound_it() {
        let (mut model, mut scores, camera) = view();
        let owners = [0, 0, 0];
        model.means[1] = [1.2, 0.9, 2.0];
        scores[1].contribution = 1.0;
        assert_eq!(of_view(&model, &scores, &owners, 1, &camera, camera.pixels())[0].part, Some(([64, 80], [80, 80])));
        scores[1].contribution = 300.0;
        let (corner, size) = of_view(&model, &scores, &owners, 1, &camera, camera.pixels())[0].part.unwrap();
        assert_eq!((corner, [corner[0] + size[0], corner[1] + size[1]]), ([64, 80], [320, 240]));
        model.log_scales[0] = [f32::INFINITY; 3];
        model.means[1] = [f32::NAN; 3];
        assert_eq!(
            of_view(&model, &scores, &owners, 1, &camera, camera.pixels())[0],
            BlockVisibility::default(),
            "what is not finite paints nothing"
        );
    }
}
