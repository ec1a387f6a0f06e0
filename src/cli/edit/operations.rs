//! Operations in the order of the command line, which clap keeps by index.

use super::parse;
use crate::edit::{Edit, Region, Similarity, Unwanted};
use crate::gaussians::{self, MAX_SH_DEGREE};
use crate::job::Error;
use crate::scene::read_text;
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, FromArgMatches};
use std::path::{Path, PathBuf};

const HEADING: &str = "Operations, in their order";

/// One requested operation.
#[derive(Clone, Debug)]
pub(super) struct Asked {
    /// Name on the command line.
    pub name: String,
    /// Reason for its removals, as the user reads it.
    pub why: String,
    pub what: Operation,
}

#[derive(Clone, Debug)]
pub(super) enum Operation {
    Edit(Edit),
    /// A crop by a scene's cameras.
    Views {
        scene: PathBuf,
        outside: bool,
    },
    /// A move by a matrix in a file.
    Matrix(PathBuf),
    /// A removal of floaters, by photos or pictures.
    Floaters,
}

impl Operation {
    /// Returns true for a move of the whole model, which the editor applies together with the moves that follow it.
    pub fn is_move(&self) -> bool {
        matches!(self, Self::Matrix(_) | Self::Edit(Edit::Transform(_)))
    }
}

/// The options of operations; each may occur more than once.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = HEADING)]
struct Options {
    /// Keep Gaussians with their centre in a box: minimum, then maximum of x, y, z
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true)]
    crop_box: Vec<String>,
    /// Keep Gaussians with their centre in a sphere: centre and radius
    #[arg(long, value_name = "X,Y,Z,R", allow_hyphen_values = true)]
    crop_sphere: Vec<String>,
    /// Keep Gaussians with their centre in the view of a scene's cameras, occluded or not
    #[arg(long, value_name = "SCENE")]
    crop_views: Vec<PathBuf>,
    /// Make the preceding crop keep the outside instead
    #[arg(long, num_args = 0, default_missing_value = "true", action = clap::ArgAction::Append)]
    outside: Vec<bool>,
    /// Translate, in world units
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    translate: Vec<String>,
    /// Rotate about the origin (right-handed): an axis (x, -y, or X,Y,Z) and degrees, or a quaternion
    #[arg(long, value_name = "AXIS:DEGREES|W,X,Y,Z", allow_hyphen_values = true)]
    rotate: Vec<String>,
    /// Scale about the origin, uniformly
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    scale: Vec<String>,
    /// Rotate the up direction to another axis: x, y, z, -x, -y or -z; from -y, as in captures, or from FROM
    #[arg(long, value_name = "[FROM:]AXIS", allow_hyphen_values = true)]
    up: Vec<String>,
    /// Apply a matrix (rotation or reflection, uniform scale, translation): a file with 3 or 4 rows of 4 numbers, as text or
    /// JSON
    #[arg(long, value_name = "FILE")]
    matrix: Vec<PathBuf>,
    /// Drop spherical harmonics above this degree, 0 to 3
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    sh_degree: Vec<String>,
    /// Remove Gaussians with an opacity below this, 0 to 1
    #[arg(long, value_name = "A", allow_hyphen_values = true)]
    min_opacity: Vec<String>,
    /// Remove Gaussians whose longest axis has a larger standard deviation than this, in world units
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    max_size: Vec<String>,
    /// Remove floaters, found by the photos of --scene or by pictures of the model; invisible Gaussians (opacity below 1/255);
    /// or needles, whose longest axis is 100 times, or RATIO times, their middle axis
    #[arg(long, value_name = "floaters|invisible|needles[:RATIO]", allow_hyphen_values = true)]
    remove: Vec<String>,
    /// Store neighbours in space next to each other in the file; none cancels it
    #[arg(long, value_name = "morton|none")]
    order: Vec<String>,
}

/// The operations by their indices on the command line, not yet in order.
#[derive(Clone, Debug, Default)]
pub(super) struct Operations {
    found: Vec<(usize, String, String)>,
}

impl Args for Operations {
    fn augment_args(command: Command) -> Command {
        Options::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Options::augment_args_for_update(command)
    }
}

