//! Growth to a planned number: its gradients and its halves against the twin's.

use super::density::{STEP, held, rows, scene};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{Random, device, finish};
use glam::DVec3;
use qirf_vk::gpu::Recording;
use qirf_vk::reference::densify::lengthwise;
use qirf_vk::reference::{self, Params};
use qirf_vk::render::{Backward, Settings, TrainingRenderer};
use qirf_vk::train::TrainingModel;
use qirf_vk::train::density::{Step, densify};
use qirf_vk::train::growth::Growth;
use qirf_vk::train::schedule::Schedule;

/// The gradients used by density control, over the whole picture and tile by tile.
#[test]
fn gradients_as_the_twin_adds_them_up() {
    let device = device();
    let camera = small_camera(45, 37);
    let model = narrowed(&random_scene(&camera, 3));
    let mut r = Random(9);
    let weights: Vec<[f32; 4]> = (0..45 * 37).map(|_| [0; 4].map(|_| r.within(-1.0, 1.0) as f32)).collect();
    let (colour, alpha): (Vec<[f64; 3]>, Vec<f64>) =
        weights.iter().map(|w| ([w[0], w[1], w[2]].map(f64::from), f64::from(w[3]))).unzip();
    let settings = reference::Settings { tile: device.tuning().tile, ..reference::Settings::default() };
    let twin = reference::frame::gradients(&Params::from(&model), &camera, &settings, &colour, Some(&alpha));
    let training = TrainingModel::new(&device, &model).unwrap();
    let mut renderer = TrainingRenderer::new(&device, Settings::default(), model.len(), [45, 37], 1 << 13).unwrap();
    renderer.render(&training.model, &camera).unwrap();
    let by_image = device.upload("image gradient", &weights).unwrap();
    let mut larger = 0;
    for absolute in [false, true] {
        training.growth.write(&device, &vec![[0.0; 2]; model.len()]).unwrap();
        let mut recording = Recording::new();
        renderer.record(&mut recording, &training.model, &camera);
        let backward = Backward { growth: Some(&training.growth), absolute, ..Backward::default() };
        renderer.record_backward(&mut recording, &training.model, &camera, &by_image, backward);
        device.run(recording).unwrap();
        for (i, [got, views]) in training.growth.read(&device).unwrap().into_iter().enumerate() {
            let signed = twin.mean2d_ndc[i][0].hypot(twin.mean2d_ndc[i][1]);
            let pull = (twin.sums[i].pull.x * 22.5).hypot(twin.sums[i].pull.y * 18.5);
            let right = if absolute { pull } else { signed };
            assert!(
                (f64::from(got) - right).abs() <= 1e-3 * pull + 1e-6,
                "{i}: {got} for {right}, absolute {absolute}"
            );
            assert!(pull >= signed * (1.0 - 1e-9) && (views == 1.0 || got == 0.0));
            larger += usize::from(absolute && pull > 1.5 * signed);
        }
    }
    assert!(larger > 3, "{larger} Gaussians are pulled both ways");
    finish(&device);
}

/// The planned number is reached, halves lie at the twin's positions, everything else is unchanged.
#[test]
fn halves_lie_along_the_longest_axis() {
    let device = device();
    let (mut model, growth) = scene(400, 21);
    model.log_scales[0] = [-3.0; 3];
    let growth_of = |i: usize| growth[i][0] > 0.0 && growth[i][1] > 0.0;
    // More than twice the number, so that every candidate is halved; memory is taken for the whole plan.
    for (sampled, planned) in [(true, 400), (false, 400), (true, 2000)] {
        let growth_plan = Growth { gaussians: Some(planned), sampled, ..Growth::default() };
        // A step at the end of growth, where the plan is complete.
        let schedule = Schedule { densify_gradient: 1e-30, growth: Some(growth_plan), ..Schedule::default() };
        let step = Step { iteration: 14_900, ..STEP };
        let once = || {
            let mut held = held(&device, &model, &growth);
            let after = densify(&device, &mut held, &schedule, step).unwrap();
            let moments = held.moments.opacity_logits.read(&device).unwrap();
            (after, held.model.download(&device).unwrap(), moments)
        };
        let (after, new, moments) = once();
        let again = once().1;
        assert!((0..after).all(|i| rows(&new, i) == rows(&again, i)), "the same every time");
        let params = Params::from(&model);
        let kept: Vec<usize> = (0..400).filter(|i| moments.iter().any(|m| m[1] == 1.0 + *i as f32)).collect();
        let (mut halves, mut row) = (0, 0);
        for i in 0..400 {
            if kept.contains(&i) {
                assert_eq!(rows(&new, row), rows(&model, i), "{i}");
                row += 1;
            } else if row + 1 < after && rows(&new, row)[6..10] == rows(&model, i)[6..10] {
                assert!(growth_of(i), "{i} has no gradient");
                for half in lengthwise(&params, i) {
                    let place = DVec3::from(new.means[row].map(f64::from));
                    assert!((place - half.mean).length() < 1e-5 * (1.0 + half.mean.length()), "{i}: {place}");
                    let scales = new.log_scales[row].iter().zip(half.log_scales);
                    assert!(scales.into_iter().all(|(a, b)| (f64::from(*a) - b).abs() < 2e-6), "{i}");
                    assert!((f64::from(new.opacity_logits[row]) - half.logit).abs() < 1e-5, "{i}");
                    assert_eq!(rows(&new, row)[11..], rows(&model, i)[11..], "{i}: colours are the parent's");
                    assert_eq!(moments[row], [0.0; 2]);
                    row += 1;
                }
                halves += 1;
            }
        }
        assert_eq!(row, after, "each row is a kept Gaussian or a half");
        let candidates = (0..400).filter(|i| growth_of(*i)).count();
        println!("{after} of {planned} planned: {} kept, {halves} halved", kept.len());
        assert!(if planned == 400 { after == 400 && halves > 30 } else { halves > candidates / 2 });
    }
    finish(&device);
}
