//! Suffixes of an arm's name.

use crate::qirf::select::budget::Budget;

/// Suffixes of an arm's name: any of these, in any order, each once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Suffix {
    Budget,
    Merge,
    WithoutDetail,
    Attrition,
    Twice,
    Rewarm,
    Thresholds,
    Share,
}

impl Suffix {
    /// All suffixes: the text that begins each, and its name in the help.
    pub const ALL: [(Self, &str, &str); 8] = [
        (Self::Budget, ":", ":BUDGET"),
        (Self::Merge, "+merge", "+merge"),
        (Self::WithoutDetail, "-detail", "-detail"),
        (Self::Attrition, "+attrition", "+attrition"),
        (Self::Twice, "+twice", "+twice"),
        (Self::Rewarm, "+rewarm", "+rewarm"),
        (Self::Thresholds, "+thresholds", "+thresholds"),
        (Self::Share, "@", "@SHARE"),
    ];

    /// Names of some suffixes, or of all, as a list in a sentence.
    pub fn list(some: Option<&[Self]>) -> String {
        let rows = Self::ALL.iter().filter(|row| some.is_none_or(|some| some.contains(&row.0)));
        let names: Vec<&str> = rows.map(|row| row.2).collect();
        match names.split_last() {
            Some((last, [])) => (*last).to_owned(),
            Some((last, before)) => format!("{} and {last}", before.join(", ")),
            None => "nothing".to_owned(),
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Suffixes {
    /// The suffixes that were given, in their order.
    pub given: Vec<Suffix>,
    /// The budget of `:BUDGET`.
    pub budget: Option<Budget>,
    /// The share of `@SHARE`.
    pub share: Option<f64>,
}

impl Suffixes {
    /// Splits an arm's text into its name and its suffixes.
    pub fn split(text: &str) -> Result<(&str, Self), String> {
        let end = |text: &str| -> usize {
            let begins = [":", "@", "+", "-detail"].iter().filter_map(|begin| text.find(begin));
            begins.min().unwrap_or(text.len())
        };
        let (name, mut rest) = text.split_at(end(text));
        let mut found = Self::default();
        while !rest.is_empty() {
            let Some((suffix, begin, shown)) = Suffix::ALL.into_iter().find(|row| rest.starts_with(row.1)) else {
                return Err(format!(
                    "'{text}': '{rest}' is not a suffix of an arm; possible suffixes: {}",
                    Suffix::list(None)
                ));
            };
            rest = &rest[begin.len()..];
            if matches!(suffix, Suffix::Budget | Suffix::Share) {
                let (value, after) = rest.split_at(end(rest));
                found.value(suffix, value).map_err(|wrong| format!("'{text}': {wrong}"))?;
                rest = after;
            }
            if found.has(suffix) {
                return Err(format!("'{text}': {shown} is given twice"));
            }
            found.given.push(suffix);
        }
        Ok((name, found))
    }

    fn value(&mut self, suffix: Suffix, value: &str) -> Result<(), String> {
        if suffix == Suffix::Share {
            let share = value.parse::<f64>().ok().filter(|s| *s > 0.0 && *s <= 1.0);
            self.share = Some(share.ok_or("write a share such as 0.2 after @")?);
            return Ok(());
        }
        let budget = Budget::ALL.into_iter().find(|budget| budget.name() == value);
        let wrong = || format!("there is no budget '{value}'; choose per-block, hybrid or global");
        self.budget = Some(budget.ok_or_else(wrong)?);
        Ok(())
    }

    pub fn has(&self, suffix: Suffix) -> bool {
        self.given.contains(&suffix)
    }
}
