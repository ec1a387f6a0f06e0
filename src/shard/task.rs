//! Tasks of a divided job: each reads files and writes files completely or not at all.

use crate::wording::named;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

named! {
    /// The kinds of tasks, with their names in files and on the command line.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Stage {
        /// Trains a coarse model of the whole scene.
        Coarse = "coarse",
        /// Divides the scene into blocks.
        Assign = "assign",
        /// Trains a block up to the prune.
        Dense = "dense",
        /// Joins the blocks' Gaussians, at each of their meetings.
        Collect = "collect",
        /// Takes the responses of a chunk of views.
        Evidence = "evidence",
        /// Adds up all responses and chooses Gaussians.
        Choose = "choose",
        /// Trains a block from the prune to the second meeting.
        Tune = "tune",
        /// Trains a block and its margin from the second meeting to the third.
        Settle = "settle",
        /// Trains a block and its margin from the third meeting to the end.
        Finish = "finish",
        /// Joins the trained blocks.
        Join = "join",
        /// Scores the model in some of the views.
        Score = "score",
        /// Collects all figures.
        Report = "report",
    }
}

/// A task: a stage, and the number of its part if it has several.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Task {
    /// The stage.
    pub stage: Stage,
    /// Number of the part, for a divided stage.
    pub part: Option<usize>,
}

impl Task {
    /// The task of an undivided stage.
    pub const fn whole(stage: Stage) -> Self {
        Self { stage, part: None }
    }

    /// The task of a part of a stage.
    pub const fn part(stage: Stage, part: usize) -> Self {
        Self { stage, part: Some(part) }
    }

    /// The tasks of a stage in `parts` parts.
    pub fn parts(stage: Stage, parts: usize) -> impl Iterator<Item = Self> {
        (0..parts).map(move |part| Self::part(stage, part))
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.part {
            Some(part) => write!(f, "{}/{part:04}", self.stage.name()),
            None => f.write_str(self.stage.name()),
        }
    }
}

impl FromStr for Task {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, part) = match text.split_once('/') {
            Some((name, part)) => (name, Some(part)),
            None => (text, None),
        };
        let stage = Stage::ALL.into_iter().find(|known| known.name() == name);
        let stage = stage.ok_or_else(|| format!("'{text}' is not a task; tasks.json lists all tasks"))?;
        let number = |n: &str| n.parse().map_err(|_| format!("'{text}' has no number after its slash"));
        Ok(Self { stage, part: part.map(number).transpose()? })
    }
}

/// A task as a plan lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// The task.
    pub task: Task,
    /// The tasks whose files it reads.
    pub needs: Vec<Task>,
    /// Its files, relative to the plan's folder, in the order of writing.
    pub outputs: Vec<String>,
    /// Amount of work, in views drawn or trained on, for workflow engines that start with the longest task.
    pub work: usize,
}

impl Listed {
    /// A task with these needs and outputs.
    pub fn new(
        task: Task,
        needs: impl IntoIterator<Item = Task>,
        outputs: impl IntoIterator<Item: Into<String>>,
        work: usize,
    ) -> Self {
        let outputs = outputs.into_iter().map(Into::into).collect();
        Self { task, needs: needs.into_iter().collect(), outputs, work }
    }
}

/// Tasks that score a model, some views each.
#[derive(Clone, Copy)]
pub(super) struct Scores {
    /// Views to score.
    pub views: usize,
    /// Views per task; the last may score fewer.
    pub each: usize,
}

impl Scores {
    pub fn tasks(self) -> impl Iterator<Item = Task> {
        Task::parts(Stage::Score, self.views.div_ceil(self.each))
    }

    /// The views that a part scores.
    pub fn part(self, part: usize) -> Range<usize> {
        part * self.each..((part + 1) * self.each).min(self.views)
    }

    /// The tasks as a plan lists them, after the task that writes the model.
    pub fn listed(self, model: Task) -> impl Iterator<Item = Listed> {
        let listed =
            move |(n, task): (usize, Task)| Listed::new(task, [model], [format!("{task}.json")], self.part(n).len());
        self.tasks().enumerate().map(listed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tasks() {
        for stage in Stage::ALL {
            for task in [Task::whole(stage), Task::part(stage, 0), Task::part(stage, 12_345)] {
                assert_eq!(task.to_string().parse(), Ok(task));
            }
        }
        assert_eq!(Task::part(Stage::Evidence, 3).to_string(), "evidence/0003");
        for wrong in ["", "evidence/", "evidence/x", "train/3"] {
            assert!(wrong.parse::<Task>().is_err(), "{wrong}");
        }
    }
}
