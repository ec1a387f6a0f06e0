//! Responses on the device, against the float64 twin.

use bytemuck::cast_slice;

use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish};
use qirf_vk::gaussians::{Gaussians, resident::Resident};
use qirf_vk::gpu::{Buffer, Device, Error, Recording};
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Backward, BackwardCounts, Settings, TrainingRenderer};
use qirf_vk::response::{
    Gather, HighPass, KEEP, ResidentResponses, ResidentScores, Score, Target, Term, Views, Wanted, full_pass,
    record_residual,
};
use qirf_vk::scene::AlphaRole;
use qirf_vk::scene::camera::Camera;

const SIZE: [u32; 2] = [45, 37];
/// Index of the peak among the scores.
const PEAK: usize = 1;

/// Two cameras; the second is moved, so that the views differ.
fn cameras() -> [Camera; 2] {
    let first = small_camera(SIZE[0], SIZE[1]);
    let mut second = first.clone();
    second.translation += glam::DVec3::new(1.1, -0.3, 0.4);
    [first, second]
}

fn image_weights(seed: u64) -> Vec<[f32; 4]> {
    let mut r = Random(seed);
    let mut weight = |low: f64| r.within(low, 1.0) as f32;
    (0..SIZE[0] * SIZE[1]).map(|_| [weight(-1.0), weight(-1.0), weight(-1.0), weight(0.0)]).collect()
}

/// Compares each channel, by its error relative to the channel's norm over the Gaussians.
fn compare<const N: usize>(name: &str, got: &[[f32; N]], expected: &[[f64; N]], allowed: f64) {
    assert_eq!(got.len(), expected.len());
    for k in 0..N {
        let pairs: Vec<(f64, f64)> = got.iter().zip(expected).map(|(g, e)| (f64::from(g[k]), e[k])).collect();
        let size: f64 = pairs.iter().map(|(_, e)| e * e).sum();
        let error: f64 = pairs.iter().map(|(g, e)| (g - e).powi(2)).sum();
        let relative = (error / size.max(f64::MIN_POSITIVE)).sqrt();
        println!("{name}, channel {k}: relative error {relative:.1e}");
        assert!(size > 0.0 && relative <= allowed, "{name}, channel {k}: {relative:.1e}");
    }
}

/// The pass over both views with given gradients and residuals, with an initial capacity of `pairs`.
fn pass(device: &Device, model: &Gaussians, pairs: u32) -> (Vec<[f32; 8]>, Vec<Score>) {
    let cameras = cameras();
    let resident = Resident::upload(device, model).unwrap();
    let mut renderer = TrainingRenderer::new(device, Settings::default(), model.len(), SIZE, pairs).unwrap();
    let weights: Vec<Buffer<[f32; 4]>> = (0..2).map(|v| device.upload("weights", &image_weights(v)).unwrap()).collect();
    let gradient = device.buffer("image gradient", image_weights(0).len()).unwrap();
    // The scores' residuals are the other view's gradients.
    let loss = |r: &mut Recording, v: usize, _: &Buffer<[f32; 4]>, term: Term| {
        r.copy(&weights[if term == Term::Loss { v } else { 1 - v }], &gradient, gradient.len());
        Ok::<(), Error>(())
    };
    let wanted = Wanted { residual: true, ..Wanted::BOTH };
    let views = Views { cameras: &cameras, follow: |_| Ok(()), of: None };
    let responses = full_pass(&mut renderer, &resident, views, &gradient, wanted, loss).unwrap();
    assert!(responses.cameras == cameras && responses.dilation == Settings::default().dilation);
    let after = resident.download(device).unwrap();
    assert_eq!(&after, model, "the model does not change");
    (responses.channels, responses.scores)
}

/// Responses and scores of the twin.
fn twin(model: &Gaussians, v: usize) -> (Vec<[f64; 8]>, Vec<[f64; 10]>) {
    let weights = image_weights(v as u64);
    let by_image: Vec<[f64; 3]> = weights.iter().map(|w| [w[0], w[1], w[2]].map(f64::from)).collect();
    let residual: Vec<f64> = weights.iter().map(|w| f64::from(w[3])).collect();
    let (params, camera, settings) = (Params::from(model), &cameras()[v], reference::Settings::default());
    let channels = reference::respond::respond(&params, camera, &settings, &by_image, &residual);
    let others: Vec<[f64; 3]> = image_weights(1 - v as u64).iter().map(|w| [w[0], w[1], w[2]].map(f64::from)).collect();
    let flat = |s: reference::score::Score| {
        let values = s.weights.into_iter().chain(s.changes).chain(s.behind);
        values.collect::<Vec<_>>().try_into().expect("ten numbers")
    };
    (channels, reference::score::score(&params, camera, &settings, &others).into_iter().map(flat).collect())
}

