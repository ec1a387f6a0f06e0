//! A bound on float32's error in every gradient of every Gaussian, so that one wrong Gaussian among many does not hide
//! in a norm.
//!
//! A gradient is J s, with s the rasteriser's sums over pixels and J the projection's linear map. Each term of s is
//! bounded by its own size in roundings; |J| |s| follows from the twin, one sum at a time. A term is h = alpha (T q - R
//! / (1 - alpha)), where R, the part behind, is a difference of sums over all layers: its error is a number of
//! roundings of W, the sum of |w q| over all layers, not of R.

use glam::DVec3;
use qirf_vk::kernels::constants::blending::float64::{ALPHA_MAX, ALPHA_MIN};
use qirf_vk::reference::project::Projected;
use qirf_vk::reference::project_backward::project_backward;
use qirf_vk::reference::rasterise::{Sample, sample};
use qirf_vk::reference::rasterise_backward::SlotSums;
use qirf_vk::reference::{Params, Settings, render};
use qirf_vk::scene::camera::Camera;

/// A contribution to a pixel: index in the tile's list, sample, transmittance before it, and |q| <= worth.
struct Layer<'a> {
    place: usize,
    projected: &'a Projected,
    sample: Sample,
    transmittance: f64,
    worth: f64,
    drawn: bool,
    /// True if float32 may draw it and the twin does not, or vice versa, or if float32 may clamp it.
    undecided: bool,
}

impl Layer<'_> {
    fn weight(&self) -> f64 {
        self.transmittance * self.sample.alpha
    }

    /// Bound on |h|, given the total |w q| of the pixel's layers, all of which may lie behind.
    fn term(&self, total: f64) -> f64 {
        self.sample.alpha * (self.transmittance * self.worth + total / (1.0 - self.sample.alpha))
    }
}

/// The error allowed in each gradient of sum(weights . (red, green, blue, alpha)) by the stored parameters; infinite for
/// Gaussians whose colour is so near the clamp at zero that float32 may decide otherwise.
pub fn gradient_bounds(params: &Params, camera: &Camera, settings: &Settings, weights: &[[f64; 4]]) -> Params {
    let rendered = render(params, camera, settings);
    let mut sums = vec![SlotSums::default(); rendered.projected.len()];
    for t in 0..rendered.tiles.offsets.len() - 1 {
        let list = rendered.tiles.list(t);
        let (columns, rows) = rendered.tiles.pixels(t, camera.width, camera.height);
        for y in rows {
            for x in columns.clone() {
                let weights = weights[(y * camera.width + x) as usize];
                let layers = layers(list, &rendered.projected, camera, settings, ([x, y], weights));
                let roundings = roundings(camera, [x, y], layers.len());
                add_pixel(&mut sums, list, &layers, weights, roundings);
            }
        }
    }
    through_projection(params, camera, settings, &sums)
}

/// Relative error of a term. Alpha and offsets suffer from rounded positions, by up to six times their distance in
/// pixels from the picture's middle (see `rasterise`); transmittance and the sum behind suffer from one rounding per
/// layer.
fn roundings(camera: &Camera, [x, y]: [u32; 2], layers: usize) -> f64 {
    let from = |at: u32, size: u32| (f64::from(at) - f64::from(size / 2)).abs();
    let positions = from(x, camera.width) + from(y, camera.height) + camera.focal.max_element();
    2_f64.powi(-24) * (64.0 + (layers as f64).sqrt() + 6.0 * positions)
}

fn layers<'a>(
    list: &[u32],
    projected: &'a [Result<Projected, qirf_vk::reference::project::Culled>],
    camera: &Camera,
    settings: &Settings,
    ([x, y], weights): ([u32; 2], [f64; 4]),
) -> Vec<Layer<'a>> {
    let all = Settings { smooth_cutoff: true, ..settings.clone() };
    let near = |ratio: f64| ratio.ln().abs() < roundings(camera, [x, y], list.len());
    let g = DVec3::new(weights[0], weights[1], weights[2]).abs();
    let (mut transmittance, mut layers) = (1.0, Vec::new());
    for (place, &i) in list.iter().enumerate() {
        let Ok(p) = &projected[i as usize] else { continue };
        let Some(sample) = sample(p, x, y, &all) else { continue };
        let behind = transmittance * (1.0 - sample.alpha);
        let stops = behind < settings.transmittance_stop;
        let drawn = sample.alpha >= ALPHA_MIN;
        let undecided = near(sample.alpha / ALPHA_MIN)
            || near(sample.alpha / ALPHA_MAX)
            || (drawn && near(behind / settings.transmittance_stop));
        let worth = g.dot(p.colour + DVec3::from(settings.background)) + weights[3].abs();
        if drawn || undecided {
            layers.push(Layer { place, projected: p, sample, transmittance, worth, drawn: drawn && !stops, undecided });
        }
        if drawn && stops {
            break;
        }
        if drawn {
            transmittance = behind;
        }
    }
    layers
}

