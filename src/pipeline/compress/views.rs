//! The views that a compression scores a model on.

use super::config::{CompressConfig, ViewSource};
use crate::gaussians::Gaussians;
use crate::job::records::{CompressProtocol, StageScores, Truth, ViewStages};
use crate::job::{Error, Selection, Session};
use crate::metrics::Scores;
use crate::pipeline::budget::{self, CompressNeeds};
use crate::pipeline::draw_source::DrawSource;
use crate::pipeline::evaluate::exposure_rule;
use crate::pipeline::floaters;
use crate::pipeline::prepare::{Opened, Prepared, open};
use crate::pipeline::virtual_views::{ALL, OUTWARD, OwnPictures, VirtualCameras};
use crate::qirf::select::budget::Keep;
use crate::render::{Settings, Source};
use crate::scene::camera::Camera;
use crate::scene::{Photo, camera};
use crate::train::Exposures;
use std::ops::Range;

/// Training and held-out views of a compression.
pub struct Views {
    pub truth: Truth,
    /// Views for responses and fine-tuning; the model's own pictures have pixels only if there is fine-tuning.
    pub train: Vec<Photo>,
    /// Names of the training photos; empty for the model's own pictures.
    pub names: Vec<String>,
    pub test: Vec<(String, Photo)>,
    /// Scale of the positions' learning rate.
    pub extent: f64,
    pub settings: Settings,
    /// True if photos have exposures of their own, which are fitted before scores.
    pub fits_exposure: bool,
    /// The training photos' exposures, if each has one of its own and training or responses read them.
    pub exposures: Option<Exposures>,
    /// Bytes of device memory that the job is expected to need.
    pub estimated_bytes: u64,
}