#[test]
fn respond_and_score_over_a_full_pass_are_the_twins_mean() {
    let device = device();
    for seed in [2, 5] {
        let model = narrowed(&random_scene(&cameras()[0], seed));
        let (values, scores) = pass(&device, &model, 8);
        let [first, second] = [0, 1].map(|v| twin(&model, v));
        let mean: Vec<[f64; 8]> =
            first.0.iter().zip(&second.0).map(|(a, b)| std::array::from_fn(|k| 0.5 * (a[k] + b[k]))).collect();
        compare(&format!("seed {seed}"), &values, &mean, 3e-4);
        let add = |(a, b): (&[f64; 10], &[f64; 10])| -> [f64; 10] {
            std::array::from_fn(|k| if k == PEAK { a[k].max(b[k]) } else { a[k] + b[k] })
        };
        let both: Vec<[f64; 10]> = first.1.iter().zip(&second.1).map(add).collect();
        let flat = |s: &Score| {
            let [x, y, z] = s.behind;
            [s.contribution, s.peak, s.hits, s.significance, s.squares, s.change, s.along_residual, x, y, z]
        };
        compare(&format!("seed {seed}, scores"), &scores.iter().map(flat).collect::<Vec<_>>(), &both, 3e-4);
        // Neither another capacity nor a second run changes a bit.
        let (again, again_scores) = pass(&device, &model, 1 << 14);
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same(values.as_flattened(), again.as_flattened()));
        assert!(same(cast_slice(&scores), cast_slice(&again_scores)));
    }
    finish(&device);
}

#[test]
fn averages_decay_as_if_every_iteration_were_counted() {
    let device = device();
    let cameras = cameras();
    let mut model = narrowed(&random_scene(&cameras[0], 4));
    // A Gaussian that the second camera does not see, so that its average only decays.
    model.means[0] = (cameras[0].centre() + 0.5 * (glam::Vec3::from(model.means[0]).as_dvec3() - cameras[0].centre()))
        .as_vec3()
        .to_array();
    let resident = Resident::upload(&device, &model).unwrap();
    let mut renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), SIZE, 1 << 14).unwrap();
    renderer.make_room(&resident, &cameras[0]).unwrap();
    renderer.make_room_for_responses().unwrap();
    let gradients: Vec<Buffer<[f32; 4]>> =
        (0..2).map(|v| device.upload("image gradient", &image_weights(v)).unwrap()).collect();
    let responses = ResidentResponses::zeros(&device, model.len()).unwrap();
    let backward = Backward { residual: true, ..Backward::default() };
    let views = [0_usize, 1, 1, 0, 1];
    let channels = [twin(&model, 0).0, twin(&model, 1).0];
    assert!(
        (0..model.len()).any(|i| channels[0][i][0] > 0.0 && channels[1][i][0] == 0.0),
        "some are seen by one alone"
    );
    let mut expected = vec![[0.0_f64; 8]; model.len()];
    for (k, v) in views.into_iter().enumerate() {
        let mut recording = Recording::new();
        renderer.reset_overflow(&mut recording);
        renderer.record(&mut recording, &resident, &cameras[v]);
        renderer.record_backward(&mut recording, &resident, &cameras[v], &gradients[v], backward);
        let gather = Gather::Average { iteration: 13_001 + k as u32 };
        responses.record(&mut recording, &renderer, &resident, &cameras[v], gather);
        device.run(recording).unwrap();
        for (e, x) in expected.iter_mut().zip(&channels[v]) {
            e.iter_mut().zip(x).for_each(|(e, x)| *e = KEEP * *e + (1.0 - KEEP) * x);
        }
    }
    assert_eq!(renderer.backward_counts().unwrap(), BackwardCounts { skipped_rows: 0, passes: 5 });
    let got = responses.read(&device, Gather::Average { iteration: 13_005 }).unwrap();
    compare("average", &got, &expected, 3e-4);
    finish(&device);
}

#[test]
fn a_view_whose_pairs_do_not_fit_leaves_nothing() {
    let device = device();
    let camera = &cameras()[0];
    let model = narrowed(&random_scene(camera, 4));
    let resident = Resident::upload(&device, &model).unwrap();
    let mut renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), SIZE, 4).unwrap();
    renderer.make_room_for_responses().unwrap();
    let responses = ResidentResponses::zeros(&device, model.len()).unwrap();
    let scores = ResidentScores::zeros(&device, model.len()).unwrap();
    let mut recording = Recording::new();
    renderer.reset_overflow(&mut recording);
    renderer.record(&mut recording, &resident, camera);
    responses.record(&mut recording, &renderer, &resident, camera, Gather::Average { iteration: 7 });
    scores.record(&mut recording, &renderer, &resident, camera, None);
    device.run(recording).unwrap();
    assert!(responses.values.read(&device).unwrap().iter().all(|v| *v == 0.0));
    assert!(responses.seen.read(&device).unwrap().iter().all(|v| *v == 0));
    assert!(scores.values.read(&device).unwrap().iter().all(|v| *v == Score::default()));
    finish(&device);
}