/// Adds the possible errors of a pixel's terms: roundings of each, and the whole effect of undecided layers.
fn add_pixel(sums: &mut [SlotSums], list: &[u32], layers: &[Layer<'_>], weights: [f64; 4], roundings: f64) {
    let total: f64 = layers.iter().filter(|l| l.drawn).map(|l| l.weight() * l.worth).sum();
    for layer in layers {
        let own = if layer.undecided { 1.0 } else { roundings };
        let mut error = own * layer.term(total);
        let mut by_weight = own * layer.weight();
        for other in layers.iter().filter(|other| other.undecided && other.place != layer.place) {
            let alpha = layer.sample.alpha;
            error += other.sample.alpha * layer.term(total) + alpha / (1.0 - alpha) * other.weight() * other.worth;
            by_weight += other.sample.alpha * layer.weight();
        }
        let sum = &mut sums[list[layer.place] as usize];
        let d = layer.sample.offset.abs();
        // An offset of less than a pixel is no more accurate than its position.
        let d = d.max(glam::DVec2::splat(layer.projected.covariance[0].min(layer.projected.covariance[2]).sqrt()));
        sum.zeroth += error;
        sum.first += error * d;
        sum.second =
            [sum.second[0] + error * d.x * d.x, sum.second[1] + error * d.x * d.y, sum.second[2] + error * d.y * d.y];
        let weights = DVec3::new(weights[0], weights[1], weights[2]).abs();
        sum.colour += by_weight * weights;
        sum.contribution += layer.weight() * weights.max_element();
    }
}

/// |J| times the sums: the twin's gradient of one sum at a time, without its sign.
fn through_projection(params: &Params, camera: &Camera, settings: &Settings, sums: &[SlotSums]) -> Params {
    let parts: [fn(&SlotSums) -> SlotSums; 9] = [
        |s| SlotSums { zeroth: s.zeroth, ..SlotSums::default() },
        |s| SlotSums { first: glam::DVec2::new(s.first.x, 0.0), ..SlotSums::default() },
        |s| SlotSums { first: glam::DVec2::new(0.0, s.first.y), ..SlotSums::default() },
        |s| SlotSums { second: [s.second[0], 0.0, 0.0], ..SlotSums::default() },
        |s| SlotSums { second: [0.0, s.second[1], 0.0], ..SlotSums::default() },
        |s| SlotSums { second: [0.0, 0.0, s.second[2]], ..SlotSums::default() },
        |s| SlotSums { colour: DVec3::new(s.colour.x, 0.0, 0.0), ..SlotSums::default() },
        |s| SlotSums { colour: DVec3::new(0.0, s.colour.y, 0.0), ..SlotSums::default() },
        |s| SlotSums { colour: DVec3::new(0.0, 0.0, s.colour.z), ..SlotSums::default() },
    ];
    let mut bounds = params.zeros_like();
    for part in parts {
        let mut one = params.zeros_like();
        for (i, s) in sums.iter().enumerate() {
            project_backward(params, i, camera, settings, &part(s), &mut one);
        }
        for (_, values) in one.groups_mut() {
            for value in values.iter_mut() {
                *value = value.abs();
            }
        }
        bounds.add(&one);
    }
    // A basis function near its zero has the error of the direction, not its own.
    for band in &mut bounds.sh {
        let width = band.len() / sums.len().max(1);
        for (at, bound) in band.iter_mut().enumerate() {
            *bound += 16.0 * 2_f64.powi(-24) * sums[at / width.max(1)].contribution;
        }
    }
    bounds
}

/// Compares each gradient with its bound; returns the largest ratio of an error to its bound. At least `sharp` of the
/// nonzero gradients must exceed three bounds, so that the bounds would detect a missing one.
pub fn within(name: &str, got: &Params, expected: &Params, bounds: &Params, sharp: f64) -> f64 {
    let (mut got, mut expected, mut bounds) = (got.clone(), expected.clone(), bounds.clone());
    let n = expected.opacity_logits.len();
    let (mut worst, mut clear, mut some) = (0.0_f64, 0, 0);
    let all = got.groups_mut().into_iter().zip(expected.groups_mut()).zip(bounds.groups_mut());
    for (((group, got), (_, expected)), (_, bounds)) in all {
        let width = got.len() / n.max(1);
        for (at, ((g, e), b)) in got.iter().zip(&*expected).zip(&*bounds).enumerate() {
            let error = (g - e).abs();
            let i = at / width;
            assert!(error <= *b, "{name}: Gaussian {i}, {group}[{}]: {g:e}, not {e:e} within {b:.1e}", at % width);
            if error > 0.0 {
                worst = worst.max(error / b);
            }
            some += usize::from(*e != 0.0);
            clear += usize::from(e.abs() > 3.0 * b);
        }
    }
    let share = clear as f64 / some.max(1) as f64;
    println!("{name}: largest error {worst:.2} of its bound; {share:.2} of the gradients beyond three bounds");
    assert!(share >= sharp, "{name}: only {share:.2} of the gradients are larger than three bounds");
    worst
}
