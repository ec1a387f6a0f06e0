//! `config.toml`, read and written.

use super::ranges;
use super::run::RunConfig;
use crate::job::Error;
use crate::job::output::absolute;
use crate::scene::read_text;
use serde::Deserialize;
use std::path::Path;

/// Keys of `config.toml` and names of its tables, with commas between.
pub const KEYS: &str = "scene, images, resolution, pole_mask, depth, seed, eval_every, sh_degree, init, init_count, \
                        background, antialias, depth_order, dilation, exposure, poses, dropout, depth_loss, \
                        max_gaussians, checkpoint_every, clean, schedule, prune, method, effects, tuning";

/// Tables with exactly one key, and the keys that there are.
const ONE_OF: [(&str, &str); 2] =
    [("prune.compression.keep", "share, count and paper"), ("prune.compression.basis.partition", "adaptive and paper")];

/// The keys of a style, which serde reads without their lines where they are flattened into a configuration.
#[derive(Deserialize)]
struct StyleKeys {
    #[serde(rename = "antialias")]
    _antialias: Option<bool>,
    #[serde(rename = "depth_order")]
    _depth_order: Option<bool>,
    #[serde(rename = "dilation")]
    _dilation: Option<f32>,
}

/// Refuses an unknown key before a missing one is noticed, which is what a misspelt key comes to; several keys where one
/// is chosen; and a style's key of the wrong type with its line.
fn check_keys(text: &str) -> Result<(), String> {
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| told(&e))?;
    if let Some(key) = table.keys().find(|key| !KEYS.split(", ").any(|known| known == *key)) {
        return Err(format!("unknown field `{key}`; the fields are {KEYS}"));
    }
    let whole = toml::Value::Table(table);
    for (field, keys) in ONE_OF {
        let chosen = field.split('.').try_fold(&whole, |value, key| value.get(key)).and_then(toml::Value::as_table);
        if chosen.is_some_and(|chosen| chosen.len() != 1) {
            return Err(format!("{field}: write one of {keys}"));
        }
    }
    toml::from_str::<StyleKeys>(text).map(|_| ()).map_err(|e| told(&e))
}

/// An error of the parser on one line, without its excerpt of the file.
fn told(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let place = text.lines().next().and_then(|line| line.strip_prefix("TOML parse error at "));
    place
        .map_or_else(|| error.message().to_owned(), |place| format!("{place}: {}", error.message()))
        .replace('\n', "; ")
}