#[test]
fn high_pass_and_residual_are_their_twins() {
    let device = device();
    for [w, h] in [[1, 1], [3, 40], [45, 37]] {
        let n = (w * h) as usize;
        let mut r = Random(6);
        let image: Vec<[f32; 4]> = (0..n).map(|_| [0; 4].map(|_| r.unit() as f32)).collect();
        let picture = device.upload("picture", &image).unwrap();
        let gradient = device.upload("gradient", &vec![[f32::NAN; 4]; n]).unwrap();
        let pass = HighPass::new(&device, n).unwrap();
        let mut recording = Recording::new();
        pass.record(&mut recording, &picture, &gradient, [w, h]);
        device.run(recording).unwrap();
        let got = gradient.read(&device).unwrap();
        let wide: Vec<[f64; 4]> = image.iter().map(|p| p.map(f64::from)).collect();
        for (at, (got, expected)) in got.iter().zip(reference::high_pass::high_pass(&wide, [w, h])).enumerate() {
            assert!((0..4).all(|c| (f64::from(got[c]) - expected[c]).abs() < 1e-5), "{w} x {h}, pixel {at}");
        }

        // Half-transparent photos over a background; the gradient's colours do not change.
        let photo: Vec<u32> = (0..n).map(|_| (r.unit() * f64::from(u32::MAX)) as u32).collect();
        let photos = device.upload("photo", &photo).unwrap();
        let background = [0.2_f32, 0.5, 0.9];
        for alpha_role in [AlphaRole::Opaque, AlphaRole::Alpha] {
            let mut recording = Recording::new();
            let target = Target { photo: &photos, size: [w, h], alpha_role, background };
            record_residual(&mut recording, &picture, target, &gradient);
            device.run(recording).unwrap();
            let behind = alpha_role.shows_background().then_some(background.map(f64::from));
            let expected = reference::residual::residual(&wide, &photo, behind);
            for ((after, before), expected) in gradient.read(&device).unwrap().iter().zip(&got).zip(expected) {
                assert_eq!(after[..3], before[..3]);
                assert!((f64::from(after[3]) - expected).abs() < 1e-6);
            }
        }
    }
    finish(&device);
}

#[test]
fn responses_stay_finite_under_gradients_that_are_not() {
    gradients_not_finite(&device());
}

pub fn gradients_not_finite(device: &Device) {
    let camera = &cameras()[0];
    let model = narrowed(&random_scene(camera, 4));
    let resident = Resident::upload(device, &model).unwrap();
    let mut renderer = TrainingRenderer::new(device, Settings::default(), model.len(), SIZE, 1 << 14).unwrap();
    renderer.make_room(&resident, camera).unwrap();
    renderer.make_room_for_responses().unwrap();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut weights = image_weights(1);
        let middle = weights.len() / 2;
        weights[middle] = [bad, 0.5, 0.5, bad];
        let weights = device.upload("image gradient", &weights).unwrap();
        let responses = ResidentResponses::zeros(device, model.len()).unwrap();
        let mut recording = Recording::new();
        renderer.reset_overflow(&mut recording);
        renderer.record(&mut recording, &resident, camera);
        let backward = Backward { residual: true, ..Backward::default() };
        renderer.record_backward(&mut recording, &resident, camera, &weights, backward);
        let gather = Gather::Average { iteration: 1 };
        responses.record(&mut recording, &renderer, &resident, camera, gather);
        device.run(recording).unwrap();
        let got = responses.read(device, gather).unwrap();
        assert!(got.as_flattened().iter().all(|v| v.is_finite()), "{bad}: {got:?}");
        assert!(renderer.backward_counts().unwrap().skipped_rows > 0, "{bad}");
    }
    finish(device);
}

/// Scores predict the change of the picture after a removal: for one Gaussian at a time, with the twin in float64.
#[test]
fn a_score_tells_how_the_picture_changes() {
    let camera = &cameras()[0];
    let model = narrowed(&random_scene(camera, 4));
    // Without the early stop: Gaussians behind a pixel's end appear once one before it is removed.
    let settings = reference::Settings { transmittance_stop: 0.0, ..reference::Settings::default() };
    let picture = |model: &Gaussians| reference::render(&Params::from(model), camera, &settings).composite.image;
    let whole = picture(&model);
    let residual: Vec<[f64; 3]> = image_weights(3).iter().map(|w| [w[0], w[1], w[2]].map(f64::from)).collect();
    let scores = reference::score::score(&Params::from(&model), camera, &settings, &residual);
    let mut compared = 0;
    for i in 0..model.len() {
        let without = picture(&model.select(&(0..model.len()).filter(|k| *k != i).collect::<Vec<_>>()));
        let changes = whole.iter().zip(&without).map(|(a, b)| [a[0] - b[0], a[1] - b[1], a[2] - b[2]]);
        let (mut square, mut along) = (0.0, 0.0);
        for (phi, r) in changes.zip(&residual) {
            square += phi.iter().map(|v| v * v).sum::<f64>();
            along += phi.iter().zip(r).map(|(v, r)| v * r).sum::<f64>();
        }
        let [_, change, along_residual] = scores[i].changes;
        assert!((change - square).abs() <= 1e-9 * square.max(1e-3), "{i}: {change}, not {square}");
        assert!((along_residual - along).abs() <= 1e-9 * square.sqrt().max(1e-3), "{i}: {along_residual}, not {along}");
        compared += usize::from(square > 1e-3);
    }
    assert!(compared > 10, "{compared} are seen");
}
