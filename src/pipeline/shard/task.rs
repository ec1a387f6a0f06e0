//! Tasks of a divided job: each reads files and writes files, whole or not at all.

use super::plan::Plan;
use std::fmt;
use std::str::FromStr;

/// A task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Task {
    /// Responses of a chunk of views.
    Evidence(usize),
    /// The sum of all responses, and the compressed model.
    Choose,
    /// Scores of some of the views held out.
    Score(usize),
    /// All figures.
    Report,
}

impl Task {
    /// The tasks whose outputs it reads.
    pub fn needs(self, plan: &Plan) -> Vec<Self> {
        let of = |wanted: fn(&Self) -> bool| plan.tasks().into_iter().filter(wanted).collect();
        match self {
            Self::Evidence(_) => Vec::new(),
            Self::Choose => of(|task| matches!(task, Self::Evidence(_))),
            Self::Score(_) => vec![Self::Choose],
            Self::Report => of(|task| matches!(task, Self::Choose | Self::Score(_))),
        }
    }

    /// Its files, from the plan's folder.
    pub fn outputs(self, plan: &Plan) -> Vec<String> {
        match self {
            Self::Evidence(_) => vec![format!("{self}.safetensors")],
            Self::Choose => vec![plan.output.clone(), "prune.json".to_owned()],
            Self::Score(_) => vec![format!("{self}.json")],
            Self::Report => vec!["metrics.json".to_owned()],
        }
    }

    /// Work in views, for engines that begin with the longest task.
    pub fn work(self, plan: &Plan) -> usize {
        match self {
            Self::Evidence(_) => crate::response::CHUNK,
            Self::Choose => plan.chunks,
            Self::Score(n) => plan.scored(n).len(),
            Self::Report => 0,
        }
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Evidence(n) => write!(f, "evidence/{n:04}"),
            Self::Choose => f.write_str("choose"),
            Self::Score(n) => write!(f, "score/{n:04}"),
            Self::Report => f.write_str("report"),
        }
    }
}

impl FromStr for Task {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |n: &str| n.parse().map_err(|_| format!("'{text}' has no number after its slash"));
        match text.split_once('/') {
            Some(("evidence", n)) => number(n).map(Self::Evidence),
            Some(("score", n)) => number(n).map(Self::Score),
            None if text == "choose" => Ok(Self::Choose),
            None if text == "report" => Ok(Self::Report),
            _ => Err(format!("'{text}' is no task; tasks.json lists them")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tasks() {
        for task in [Task::Evidence(0), Task::Evidence(12_345), Task::Choose, Task::Score(7), Task::Report] {
            assert_eq!(task.to_string().parse(), Ok(task));
        }
        assert_eq!(Task::Evidence(3).to_string(), "evidence/0003");
        for wrong in ["", "evidence", "evidence/", "evidence/x", "choose/1", "train/3"] {
            assert!(wrong.parse::<Task>().is_err(), "{wrong}");
        }
    }
}
