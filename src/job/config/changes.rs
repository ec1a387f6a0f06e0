//! Differences between the configurations of two runs.

use super::run::{Init, RunConfig};
use crate::effects::Effect;
use crate::job::output::{same_place, within};
use crate::render::Style;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most changes that are listed one by one.
const LISTED: usize = 3;

impl RunConfig {
    /// The first few keys of `config.toml` whose values differ from those of `earlier`, each with both values; empty if both
    /// runs give the same results. The interval of checkpoints, the tuning, and the spelling of a path make no difference.
    pub fn changes(&self, earlier: &Self) -> Vec<String> {
        let ours = Self {
            checkpoint_every: earlier.checkpoint_every,
            tuning: earlier.tuning.clone(),
            scene: respelt(&self.scene, &earlier.scene),
            images: self.respelt_folder(self.images.as_ref(), earlier.images.as_ref()),
            depth: self.respelt_folder(self.depth.as_ref(), earlier.depth.as_ref()),
            init: match (&self.init, &earlier.init) {
                (Init::Model(ours), Init::Model(theirs)) => Init::Model(respelt(ours, theirs)),
                (ours, _) => ours.clone(),
            },
            ..self.clone()
        };
        if ours == *earlier {
            return Vec::new();
        }
        let (ours, theirs) = (values(&ours), values(earlier));
        let mut keys: Vec<&String> = ours.keys().chain(theirs.keys()).collect();
        keys.retain(|key| ours.get(*key) != theirs.get(*key));
        // The scene's and the run's own keys come before those of tables.
        keys.sort_unstable_by_key(|key| (key.contains('.'), *key));
        keys.dedup();
        for (head, rest) in [("prune", "prune."), ("method.name", "method."), ("schedule.iterations", "schedule.")] {
            // Without pruning its choices are void, another method has other settings, and the schedule's milestones and rates follow from its length.
            if keys.iter().any(|key| *key == head) {
                keys.retain(|key| *key == head || !key.starts_with(rest));
            }
        }
        let none = || "none".to_owned();
        let line = |key: &&String| {
            let value = |of: &BTreeMap<String, String>| of.get(*key).cloned().unwrap_or_else(none);
            format!("{key} was {}, is {}", value(&theirs), value(&ours))
        };
        let mut out: Vec<String> = keys.iter().take(LISTED).map(line).collect();
        if keys.len() > LISTED {
            out.push(format!("{} more", keys.len() - LISTED));
        }
        out
    }

    /// Variant of [`respelt`] for folders that may be names within the scene.
    fn respelt_folder(&self, ours: Option<&PathBuf>, theirs: Option<&PathBuf>) -> Option<PathBuf> {
        let place = |folder: &PathBuf| {
            Some(within(&self.scene, folder)).filter(|p| p.exists()).unwrap_or_else(|| folder.clone())
        };
        let same = theirs.filter(|theirs| ours.is_some_and(|ours| same_place(&place(ours), &place(theirs))));
        same.or(ours).cloned()
    }

    /// The [`RunConfig::changes`] before the scene has decided on its effects: `earlier` gives the scene's decisions.
    pub fn changes_before_decisions(&self, earlier: &Self) -> Vec<String> {
        let asked = self.effects.forced(Effect::ViewDependence) == Some(true);
        let ours = Self {
            sh_degree: if asked { self.sh_degree } else { earlier.sh_degree },
            style: Style { dilation: self.style.dilation, ..earlier.style },
            exposure: earlier.exposure,
            poses: earlier.poses,
            dropout: earlier.dropout,
            depth_loss: earlier.depth_loss,
            ..self.clone()
        };
        ours.changes(earlier)
    }
}

/// `theirs` if both are the same place on disk, else `ours`: places are compared, and not their spelling.
fn respelt(ours: &Path, theirs: &Path) -> PathBuf {
    if same_place(ours, theirs) { theirs.to_owned() } else { ours.to_owned() }
}

/// Every value of a configuration as text, by its key in `config.toml`, with the names of its tables before it. The pruning,
/// which a run may have or not, is a value of its own besides.
fn values(config: &RunConfig) -> BTreeMap<String, String> {
    fn walk(prefix: &str, table: &toml::Table, out: &mut BTreeMap<String, String>) {
        for (key, value) in table {
            let key = format!("{prefix}{key}");
            match value {
                toml::Value::Table(table) => walk(&format!("{key}."), table, out),
                value => _ = out.insert(key, value.to_string()),
            }
        }
    }
    let mut out = BTreeMap::new();
    // A configuration that TOML cannot represent has no values to compare; it cannot be written either, which is told there.
    if let Ok(table) = toml::Table::try_from(config) {
        walk("", &table, &mut out);
        if config.prune.is_some() {
            out.insert("prune".to_owned(), "set".to_owned());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Choice;
    use crate::job::config::Preset;

    #[test]
    fn changes_are_named_and_what_decides_on_nothing_is_left_out() {
        let earlier = RunConfig::sample(Preset::Quick).pruned(Preset::Quick.pruning());
        let same = RunConfig { checkpoint_every: 7, scene: "capture/".into(), ..earlier.clone() };
        assert_eq!(same.changes(&earlier), Vec::<String>::new());
        let other = RunConfig { seed: 2, resolution: Some("/2".into()), ..earlier.clone() };
        assert_eq!(other.changes(&earlier), ["resolution was none, is \"/2\"", "seed was 1, is 2"]);
        let longer = RunConfig { schedule: Preset::Quick.schedule(Some(7000)), ..earlier.clone() };
        let longer = longer.pruned(Preset::Quick.pruning()).changes(&earlier);
        assert_eq!(longer, ["schedule.iterations was 2000, is 7000"]);
        let dense = RunConfig { prune: None, ..earlier.clone() }.changes(&earlier);
        assert_eq!(dense, ["prune was set, is none"]);
        let paper = RunConfig::sample(Preset::Paper).pruned(Preset::Paper.pruning()).changes(&earlier);
        assert!(paper.len() == LISTED + 1 && paper[LISTED].ends_with(" more"), "{paper:?}");
    }

    #[test]
    fn another_spelling_of_a_folder_is_no_change() {
        let scene = tempfile::tempdir().unwrap();
        std::fs::create_dir(scene.path().join("images_2")).unwrap();
        let run = |images: PathBuf| {
            let images = Some(images);
            RunConfig {
                scene: scene.path().to_owned(),
                depth: images.clone(),
                images,
                ..RunConfig::sample(Preset::Quick)
            }
        };
        let [name, path] = ["images_2".into(), scene.path().join("images_2")].map(run);
        assert!(name.changes(&path).is_empty() && path.changes(&name).is_empty());
        assert_eq!(run("images_4".into()).changes(&name).len(), 2);
    }

    #[test]
    fn decisions_of_the_scene_are_no_changes_but_the_users_are() {
        let asked = RunConfig::sample(Preset::Quick);
        let style = Style { depth_order: true, ..asked.style };
        let decided = RunConfig { sh_degree: 1, exposure: true, style, ..asked.clone() };
        assert_eq!(asked.changes_before_decisions(&decided), Vec::<String>::new());
        assert!(!asked.changes(&decided).is_empty());
        let mut forced = asked;
        forced.effects.set(Effect::Exposure, Choice::Off);
        assert_eq!(forced.changes_before_decisions(&decided), ["effects.exposure was none, is \"off\""]);
    }
}
