//! A model whose last rows are drawn and never change: the part of the other blocks that a block sees.

use super::runs::{bits, capture, options, train};
use crate::support::{device, finish, repeats};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Attributes, Gaussians};
use qirf_vk::gpu::Device;
use qirf_vk::job::config::{PruneRule, ResponseSource};
use qirf_vk::pipeline::prune::{PruneRequest, prune};
use qirf_vk::qirf::select::budget::Keep;
use qirf_vk::render::{Renderer, Settings, Style};
use qirf_vk::scene::camera::mean_centre;
use qirf_vk::train::attrition::Attrition;
use qirf_vk::train::checkpoint::Snapshot;
use qirf_vk::train::growth::Growth;
use qirf_vk::train::schedule::Schedule;
use qirf_vk::train::{Options, Trainer};

const TAIL: usize = 40;
/// After density steps at 20, 40 and 60, an opacity reset at 50, and bands added at 33 and 66.
const ACTED: u32 = 70;

/// A run on the capture's model, whose last `TAIL` rows are the tail.
fn trainer(device: &Device, options: Options) -> Trainer {
    let c = capture();
    Trainer::new(device, &c.start, c.train.clone(), c.extent, Options { tail: TAIL, ..options }).unwrap()
}

/// The last rows of a model, and the number of rows before them.
fn tail(model: &Gaussians) -> (Gaussians, usize) {
    let before = model.len() - TAIL;
    (model.select(&(before..model.len()).collect::<Vec<_>>()), before)
}

fn growing(growth: Option<Growth>) -> Options {
    Options { schedule: Schedule { growth, ..options().schedule }, ..options() }
}

/// Steps, density control of both kinds, and opacity resets leave the tail unchanged; the rest moves and grows.
#[test]
fn the_tail_never_changes() {
    let device = device();
    let start = &capture().start;
    for growth in [None, Some(Growth { gaussians: Some(400), ..Growth::default() })] {
        let mut trainer = trainer(&device, growing(growth));
        train(&mut trainer, ACTED);
        let model = trainer.download().unwrap();
        let ((before, _), (after, trained)) = (tail(start), tail(&model));
        assert!(trained != start.len() - TAIL && trained == trainer.trained(), "{trained}");
        // Bands added later are zero.
        let mut before = before;
        before.sh.extend((before.sh.len()..after.sh.len()).map(|l| vec![0.0; TAIL * Gaussians::band_width(l)]));
        assert!(bits(&before) == bits(&after), "{growth:?}");
        assert!(model.means[..100] != start.means[..100]);
        let snapshot = trainer.snapshot().unwrap();
        let widths = Attributes::widths(model.degree());
        for (width, moments) in widths.zip(snapshot.moments.each_ref()).up_to(model.degree()) {
            assert_eq!(moments.len(), 2 * trained * width, "no moments of the tail");
        }
    }
    finish(&device);
}

/// Rows that no camera sees change nothing: with them as the tail, the others end with the bits that they have alone.
/// Random numbers and counts of density control therefore depend on the trained rows only.
#[test]
fn an_invisible_tail_changes_nothing() {
    let device = device();
    let c = capture();
    let mut far = c.start.select(&(0..TAIL).collect::<Vec<_>>());
    far.means.iter_mut().for_each(|mean| *mean = [1e6, 1e6, 1e6]);
    let mut both = c.start.clone();
    both.append(&far);
    for growth in [None, Some(Growth { gaussians: Some(400), ..Growth::default() })] {
        let style = Style { antialias: true, ..Style::default() };
        let plain = Options { settings: style.over([0.0; 3]), ..growing(growth) };
        let mut alone = Trainer::new(&device, &c.start, c.train.clone(), c.extent, plain.clone()).unwrap();
        let with = Options { tail: TAIL, ..plain };
        let mut tailed = Trainer::new(&device, &both, c.train.clone(), c.extent, with).unwrap();
        train(&mut alone, ACTED);
        train(&mut tailed, ACTED);
        let (alone, tailed) = (alone.download().unwrap(), tailed.download().unwrap());
        let first = tailed.select(&(0..tailed.len() - TAIL).collect::<Vec<_>>());
        assert!(bits(&first) == bits(&alone), "{growth:?}: {} and {}", first.len(), alone.len());
    }
    finish(&device);
}