impl Views {
    /// Checks that the job fits the device, then decodes the photos or draws the model's own pictures. Also returns the model
    /// on the host or the device. Of the held-out views, only those with the indices `held_out` are loaded.
    pub fn load<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        config: &CompressConfig,
        held_out: Range<usize>,
    ) -> Result<(Self, DrawSource<'m>), Error> {
        match &config.views {
            ViewSource::Photos(selection) => {
                let (mut views, shown) = Self::of_photos(session, model, open(selection)?, config)?;
                let mut number = 0..;
                views.test.retain(|_| number.next().is_some_and(|n| held_out.contains(&n)));
                Ok((views, shown))
            }
            ViewSource::OwnPictures { cameras, background } => {
                Self::of_model(session, model, cameras, *background, config, held_out)
            }
        }
    }

    /// Loads views as [`Self::load`] does, only from the photos with these names, all of which are training photos.
    pub fn named<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        selection: &Selection,
        names: &[String],
        config: &CompressConfig,
    ) -> Result<(Self, DrawSource<'m>), Error> {
        Self::of_photos(session, model, open(selection)?.only(names)?, config)
    }

    /// Loads all views as [`Self::load`] does, with the training photos' exposures.
    pub fn exposed<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        config: &CompressConfig,
    ) -> Result<(Self, DrawSource<'m>), Error> {
        let (mut views, shown) = Self::load(session, model, config, ALL)?;
        views.fit_gains(session, shown.source(), config)?;
        Ok((views, shown))
    }

    /// Fits gains of the training photos to the model's pictures, from which their exposures are learnt, if photos have exposures of
    /// their own and training or responses read them.
    pub fn fit_gains(
        &mut self,
        session: &Session<'_>,
        model: Source<'_>,
        config: &CompressConfig,
    ) -> Result<(), Error> {
        if self.fits_exposure && (config.fine_tune > 0 || config.compression.selector.reads().gradients()) {
            let (gains, _) = floaters::gains(session, model, &self.train, self.settings)?;
            self.exposures = Some(Exposures::Learnt(gains));
        }
        Ok(())
    }

    fn of_photos<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        opened: Opened,
        config: &CompressConfig,
    ) -> Result<(Self, DrawSource<'m>), Error> {
        let needs = Self::with_config(CompressNeeds::of_photos(&opened), model, config);
        let place = budget::for_compress(session.device, model, needs)?;
        let prepared = opened.load_to_train(session.photo_memory(&std::env::temp_dir()), session.watcher)?;
        let settings = prepared.settings(config.style);
        let names = prepared.names_to_train();
        let Prepared { train, test, extent, .. } = prepared;
        let shown = DrawSource::new(session, model, place.whole)?;
        let views = Self {
            truth: Truth::Photos,
            train,
            names,
            test,
            extent,
            settings,
            fits_exposure: config.exposure,
            exposures: None,
            estimated_bytes: place.bytes,
        };
        Ok((views, shown))
    }

    /// The cameras of the training views, the settings of their pictures, and the model, without decoding photos. `names` lists
    /// the training photos, if there are photos; their background is known.
    pub fn cameras<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        config: &CompressConfig,
        names: &[String],
    ) -> Result<(Vec<Camera>, Settings, DrawSource<'m>), Error> {
        let ViewSource::Photos(selection) = &config.views else {
            let (views, shown) = Self::load(session, model, config, 0..0)?;
            return Ok((views.train.into_iter().map(|view| view.camera).collect(), views.settings, shown));
        };
        let opened = open(selection)?.only(names)?;
        let needs = Self::with_config(CompressNeeds::of_photos(&opened), model, config);
        let place = budget::for_compress(session.device, model, needs)?;
        let settings = opened.settings(config.style, selection.background);
        Ok((opened.cameras(), settings, DrawSource::new(session, model, place.whole)?))
    }

    /// Adds the needs of the compression's options to these.
    fn with_config(needs: CompressNeeds, model: &Gaussians, config: &CompressConfig) -> CompressNeeds {
        let (wanted, basis) = (config.compression.selector.reads(), config.compression.basis.clone());
        let CompressConfig { style, exposure, .. } = *config;
        CompressNeeds { wanted, basis, style, exposure, trained: trained(config, model), ..needs }
    }

    fn of_model<'m>(
        session: &Session<'_>,
        model: &'m Gaussians,
        cameras: &VirtualCameras,
        background: [f32; 3],
        config: &CompressConfig,
        held_out: Range<usize>,
    ) -> Result<(Self, DrawSource<'m>), Error> {
        let size = [cameras.size.0, cameras.size.1];
        let photos = vec![4 * u64::from(size[0]) * u64::from(size[1]); cameras.views as usize + OUTWARD];
        let needs = CompressNeeds { size, own_pictures: true, photos, ..CompressNeeds::default() };
        let place = budget::for_compress(session.device, model, Self::with_config(needs, model, config))?;
        let views = cameras.framing_views(model, background, config.style);
        let settings = views.settings;
        let shown = DrawSource::new(session, model, place.whole)?;
        let OwnPictures { train, test } =
            OwnPictures::draw(session, shown.source(), views, config.fine_tune > 0, held_out)?;
        let extent = camera::extent(train.iter().map(|v| &v.camera));
        let views = Self {
            truth: Truth::OwnPictures,
            train,
            names: Vec::new(),
            test,
            extent,
            settings,
            fits_exposure: false,
            exposures: None,
            estimated_bytes: place.bytes,
        };
        Ok((views, shown))
    }

    /// Conditions of the measurement.
    pub fn protocol(&self, config: &CompressConfig) -> CompressProtocol {
        let views = self.train.iter().chain(self.test.iter().map(|(_, view)| view));
        CompressProtocol {
            truth: self.truth,
            train_views: self.train.len(),
            test_views: self.test.len(),
            image_size: camera::largest(views.map(|v| &v.camera)),
            background: self.settings.background,
            style: self.settings.style,
            exposure: exposure_rule(self.fits_exposure),
            fine_tune: config.fine_tune,
            seed: config.seed,
            compression: config.compression.clone(),
        }
    }

    /// The held-out views with their scores before the prune, after it, after fine-tuning, and of the file; each list is empty or
    /// has one entry per view.
    pub fn stages(&self, scores: [Vec<Scores>; 4]) -> Vec<ViewStages> {
        let [mut before, mut pruned, mut fine_tuned, mut written] = scores.map(Vec::into_iter);
        let mut next = || StageScores {
            before: before.next(),
            pruned: pruned.next(),
            fine_tuned: fine_tuned.next(),
            written: written.next(),
        };
        self.test.iter().map(|(name, _)| ViewStages { name: name.clone(), scores: next() }).collect()
    }
}

/// Maximum number of Gaussians in fine-tuning.
fn trained(config: &CompressConfig, model: &Gaussians) -> usize {
    match config.compression.keep {
        _ if config.fine_tune == 0 => 0,
        Keep::Share(share) => (share * model.len() as f64).ceil() as usize,
        Keep::Count(count) => count.min(model.len()),
        Keep::Paper { .. } => model.len(),
    }
}
