//! The user's decisions on effects.

use super::effect::{Effect, Trigger};
use crate::scene::AlphaRole;
use crate::wording::{named, unknown};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

named! {
    /// The user's choice for one effect.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Choice {
        /// The scene decides.
        #[default]
        Auto = "auto",
        /// The effect is on.
        On = "on",
        /// The effect is off.
        Off = "off",
    }
}

/// The user's choices by effect; the scene decides on all others.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Overrides(BTreeMap<Effect, Choice>);

impl Overrides {
    /// Reads `NAME=on|off|auto`.
    pub fn parse(text: &str) -> Result<(Effect, Choice), String> {
        let (name, value) = text.split_once('=').map_or((text, None), |(name, value)| (name, Some(value)));
        let name = name.trim();
        let effect = Effect::named(name)?;
        let value = value.ok_or_else(|| format!("write {name}=on, {name}=off or {name}=auto"))?.trim();
        let choice = Choice::ALL.into_iter().find(|c| c.name() == value);
        let choice = choice.ok_or_else(|| unknown(value, "a choice", Choice::ALL.map(Choice::name)))?;
        Ok((effect, choice))
    }

    /// Sets one choice; the last one counts.
    pub fn set(&mut self, effect: Effect, choice: Choice) {
        match choice {
            Choice::Auto => self.0.remove(&effect),
            _ => self.0.insert(effect, choice),
        };
    }

    /// Keeps the meaning that alpha and masks have in all photos of a capture, for jobs that see a part of them.
    pub fn keep_alpha(&mut self, role: AlphaRole) {
        let alpha = role == AlphaRole::Alpha;
        self.set(Effect::Transparency, if alpha { Choice::On } else { Choice::Off });
        if alpha {
            self.set(Effect::Masks, Choice::Off);
        }
    }

    /// Returns true if every effect is left to the scene.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The user's choice for an effect; [`Choice::Auto`] if there is none.
    pub fn of(&self, effect: Effect) -> Choice {
        self.0.get(&effect).copied().unwrap_or_default()
    }

    /// The user's decision, true for on; `None` if the scene decides.
    pub fn forced(&self, effect: Effect) -> Option<bool> {
        match self.of(effect) {
            Choice::Auto => None,
            Choice::On => Some(true),
            Choice::Off => Some(false),
        }
    }

    /// Returns true if the effect may turn out to be on, before the scene is examined.
    pub fn allow(&self, effect: Effect) -> bool {
        self.forced(effect).unwrap_or(effect.trigger() != Trigger::Request)
    }

    /// Refuses choices for effects that cannot be switched.
    pub fn check(&self) -> Result<(), String> {
        match self.0.keys().find(|effect| effect.trigger() == Trigger::Always) {
            Some(effect) => Err(format!(
                "effect {} cannot be set: every view always has its own uniforms, at no cost",
                effect.name()
            )),
            None => Ok(()),
        }
    }
}