/// Attrition and prunes remove trained rows only.
#[test]
fn attrition_and_prunes_leave_the_tail() {
    let device = device();
    let start = &capture().start;
    let plain = Options { schedule: Schedule { densify_until: 0.0, ..options().schedule }, ..options() };
    let mut trainer = trainer(&device, plain);
    train(&mut trainer, 20);
    let trained = trainer.trained();
    trainer.begin_attrition(Attrition::default(), trained / 3).unwrap();
    assert_eq!(trainer.attrition().unwrap().before, trained);
    train(&mut trainer, 100);
    assert!(trainer.trained() <= trained);
    let keep: Vec<bool> = (0..trainer.trained()).map(|i| i % 2 == 0).collect();
    let expected = trainer.download().unwrap();
    let kept: Vec<usize> = (0..expected.len()).filter(|i| keep.get(*i).is_none_or(|keep| *keep)).collect();
    trainer.keep(&keep, None).unwrap();
    let model = trainer.download().unwrap();
    assert!(bits(&model) == bits(&expected.select(&kept)));
    assert_eq!(trainer.trained(), model.len() - TAIL);
    assert!(
        tail(&model).0.means == tail(start).0.means && tail(&model).0.opacity_logits == tail(start).0.opacity_logits
    );
    let merged = Gaussians { opacity_logits: vec![1.5; model.len()], ..model.clone() };
    trainer.keep(&vec![true; trainer.trained()], Some(&merged)).unwrap();
    assert!(bits(&trainer.download().unwrap()) == bits(&merged));
    finish(&device);
}

/// A prune chooses from the trained rows only, merges into them only, and counts them only.
#[test]
fn prunes_choose_beside_the_tail() {
    let device = device();
    let start = &capture().start;
    for merge in [false, true] {
        let plain = Options { schedule: Schedule { densify_until: 0.0, ..options().schedule }, ..options() };
        let mut trainer = trainer(&device, plain);
        train(&mut trainer, 20);
        let trained = trainer.trained();
        let compression = PruneRule { merge, ..PruneRule::default() };
        let request = PruneRequest { compression: &compression, keep: Keep::Count(trained / 3), seed: 1 };
        let record = prune(&device, &mut trainer, ResponseSource::FullPass, &request, |_, _| Ok(())).unwrap();
        assert_eq!((record.before, record.after, trainer.trained()), (trained, trained / 3, trained / 3));
        let model = trainer.download().unwrap();
        assert_eq!(model.len(), trained / 3 + TAIL);
        let ((before, _), (after, _)) = (tail(start), tail(&model));
        assert!(
            before.means == after.means && before.opacity_logits == after.opacity_logits && before.sh[0] == after.sh[0]
        );
        train(&mut trainer, 30);
    }
    finish(&device);
}

/// A run with a tail ends with the same bits after an interruption; its checkpoint stores the tail's length.
#[test]
fn a_tail_is_resumed() {
    let device = device();
    let c = capture();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    let mut whole = trainer(&device, options());
    train(&mut whole, 30);
    whole.snapshot().unwrap().write(&path).unwrap();
    train(&mut whole, ACTED);
    let snapshot = Snapshot::read(&path).unwrap();
    assert_eq!(snapshot.tail, TAIL);
    let mut resumed = Trainer::resume(&device, &snapshot, c.train.clone(), c.extent, options()).unwrap();
    assert_eq!(resumed.trained(), snapshot.model.len() - TAIL);
    train(&mut resumed, ACTED);
    assert!(bits(&resumed.download().unwrap()) == bits(&whole.download().unwrap()));
    finish(&device);
}

/// The tail is in every picture.
#[test]
fn the_tail_is_drawn() {
    let device = device();
    let c = capture();
    let trainer = trainer(&device, options());
    let camera = &c.train[0].camera;
    let mut renderer = Renderer::new(&device, Settings::default(), c.start.len(), camera.width, camera.height).unwrap();
    let drawn = renderer.render(trainer.model(), camera).unwrap();
    let whole = Resident::upload(&device, &c.start).unwrap();
    assert!(drawn.pixels == renderer.render(&whole, camera).unwrap().pixels);
    let first = c.start.select(&(0..c.start.len() - TAIL).collect::<Vec<_>>());
    let first = Resident::upload(&device, &first).unwrap();
    assert!(drawn.pixels != renderer.render(&first, camera).unwrap().pixels);
    finish(&device);
}

/// The mean of the whole scene's cameras, if given, replaces that of the photos' own.
#[test]
fn the_scenes_cameras_come_from_outside() {
    let (device, again) = (device(), repeats());
    let trained = |device: &Device, cameras: Option<[f32; 3]>| {
        // Large Gaussians are pruned by their distance from the cameras.
        let schedule = Schedule { prune_scale: 0.02, prune_scale_from: 0.0, ..options().schedule };
        let mut trainer = trainer(device, Options { cameras, schedule, ..options() });
        train(&mut trainer, 70);
        trainer.trained()
    };
    let own = mean_centre(capture().train.iter().map(|p| &p.camera)).as_vec3().to_array();
    let alone = trained(&device, None);
    assert_eq!(alone, trained(&again, Some(own)));
    assert_ne!(alone, trained(&again, Some([1e4, 0.0, 0.0])), "far from the cameras nothing is too large");
    finish(&device);
}
