//! Attrition: pressure on opacities against the twin's, exact bytes after resuming, and difficult models.

use super::adam::{Bench, weights};
use super::runs::{bits, capture, options, resumed, train, trainer};
use crate::support::synthetic::{narrowed, random_scene, small_camera};
use crate::support::{device, finish, new_device};
use qirf_vk::gaussians::Gaussians;
use qirf_vk::reference::adam::{BETA1, BETA2, adam, pressed};
use qirf_vk::train::attrition::Attrition;
use qirf_vk::train::rates::{Pressure, Rates, Step};
use qirf_vk::train::{Options, Trainer};

/// Three steps under pressure move opacities like the twin's, and nothing else.
#[test]
fn pressure_moves_opacities_alone() {
    let device = device();
    let camera = small_camera(45, 37);
    let mut model = narrowed(&random_scene(&camera, 3));
    (model.opacity_logits[0], model.opacity_logits[1], model.opacity_logits[2]) = (60.0, -60.0, 200.0);
    let rates = Rates { opacity_logits: 0.1, ..Rates::default() };
    let others = |m: &Gaussians| bits(&Gaussians { opacity_logits: Vec::new(), ..m.clone() });
    for least_through in [0.05, 1.0] {
        let pressure = Pressure { pressure: 0.1, least_through };
        let [free, pressured] = [None, Some(pressure)].map(|pressure| {
            let bench = Bench::new(&device, &model, &camera, &weights(45 * 37, 8));
            let mut twin: Vec<_> = model.opacity_logits.iter().map(|l| ([f64::from(*l)], [0.0], [0.0])).collect();
            for step in 1..=3 {
                let gradients = bench.gradients();
                for (i, (logit, first, second)) in twin.iter_mut().enumerate() {
                    let mut gradient = gradients.opacity_logits[i];
                    if let Some(Pressure { pressure, least_through }) = pressure {
                        gradient = pressed(gradient, logit[0], f64::from(pressure), f64::from(least_through));
                    }
                    assert!(adam(logit, &[gradient], [first, second], (step, 0.1, [BETA1, BETA2])));
                }
                bench.take(Step { pressure, ..Step::new(step, rates) });
            }
            let got = bench.training.model.download(&device).unwrap();
            for (i, (logit, ..)) in twin.iter().enumerate() {
                let (got, right) = (f64::from(got.opacity_logits[i]), logit[0]);
                assert!((got - right).abs() < 3e-5 + 1e-6 * right.abs(), "{i}: {got} for {right} under {pressure:?}");
            }
            got
        });
        assert!(others(&free) == others(&model) && others(&pressured) == others(&model), "only opacities");
        let pairs = free.opacity_logits.iter().zip(&pressured.opacity_logits);
        let lower = pairs.filter(|(free, pressured)| *pressured + 0.01 < **free).count();
        assert!(lower > model.len() / 4, "{lower} of {} opacities fell under the pressure", model.len());
    }
    finish(&device);
}

/// A run whose attrition may last from iteration 80 to 104.
fn contested() -> Options {
    let mut options = options();
    options.schedule.densify_until = 0.6;
    options
}

const BEGUN: u32 = 80;
const ATTRITION: Attrition = Attrition { until: 0.95, opacity_rate: 0.1, faint: 0.005 };

/// Trains to the attrition's end and beyond, pausing at `pause`; returns the model and the number of Gaussians before
/// the cut.
fn contest(trainer: &mut Trainer, survivors: usize, pause: Option<u32>) -> (Vec<u32>, usize) {
    train(trainer, BEGUN);
    trainer.begin_attrition(ATTRITION, survivors).unwrap();
    finish_contest(trainer, pause)
}