impl FromArgMatches for Operations {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut found = Vec::new();
        let options = Options::augment_args(Command::new("operations"));
        for option in options.get_arguments() {
            let Some(name) = option.get_long() else { continue };
            let id = option.get_id().as_str();
            if matches.value_source(id) != Some(ValueSource::CommandLine) {
                continue;
            }
            let values = matches.get_raw(id).into_iter().flatten().map(|v| v.to_string_lossy().into_owned());
            found.extend(
                matches.indices_of(id).into_iter().flatten().zip(values).map(|(at, v)| (at, name.to_owned(), v)),
            );
        }
        found.sort_by_key(|operation| operation.0);
        Ok(Self { found })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Operations {
    /// The operations in the order of the command line.
    ///
    /// # Errors
    /// [`Error::Usage`] names the option whose value is wrong, and what it takes.
    pub fn in_order(&self) -> Result<Vec<Asked>, Error> {
        let mut asked: Vec<Asked> = Vec::new();
        for (_, name, value) in &self.found {
            if name == "outside" {
                invert(&mut asked)?;
                continue;
            }
            let refused = |what: String| Error::Usage(format!("--{name} {value}: {what}"));
            let (what, why) = operation(name, value).map_err(refused)?;
            let Some(what) = what else {
                // --order none
                asked.retain(|asked| !matches!(asked.what, Operation::Edit(Edit::MortonOrder)));
                continue;
            };
            asked.push(Asked { name: format!("--{name} {value}"), why, what });
        }
        Ok(asked)
    }
}

/// Lets a crop keep what lies outside.
fn invert(asked: &mut [Asked]) -> Result<(), Error> {
    match asked.last_mut() {
        Some(Asked {
            name,
            why,
            what: Operation::Edit(Edit::Crop { outside, .. }) | Operation::Views { outside, .. },
        }) if !*outside => {
            *outside = true;
            *name += " --outside";
            *why = why.replace("outside the", "inside the").replace("in too few", "in enough");
            Ok(())
        }
        _ => Err(Error::Usage("--outside must follow a --crop-box, --crop-sphere or --crop-views".into())),
    }
}

/// The edit that an option requests, and its reason for removals; none if it changes nothing.
fn operation(name: &str, value: &str) -> Result<(Option<Operation>, String), String> {
    let crop = |region: Region, what: &str| {
        let edit = Edit::Crop { region, outside: false };
        (Some(Operation::Edit(edit)), format!("centres outside the {what}"))
    };
    let moved = |similarity: Result<Similarity, String>| {
        similarity.map(|s| (Some(Operation::Edit(Edit::Transform(s))), String::new()))
    };
    let edit = |edit: Edit, why: String| Ok((Some(Operation::Edit(edit)), why));
    match name {
        "crop-box" => Ok(crop(parse::cube(value)?, "box")),
        "crop-sphere" => Ok(crop(parse::ball(value)?, "sphere")),
        "crop-views" => {
            let views = Operation::Views { scene: value.into(), outside: false };
            Ok((Some(views), "centres in too few pictures".to_owned()))
        }
        "translate" => moved(parse::shift(value)),
        "rotate" => moved(parse::turn(value)),
        "scale" => moved(parse::factor(value)),
        "up" => moved(parse::up(value)),
        "matrix" => Ok((Some(Operation::Matrix(value.into())), String::new())),
        "sh-degree" => {
            let degree = value.parse().ok().filter(|degree| *degree <= MAX_SH_DEGREE);
            edit(Edit::ShDegree(degree.ok_or("write a degree from 0 to 3")?), String::new())
        }
        "min-opacity" => {
            let least = value.parse::<f64>().ok().filter(|a| (0.0..=1.0).contains(a));
            let least = least.ok_or("write an opacity from 0 to 1, such as 0.02")?;
            edit(Edit::MinOpacity(least), format!("their opacity is below {least}"))
        }
        "max-size" => {
            let most = parse::positive(value).ok_or("write a size above 0 in world units, such as 0.5")?;
            edit(Edit::MaxSize(most), format!("an axis has a standard deviation above {most}"))
        }
        "remove" if value == "floaters" => Ok((Some(Operation::Floaters), String::new())),
        "remove" => match parse::unwanted(value)? {
            unwanted @ Unwanted::Invisible => {
                let least = "opacity below 1/255, or values that are not finite: no picture shows them";
                edit(Edit::Remove(unwanted), least.to_owned())
            }
            unwanted @ Unwanted::Needles(ratio) => {
                edit(Edit::Remove(unwanted), format!("the longest axis is more than {ratio} times the next"))
            }
        },
        "order" => match value {
            "morton" => edit(Edit::MortonOrder, String::new()),
            "none" => Ok((None, String::new())),
            _ => Err("write morton or none".into()),
        },
        _ => Err("no such operation".into()),
    }
}

/// A move by the matrix in a file.
pub(super) fn of_matrix(path: &Path) -> Result<Edit, Error> {
    let text = read_text(path)?;
    let malformed = |what: String| {
        Error::Gaussians(gaussians::Error::Malformed { path: path.to_owned(), record: "matrix".into(), what })
    };
    Similarity::of_text(&text).map(Edit::Transform).map_err(|e| malformed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Operations {
        let command = Operations::augment_args(Command::new("edit"));
        let matches = command.try_get_matches_from(format!("edit {line}").split(' ')).unwrap();
        Operations::from_arg_matches(&matches).unwrap()
    }

    #[test]
    fn the_order_is_that_of_the_command_line() {
        let line = "--scale 2 --crop-box -1,-1,-1,1,1,1 --rotate y:90 --outside";
        let refused = read(line).in_order().unwrap_err().to_string();
        assert!(refused.contains("--outside must follow"), "{refused}");
        let line = "--scale 2 --crop-box -1,-1,-1,1,1,1 --outside --rotate -y:-90 --scale 3 --order none --crop-views s --outside";
        let names: Vec<String> = read(line).in_order().unwrap().into_iter().map(|asked| asked.name).collect();
        let expected = [
            "--scale 2",
            "--crop-box -1,-1,-1,1,1,1 --outside",
            "--rotate -y:-90",
            "--scale 3",
            "--crop-views s --outside",
        ];
        assert_eq!(names, expected);
        assert!(read("--scale 1").in_order().unwrap()[0].why.is_empty());
        let orders = read("--order morton --scale 2 --order none --order morton --order none").in_order().unwrap();
        assert!(orders.len() == 1 && orders[0].name == "--scale 2");
    }

    /// An option that `operation` forgets would be refused as none.
    #[test]
    fn all_options_are_known() {
        let options = Options::augment_args(Command::new("operations"));
        for name in options.get_arguments().filter_map(clap::Arg::get_long).filter(|name| *name != "outside") {
            assert!(!operation(name, "").is_err_and(|what| what == "no such operation"), "{name}");
        }
    }
}