impl RunConfig {
    /// Reads a `config.toml`. Its relative paths are relative to its folder; where nothing is there, as in files of earlier
    /// versions, to the current one.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Config`] with the line or the field that is wrong.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = read_text(path)?;
        let config = Self::parse(&text).map_err(|what| Error::Config { path: path.to_owned(), what })?;
        Ok(config.read_in(path.parent().unwrap_or(path)))
    }

    /// The configuration whose text was that of a file in `folder`.
    #[must_use]
    pub fn read_in(mut self, folder: &Path) -> Self {
        self.respell(|path| {
            Some(folder.join(path)).filter(|beside| beside.exists()).unwrap_or_else(|| path.to_owned())
        });
        self
    }

    /// The text of a `config.toml` in `folder`: paths below it are relative, so that it can be moved, and others absolute.
    ///
    /// # Errors
    /// The errors of [`RunConfig::written`].
    pub fn written_in(&self, folder: &Path) -> Result<String, Error> {
        let (mut config, folder) = (self.clone(), absolute(folder));
        // TOML is UTF-8, and the current folder's name may not be.
        config.respell(|path| Some(absolute(path)).filter(|p| p.to_str().is_some()).unwrap_or_else(|| path.to_owned()));
        let below = |path: &Path| {
            path.strip_prefix(&folder).ok().filter(|path| !path.as_os_str().is_empty()).map(Path::to_owned)
        };
        config.respell(|path| below(path).unwrap_or_else(|| path.to_owned()));
        config.written()
    }

    /// The same run with other values for some fields, named and written as in `config.toml`.
    ///
    /// # Errors
    /// [`Error::Usage`] with the field that is unknown or wrong.
    pub fn with(&self, fields: toml::Table) -> Result<Self, Error> {
        let mut whole: toml::Table = self.written()?.parse().map_err(|e| Error::encoding("config.toml", e))?;
        whole.extend(fields);
        Self::parse(&whole.to_string()).map_err(Error::Usage)
    }

    fn parse(text: &str) -> Result<Self, String> {
        check_keys(text)?;
        let config: Self = toml::from_str(text).map_err(|e| told(&e))?;
        ranges::check(&config)?;
        Ok(config)
    }

    /// The text of `config.toml`.
    ///
    /// # Errors
    /// [`Error::Encode`] for values that TOML cannot represent, such as a path that is not UTF-8.
    pub fn written(&self) -> Result<String, Error> {
        toml::to_string(self).map_err(|e| Error::encoding("config.toml", e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Overrides;
    use crate::gpu::{DeviceClass, Tuning};
    use crate::job::config::{Init, MethodConfig, Preset};
    use crate::render::Style;

    fn config() -> RunConfig {
        RunConfig {
            background: Some([0.5, 0.25, 1.0]),
            style: Style { antialias: true, ..Style::default() },
            effects: Overrides::default(),
            ..RunConfig::sample(Preset::Quick)
        }
    }

    /// The keys and their order are those of all earlier versions: a style's keys are among them, not in a table of
    /// their own.
    #[test]
    fn what_was_written_is_read_back() {
        let text = config().written().unwrap();
        let (keys, schedule) = text.split_once("\n\n[schedule]\n").unwrap();
        assert!(schedule.contains("iterations = 2000"));
        let expected = [
            r#"scene = "capture""#,
            "seed = 1",
            "eval_every = 8",
            "sh_degree = 3",
            r#"init = "points""#,
            "background = [0.5, 0.25, 1.0]",
            "antialias = true",
            "depth_order = false",
            "exposure = false",
            "max_gaussians = 4000",
            "checkpoint_every = 50",
        ];
        assert_eq!(keys.lines().collect::<Vec<_>>(), expected);
        assert_eq!(check_keys(&text), Ok(()));
        assert_eq!(toml::from_str::<RunConfig>(&text).unwrap(), config());
    }

    #[test]
    fn paths_mean_the_same_wherever_the_file_is_read_from() {
        let folder = tempfile::tempdir().unwrap();
        let [out, moved, scene] = ["out", "moved", "scene"].map(|name| folder.path().join(name));
        for photos in [&scene, &out.join("scene")] {
            std::fs::create_dir_all(photos.join("images_2")).unwrap();
        }
        let (images, depth) = (Some("images_2".into()), Some(folder.path().join("depth")));
        let outside =
            RunConfig { scene: scene.clone(), images, depth, init: Init::Model(out.join("a.ply")), ..config() };
        let text = outside.written_in(&out).unwrap();
        assert!(text.contains("images = \"images_2\"") && text.contains("model = \"a.ply\""), "{text}");
        std::fs::write(out.join("a.ply"), "").unwrap();
        std::fs::write(out.join("config.toml"), text).unwrap();
        assert_eq!(RunConfig::read(&out.join("config.toml")).unwrap(), outside);
        // Paths below the folder move with it.
        let inside = RunConfig { scene: out.join("scene"), ..config() };
        std::fs::write(out.join("config.toml"), inside.written_in(&out).unwrap()).unwrap();
        std::fs::rename(&out, &moved).unwrap();
        assert_eq!(RunConfig::read(&moved.join("config.toml")).unwrap().scene, moved.join("scene"));
        // Files of earlier versions are relative to the folder in which the program ran.
        assert_eq!(config().read_in(&moved).scene, config().scene);
        let text = config().written_in(&moved).unwrap();
        let written: RunConfig = toml::from_str(&text).unwrap();
        assert!(written.scene.is_absolute() && written.scene.ends_with("capture"), "{text}");
        // As editors and shells of Windows write it.
        let wide = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
        std::fs::write(moved.join("config.toml"), wide).unwrap();
        assert_eq!(RunConfig::read(&moved.join("config.toml")).unwrap(), written);
    }

    #[test]
    fn every_key_that_is_written_is_known() {
        let other = config();
        // No `..`: the compiler asks for the value of a new field that is written.
        let all = RunConfig {
            scene: other.scene,
            images: Some("photos".into()),
            resolution: Some("/2".into()),
            pole_mask: 20.0,
            depth: Some("maps".into()),
            seed: other.seed,
            eval_every: other.eval_every,
            sh_degree: other.sh_degree,
            init: other.init,
            init_count: Some(10),
            background: other.background,
            style: Style { dilation: Some(0.3), ..Style::default() },
            exposure: other.exposure,
            poses: true,
            dropout: true,
            depth_loss: true,
            max_gaussians: other.max_gaussians,
            checkpoint_every: other.checkpoint_every,
            clean: true,
            schedule: other.schedule,
            prune: other.prune,
            method: Some(MethodConfig::new("mcmc", &toml::toml! { dead = 0.005 })),
            effects: Preset::Paper.effects(),
            tuning: Some(Tuning::new(DeviceClass::Cpu, 8, 1024)),
        };
        let text = all.pruned(Preset::Quick.pruning()).written().unwrap();
        assert_eq!(check_keys(&text), Ok(()));
        let written: toml::Table = text.parse().unwrap();
        assert!(text.contains("\ndilation = 0.3\n"), "{text}");
        assert_eq!(toml::from_str::<RunConfig>(&text).unwrap().style.dilation, Some(0.3));
        let keys = KEYS.split(", ").count();
        assert_eq!(written.len(), keys, "a key of KEYS is never written, or this test leaves it out");
    }

    #[test]
    fn unknown_and_absent_keys_are_refused_by_name() {
        let text = config().written().unwrap();
        // Files from before the effect existed.
        let older = text.replace("depth_order = false\n", "");
        assert_eq!(toml::from_str::<RunConfig>(&older).unwrap(), config());
        for (text, key) in [
            (text.replace("antialias = true\n", ""), "antialias"),
            (text.replace("depth_order", "deep_order"), "deep_order"),
            (format!("colour = 3\n{text}"), "colour"),
        ] {
            let error = toml::from_str::<RunConfig>(&text).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
        let error = check_keys(&text.replace("seed = 1", "sead = 1")).unwrap_err();
        assert!(error.starts_with("unknown field `sead`"), "{error}");
        let error = check_keys(&text.replace("antialias = true", "antialias = 3")).unwrap_err();
        assert!(error.contains("line 7") && error.contains("expected a boolean"), "{error}");
        for (table, says) in [
            ("[effects]\npopping = \"on\"", "'popping' is not an effect; possible values: view_dependence, "),
            ("[prune.compression.keep]\nshare = 0.28\ncount = 100", "keep: write one of share, count and paper"),
            ("[prune.compression.basis]\npartition = {}", "partition: write one of adaptive and paper"),
        ] {
            let error = RunConfig::parse(&format!("{text}\n{table}\n")).unwrap_err();
            assert!(error.contains(says) && !error.contains("cameras"), "{error}");
        }
    }
}