fn finish_contest(trainer: &mut Trainer, pause: Option<u32>) -> (Vec<u32>, usize) {
    while let Some(c) = trainer.attrition().copied()
        && !c.over(trainer.iteration(), trainer.len())
    {
        if pause.is_some_and(|at| trainer.iteration() >= at) {
            return (Vec::new(), trainer.len());
        }
        trainer.advance(pause.unwrap_or(c.last).max(trainer.iteration() + 1).min(c.last)).unwrap();
    }
    let c = *trainer.attrition().unwrap();
    let (left, kept) = (trainer.len(), c.survivors);
    trainer.keep(&(0..left).map(|i| i < kept).collect::<Vec<_>>(), None).unwrap();
    trainer.end_attrition();
    trainer.rewarm().unwrap();
    train(trainer, c.length);
    (bits(&trainer.download().unwrap()), left)
}

/// Fewer and fewer Gaussians are left, and a run that was stopped in the middle, or after the re-warming, ends with the
/// same bytes.
#[test]
fn it_resumes_to_the_same_bytes() {
    let device = device();
    let mut whole = trainer(&device, contested());
    train(&mut whole, BEGUN);
    let mut first = resumed(&device, &whole.snapshot().unwrap(), contested());
    let (right, left) = contest(&mut whole, 60, None);
    contest(&mut first, 60, Some(BEGUN + 18));
    let snapshot = first.snapshot().unwrap();
    let before = snapshot.state.attrition.unwrap().before;
    assert!(before > first.len() && first.len() > left && left >= 60, "{before} > {} > {left}", first.len());
    let mut second = resumed(&device, &snapshot, contested());
    assert!(second.attrition() == first.attrition() && second.attrition().is_some());
    assert!(finish_contest(&mut second, None).0 == right, "resumed in the middle");

    // A checkpoint after the end still records that rates were re-warmed.
    let done = resumed(&device, &whole.snapshot().unwrap(), contested()).snapshot().unwrap();
    assert!(done.state == whole.snapshot().unwrap().state && done.state.rewarmed.is_some());
    finish(&device);
}

/// Once a run has room for more Gaussians than are left, attrition frees no buffer and makes only those that it gathers
/// rows with: sources, kinds, the rows, and two for transfers. The host waits for the opacities, and for the rows.
#[test]
fn it_keeps_the_buffers() {
    let device = new_device();
    let mut trainer = trainer(&device, contested());
    train(&mut trainer, BEGUN);
    trainer.begin_attrition(ATTRITION, 60).unwrap();
    let mut asked = Vec::new();
    while let Some(c) = trainer.attrition().copied()
        && !c.over(trainer.iteration(), trainer.len())
    {
        let (n, before) = (trainer.len(), device.traffic());
        trainer.advance(c.last).unwrap();
        let after = device.traffic();
        if trainer.len() < n {
            asked.push([after.buffers - before.buffers, after.round_trips - before.round_trips]);
        }
    }
    println!("buffers and round trips of each thinning: {asked:?}");
    assert!(asked.len() > 2 && asked.last() == Some(&[5, 2]), "{asked:?}");
    finish(&device);
}

/// Equal opacities, NaN rows, and more survivors than Gaussians.
#[test]
fn hard_models_end_with_the_survivors() {
    let device = device();
    let c = capture();
    let mut equal = c.start.clone();
    equal.opacity_logits.fill(-4.0);
    let mut broken = equal.clone();
    broken.opacity_logits.iter_mut().step_by(3).for_each(|logit| *logit = f32::NAN);
    broken.means[1][0] = f32::NAN;
    let n = equal.len();
    for (model, survivors, expected) in [(&equal, 40, 40), (&broken, 40, 40), (&broken, n, n), (&equal, n + 5, n)] {
        let mut options = contested();
        (options.schedule.densify_until, options.schedule.iterations) = (0.0, 40);
        let mut trainer = Trainer::new(&device, model, c.train.clone(), c.extent, options).unwrap();
        train(&mut trainer, 10);
        trainer.begin_attrition(ATTRITION, survivors).unwrap();
        let (_, left) = finish_contest(&mut trainer, None);
        assert!(left >= survivors.min(n), "{left} of {n} left, {survivors} asked for");
        assert_eq!(trainer.len(), expected, "{survivors} of {n}");
        let model = trainer.download().unwrap();
        assert!(survivors >= n || model.opacity_logits.iter().all(|v| v.is_finite()), "rows without a number go first");
    }
    finish(&device);
}
